"""Which pixels of a view show the ArUco, the elements, the marker and the face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from radiometry.geometry import FloatArray
from scenes.marker import Element, MarkerDesign
from scenes.target import Target, surroundings
from scenes.view import View

#: Pixels around the marker's outline that belong to its surroundings.
MARGIN_PX = 4
_FAR_PX = 2**20
#: Details of the marker at least so wide [px] show at the corners of the pixels that they cross.
_DETAIL_PX = 1.5


@dataclass(frozen=True)
class Box:
    """A rectangle of whole pixels.

    Attributes:
        x0, y0: its first column and row.
        x1, y1: the first column and row beyond it.
    """

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        """Columns; zero where there are none."""
        return max(self.x1 - self.x0, 0)

    @property
    def height(self) -> int:
        """Rows; zero where there are none."""
        return max(self.y1 - self.y0, 0)

    def grown(self, pixels: int) -> Box:
        """The box with a rim of pixels added on every side.

        Args:
            pixels: width of the rim; negative to shrink the box.
        """
        return Box(self.x0 - pixels, self.y0 - pixels, self.x1 + pixels, self.y1 + pixels)

    def within(self, other: Box) -> Box:
        """The part of the box that lies in another box; of no width or height where there is none.

        Args:
            other: the other box.
        """
        x0, y0 = max(self.x0, other.x0), max(self.y0, other.y0)
        return Box(x0, y0, max(min(self.x1, other.x1), x0), max(min(self.y1, other.y1), y0))

    def around(self, hole: Box) -> list[Box]:
        """What is left of the box without a hole in it, in up to four parts: above, left, right and below.

        Args:
            hole: a box within this one.

        Returns:
            The parts that are not empty.
        """
        if not hole.width or not hole.height:
            return [self] if self.width and self.height else []
        parts = [
            Box(self.x0, self.y0, self.x1, hole.y0),
            Box(self.x0, hole.y0, hole.x0, hole.y1),
            Box(hole.x1, hole.y0, self.x1, hole.y1),
            Box(self.x0, hole.y1, self.x1, self.y1),
        ]
        return [part for part in parts if part.width and part.height]

    def slices(self, origin: Box) -> tuple[slice, slice]:
        """Rows and columns of the box in an array whose first element is the first corner of another box.

        Args:
            origin: the box that the array covers.
        """
        return (
            slice(self.y0 - origin.y0, self.y1 - origin.y0),
            slice(self.x0 - origin.x0, self.x1 - origin.x0),
        )


def frame_box(view: View) -> Box:
    """All pixels of the frame.

    Args:
        view: for its camera.
    """
    return Box(0, 0, view.camera.width_px, view.camera.height_px)


def marker_box(view: View) -> Box:
    """Pixels around the marker, with a margin of `MARGIN_PX`; not cut to the frame.

    Args:
        view: of the marker.
    """
    half = view.marker.size_m / 2
    return _box(view, np.array([[-half, -half, -view.marker.thickness_m], [half, half, 0.0]]))


def target_box(view: View) -> Box:
    """Pixels around the whole target, with a margin of `MARGIN_PX`; not cut to the frame.

    Args:
        view: of the target.
    """
    return _box(view, bounds_m(view.marker, at_rest(view.target)))


def at_rest(target: Target) -> Target:
    """The target without attitude and motion. Its surfaces depend on nothing else.

    Args:
        target: in any attitude.
    """
    return target.model_copy(
        update=dict.fromkeys(("pitch_deg", "yaw_deg", "roll_deg", "tumble_deg_s", "tumble_lever_m"), 0.0)
    )


@lru_cache(maxsize=8)
def bounds_m(marker: MarkerDesign, surface: Target) -> FloatArray:
    """Smallest and largest coordinates of marker and target in the marker frame, (2, 3) [m].

    Args:
        marker: the design.
        surface: the target at rest.
    """
    points = [vertices for (vertices, _), _ in surroundings(surface, marker).values()]
    points += [vertices for vertices, _ in marker.meshes().values()]
    return np.array([np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)])


def _box(view: View, corners_m: FloatArray) -> Box:
    # Distortion bends edges, which then reach further than the corners.
    steps = np.linspace(0, 1, 17 if view.camera.distorted else 2)
    unit = np.array([[x, y, z] for x in steps for y in steps for z in (0, 1)])
    points = corners_m[0] + unit * (corners_m[1] - corners_m[0])
    depth = points @ view.rotation[2] + view.translation_m[2]
    if depth.min() <= 0:  # it reaches behind the camera
        return Box(-_FAR_PX, -_FAR_PX, _FAR_PX, _FAR_PX)
    image = view.to_image(points).clip(-_FAR_PX, _FAR_PX)
    x0, y0 = np.floor(image.min(axis=0)).astype(int) - MARGIN_PX
    x1, y1 = np.ceil(image.max(axis=0)).astype(int) + MARGIN_PX + 1
    return Box(int(x0), int(y0), int(x1), int(y1))


@dataclass(frozen=True)
class MarkerPixels:
    """Pixels of a box by what their centres show, (height, width) each.

    Attributes:
        aruco: the ArUco with its ring.
        blob: slits of the elements whose floor the camera sees, at least in part.
        opening: all of the elements' openings.
    """

    aruco: NDArray[np.bool_]
    blob: NDArray[np.bool_]
    opening: NDArray[np.bool_]


def marker_pixels(view: View, box: Box) -> MarkerPixels:
    """What the pixels of a box show of the marker.

    Args:
        view: of the marker.
        box: pixels to look at.
    """
    column, row = np.meshgrid(np.arange(box.x0, box.x1), np.arange(box.y0, box.y1))
    pixels = np.stack([column, row], axis=-1).reshape(-1, 2).astype(float)
    place = np.nan_to_num(view.to_plane(pixels), nan=np.inf).reshape(box.height, box.width, 2)
    marker, viewer = view.marker, view.to_marker(np.zeros(3))
    half = marker.aruco_m * (0.5 + marker.ring_fraction)
    aruco = np.all(np.abs(place) <= half, axis=-1)
    opening, blob = np.zeros_like(aruco), np.zeros_like(aruco)
    for element in marker.elements:
        here = _in_opening(element, place)
        opening |= here
        blob |= here & (
            np.abs(place @ element.along[:2] - element.blob_offset_m(viewer)) <= _blob_reach_m(marker, element, viewer)
        )
    return MarkerPixels(aruco, blob, opening)


def uniform_pixels(view: View, box: Box) -> NDArray[np.bool_]:
    """Pixels of a box that show nothing but one flat surface of a Mantis Marker, so that their light is uniform, (height, width).

    An edge either separates the corners of a pixel or has a corner of its own within it, and both are looked for. There are
    no such pixels where details are small beside a pixel, where something stands in front of the marker and may shade it,
    and under an Earth, whose wide disc takes many rays to sample.

    Args:
        view: of the marker.
        box: pixels to look at.
    """
    marker, nothing = view.marker, np.zeros((box.height, box.width), bool)
    flush = isinstance(marker, MarkerDesign) and bounds_m(marker, at_rest(view.target))[1, 2] <= 0
    if view.earth is not None or not flush:
        return nothing
    finest_m = min(marker.bit_m, marker.ring_fraction * marker.aruco_m, *(e.width_m for e in marker.elements))
    if finest_m * np.linalg.norm(edge_normals(view), axis=1).min() < _DETAIL_PX:
        return nothing
    column, row = np.meshgrid(np.arange(box.x0, box.x1 + 1) - 0.5, np.arange(box.y0, box.y1 + 1) - 0.5)
    corners = np.stack([column, row], axis=-1).reshape(-1, 2)
    place = np.nan_to_num(view.to_plane(corners), nan=np.inf).reshape(*row.shape, 2)
    surface = _surface_at(marker, place)
    quads = np.stack([surface[:-1, :-1], surface[1:, :-1], surface[:-1, 1:], surface[1:, 1:]])
    even: NDArray[np.bool_] = (quads.min(axis=0) == quads.max(axis=0)) & (quads[0] > 0)
    x, y = np.rint(view.to_image(_turns_m(marker))).astype(int).T - np.array([[box.x0], [box.y0]])
    seen = (x >= 0) & (x < box.width) & (y >= 0) & (y < box.height)
    even[y[seen], x[seen]] = False
    return even


def _turns_m(marker: MarkerDesign) -> FloatArray:
    """Where edges on the marker's plane end or meet, (n, 3) [m]: corners of bits, ring, openings and outline."""
    half, square = marker.aruco_m / 2, np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    grid = np.linspace(-half, half, len(marker.bits) + 1)
    turns = [np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)]
    turns += [square * (half + marker.ring_fraction * marker.aruco_m), square * marker.size_m / 2]
    for element in marker.elements:
        middle = element.centre_m @ element.across * element.across + element.shift_m * element.along
        corners = (
            square[:, :1] * element.length_m / 2 * element.along + square[:, 1:] * element.width_m / 2 * element.across
        )
        turns.append((middle + corners)[:, :2])
    plane = np.concatenate(turns)
    return np.column_stack([plane, np.zeros(len(plane))])


def _surface_at(marker: MarkerDesign, place_m: FloatArray) -> NDArray[np.int8]:
    """What is at positions (..., 2) [m] of the marker's plane: 1 absorber, 2 tape, 0 an element's opening or no marker at all."""
    half, reach = marker.aruco_m / 2, np.abs(place_m).max(axis=-1)
    bright = (reach >= half) & (reach < half + marker.ring_fraction * marker.aruco_m)
    inside = reach < half
    cell = np.clip((np.where(inside[..., None], place_m * (1, -1), 0.0) + half) / marker.bit_m, 0, len(marker.bits) - 1)
    bright |= inside & (marker.bits[cell[..., 1].astype(int), cell[..., 0].astype(int)] != 0)
    surface = np.where(reach <= marker.size_m / 2, 1 + bright, 0).astype(np.int8)
    for element in marker.elements:
        surface[_in_opening(element, place_m)] = 0
    return surface


def _in_opening(element: Element, place_m: FloatArray) -> NDArray[np.bool_]:
    along, across = place_m @ element.along[:2], place_m @ element.across[:2]
    here = np.abs(across - element.centre_m @ element.across) <= element.width_m / 2
    return np.asarray(here & (np.abs(along - element.shift_m) <= element.length_m / 2))


def _blob_reach_m(marker: MarkerDesign, element: Element, viewer: FloatArray) -> float:
    """Largest distance from the middle of the blob at which the floor can be seen [m].

    With w = u₀ + (u − u₀) V / (V + z), constant on the planes of the slats, a line of sight that passes the front plane at
    u changes w by (u − u_blob) t/(V − t) (1 + V/C_z) down to the floor at z = −t. Where that exceeds the width of a slit, a
    slat hides the floor.
    """
    pitch = element.length_m / marker.slit_count
    depth, virtual = element.depth_m, element.virtual_depth_m
    change = depth / (virtual - depth) * (1 + virtual / viewer[2])
    return float(pitch * (1 + (1 - marker.slat_fraction) / change))


def dilated(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """A mask together with all pixels within a distance of it along either axis (dilation by a square).

    Args:
        mask: (height, width).
        pixels: the distance [px].
    """
    if pixels == 0 or not mask.any():
        return mask
    return binary_dilation(mask, np.ones((2 * pixels + 1,) * 2, bool))


def edge_normals(view: View) -> FloatArray:
    """Normals, in the image, of edges that run along the marker's y and x axes at its centre, (2, 2).

    Args:
        view: of the marker.

    Returns:
        A row for each family of edges, x and y of the normal; its length is that of a metre in the image [px].
    """
    step = 1e-4
    ends = view.to_image(np.array([[step, 0, 0], [-step, 0, 0], [0, step, 0], [0, -step, 0]]))
    x_axis, y_axis = (ends[0] - ends[1]) / (2 * step), (ends[2] - ends[3]) / (2 * step)
    return np.array([[y_axis[1], -y_axis[0]], [x_axis[1], -x_axis[0]]])
