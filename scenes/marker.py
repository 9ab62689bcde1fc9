"""Geometry of the Mantis Marker: an ArUco square with an encoding element along each side. Pure numpy and OpenCV.

An encoding element is a slotted cavity whose floor is retroreflective. Its slats and end walls converge on a *virtual
line*, which runs parallel to the slats at a depth behind the front plane. The lit floor shows only where the plane of the
slats holds the viewer. The bright blob therefore moves as if it were the virtual line, seen through the front plane.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from radiometry.geometry import FloatArray
from radiometry.parameters import OpenFraction

Mesh = tuple[FloatArray, NDArray[np.uint32]]
ELEMENT_NAMES = ("top", "right", "bottom", "left")

#: Dictionaries that OpenCV has not, by name: rows of bits of each identity, 1 reflective. Of 3 × 3 bits, four patterns are the
#: most of which every two, in whatever turns, and every one and itself turned, differ in four bits (exhaustive search).
OWN_DICTIONARIES = {"MANTIS_3X3_4": ("100 011 100", "111 001 110", "111 110 100", "110 000 000")}
#: Largest depth of a marker [m]: 10 mm with a tolerance of 5 mm (thesis, SYS-REQ-14).
DEPTH_LIMIT_M, DEPTH_TOLERANCE_M = 0.010, 0.005
#: Thinnest slat and narrowest slit that a common printer makes [m]: its nozzle's width (assumption).
PRINTABLE_M = 0.0004

Offset = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class Element:
    """One encoding element in the marker frame [m].

    The blob moves along `along`; slats and virtual line run along `across`. The virtual line passes through
    ``virtual_offset_m * along − virtual_depth_m * z``, parallel to `across`.

    Attributes:
        name: one of `ELEMENT_NAMES`.
        centre_m: origin of the coordinates along the element, (3,), perpendicular to `along` [m].
        along, across: unit vectors, (3,).
        length_m, width_m: of the opening [m].
        depth_m: of the cavity's floor below the front plane [m].
        virtual_offset_m: coordinate of the virtual line along the element [m].
        virtual_depth_m: of the virtual line behind the front plane [m].
        shift_m: coordinate of the middle of the opening [m]; zero where the element stands as designed.
    """

    name: str
    centre_m: FloatArray
    along: FloatArray
    across: FloatArray
    length_m: float
    width_m: float
    depth_m: float
    virtual_offset_m: float
    virtual_depth_m: float
    shift_m: float = 0.0

    def blob_offset_m(self, camera_in_marker_m: FloatArray) -> FloatArray:
        """Coordinate of the blob along the element, measured from the marker's centre [m].

        The plane through the camera and the virtual line cuts the front plane z = 0 there: u = u₀ + (C·along − u₀) V / (V +
        C_z).

        Args:
            camera_in_marker_m: position C of the camera, (..., 3) [m].

        Returns:
            (...) [m].

        Example:
            Straight above the virtual line the blob stays over the line, whatever the distance:

            >>> from scenes.marker import MarkerDesign
            >>> top = MarkerDesign().elements[0]
            >>> offset = top.virtual_offset_m
            >>> bool(abs(top.blob_offset_m([offset, 0.0, 5.0]) - offset) < 1e-12)
            True
        """
        camera = np.asarray(camera_in_marker_m, float)
        travel = camera @ self.along - self.virtual_offset_m
        return self.virtual_offset_m + travel * self.virtual_depth_m / (self.virtual_depth_m + camera[..., 2])


class MarkerDesign(BaseModel):
    """A Mantis Marker. Fractions are of the ArUco's side unless stated otherwise.

    Raises:
        ValueError: when the dictionary or the identity does not exist, or when parts do not fit into the marker or beside
            each other.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    size_m: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = Field(
        0.10, description="side of the marker [m]"
    )
    dictionary: str = Field(
        "4X4_50",
        description="OpenCV dictionary without its DICT_ prefix, AprilTag families too; or MANTIS_3X3_4, four identities",
    )
    identity: int = Field(0, ge=0, description="index in the dictionary")
    aruco_fraction: OpenFraction = Field(0.525, description="ArUco side over marker side, black border included")
    ring_fraction: OpenFraction = Field(0.12, description="width of the reflective ring around the ArUco")
    gap_fraction: OpenFraction = Field(0.17, description="from the ArUco's side to the element's opening")
    element_length_fraction: OpenFraction = Field(0.95, description="length of an element's opening")
    element_width_fraction: OpenFraction = Field(0.20, description="width of an element's opening")
    element_depth_fraction: OpenFraction = Field(0.10, description="depth of the cavity over element length")
    slit_count: int = Field(25, ge=3, le=400, description="slits of one element")
    slat_fraction: OpenFraction = Field(0.20, description="slat thickness over slit pitch")
    virtual_depth_fraction: OpenFraction = Field(0.50, description="depth of the virtual line over element length")
    virtual_offset_fraction: Annotated[float, Field(ge=0, lt=0.5)] = Field(
        0.25, description="virtual line off the element's centre, over element length"
    )
    element_offsets_m: tuple[Offset, Offset, Offset, Offset] = Field(
        (0.0, 0.0, 0.0, 0.0),
        description="how far the top, right, bottom and left element stand off their places, to the right or up [m]",
    )

    def model_post_init(self, _: object) -> None:
        """Check what spans several fields: the identity in its dictionary, and parts that must fit beside each other."""
        if self.dictionary not in OWN_DICTIONARIES and f"DICT_{self.dictionary}" not in dir(cv2.aruco):
            raise ValueError(
                f"dictionary: {self.dictionary!r} is not one of OpenCV's (say '4X4_50' or 'APRILTAG_36h11') nor of "
                f"{', '.join(OWN_DICTIONARIES)}"
            )
        if self.identity >= len(aruco_dictionary(self.dictionary).bytesList):
            raise ValueError(
                f"identity: {self.identity}, but {self.dictionary} has {len(aruco_dictionary(self.dictionary).bytesList)}"
            )
        reach = 0.5 + self.gap_fraction + self.element_width_fraction
        if reach * self.aruco_fraction > 0.5:
            raise ValueError(
                f"elements reach {reach * self.aruco_fraction:.3f} of the marker's side from its centre; at most 0.5"
            )
        if self.ring_fraction > self.gap_fraction:
            raise ValueError(f"ring_fraction: {self.ring_fraction} exceeds gap_fraction {self.gap_fraction}")
        if self.element_depth_fraction >= self.virtual_depth_fraction:
            raise ValueError(
                "element_depth_fraction must be smaller than virtual_depth_fraction: slats meet at the virtual line"
            )
        # Further out it would run into its neighbour.
        room = (0.5 + self.gap_fraction - self.element_length_fraction / 2) * self.aruco_m
        if any(abs(offset) > room for offset in self.element_offsets_m):
            raise ValueError(
                f"element_offsets_m: {list(self.element_offsets_m)}, expected at most {room:.3g} m either way [m]"
            )

    @property
    def aruco_m(self) -> float:
        """Side of the ArUco square, black border included [m]."""
        return self.aruco_fraction * self.size_m

    @property
    def bits(self) -> NDArray[np.bool_]:
        """Printed pattern with its black border, (n, n), row 0 on top; True is reflective. Read-only."""
        return _bits(self.dictionary, self.identity)

    @property
    def bit_m(self) -> float:
        """Side of one printed cell [m]."""
        return self.aruco_m / len(self.bits)

    @property
    def element_length_m(self) -> float:
        """Length of an element's opening [m]."""
        return self.element_length_fraction * self.aruco_m

    @property
    def element_depth_m(self) -> float:
        """Depth of an element's cavity below the front plane [m]."""
        return self.element_depth_fraction * self.element_length_m

    def shortcomings(self) -> tuple[str, ...]:
        """What keeps the design from being flat enough or from being printed, one line each; empty where nothing does.

        The depth is held against SYS-REQ-14 of the thesis, slats and slits against what a printer's nozzle can make.
        """
        pitch = self.element_length_m / self.slit_count
        floor = 1 - self.element_depth_fraction / self.virtual_depth_fraction  # slits and slats narrow towards the line
        found = []
        if self.thickness_m > DEPTH_LIMIT_M + DEPTH_TOLERANCE_M:
            found.append(
                f"depth {1e3 * self.thickness_m:.1f} mm; at most {1e3 * DEPTH_LIMIT_M:g} mm with a tolerance of "
                f"{1e3 * DEPTH_TOLERANCE_M:g} mm (SYS-REQ-14)"
            )
        for part, width in (("slats", self.slat_fraction * pitch), ("slits", (1 - self.slat_fraction) * pitch * floor)):
            if width < 0.99 * PRINTABLE_M:
                found.append(f"{part} {1e3 * width:.2f} mm wide; at least {1e3 * PRINTABLE_M:g} mm can be printed")
        return tuple(found)

    @property
    def thickness_m(self) -> float:
        """Distance from the front plane to the mounting plane [m]: the cavity, and a tenth of it as a back wall."""
        return 1.1 * self.element_depth_m

    @property
    def corners_m(self) -> FloatArray:
        """Corners of the ArUco square, (4, 3): top left first, clockwise as seen [m]."""
        h = self.aruco_m / 2
        return np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])

    @property
    def elements(self) -> tuple[Element, Element, Element, Element]:
        """Top, right, bottom and left element. Opposite elements have their virtual lines off centre to opposite sides."""
        width = self.element_width_fraction * self.aruco_m
        offset = self.virtual_offset_fraction * self.element_length_m
        radius = self.aruco_m * (0.5 + self.gap_fraction) + width / 2
        x, y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
        placed = (
            (radius * y, x, y, offset),
            (radius * x, y, x, offset),
            (-radius * y, x, y, -offset),
            (-radius * x, y, x, -offset),
        )
        top, right, bottom, left = (
            Element(
                name=name,
                centre_m=centre,
                along=along,
                across=across,
                length_m=self.element_length_m,
                width_m=width,
                depth_m=self.element_depth_m,
                virtual_offset_m=u0 + shift,
                virtual_depth_m=self.virtual_depth_fraction * self.element_length_m,
                shift_m=shift,
            )
            for name, (centre, along, across, u0), shift in zip(
                ELEMENT_NAMES, placed, self.element_offsets_m, strict=True
            )
        )
        return top, right, bottom, left

    @property
    def virtual_points_m(self) -> dict[str, FloatArray]:
        """Where the virtual lines of a horizontal and a vertical element cross, (3,) by 'top_right' and so on [m]."""
        top, right, bottom, left = self.elements
        return {
            f"{h.name}_{v.name}": np.array([h.virtual_offset_m, v.virtual_offset_m, -h.virtual_depth_m])
            for h, v in ((top, right), (top, left), (bottom, right), (bottom, left))
        }

    def white_bit_centres_m(self) -> FloatArray:
        """Centres of the reflective cells inside the border, (n, 3) [m]."""
        return self._bit_centres(self.bits)

    def black_bit_centres_m(self) -> FloatArray:
        """Centres of the absorbing cells beside a reflective one (four-neighbourhood), (n, 3) [m]."""
        white = np.pad(self.bits, 1)
        beside = white[:-2, 1:-1] | white[2:, 1:-1] | white[1:-1, :-2] | white[1:-1, 2:]
        return self._bit_centres(~self.bits & beside)

    def _bit_centres(self, mask: NDArray[np.bool_]) -> FloatArray:
        row, column = np.nonzero(mask)
        half = self.aruco_m / 2
        return np.stack([(column + 0.5) * self.bit_m - half, half - (row + 0.5) * self.bit_m, 0.0 * row], axis=-1)

    def plane_cells(self) -> Iterator[tuple[float, float, float, float, str]]:
        """The front plane without the openings, cut into rectangles (x0, x1, y0, y1, material) [m]."""
        half, a = self.size_m / 2, self.aruco_m / 2
        ring = a + self.ring_fraction * self.aruco_m
        near = a + self.gap_fraction * self.aruco_m
        far = near + self.element_width_fraction * self.aruco_m
        ends = [shift + s * self.element_length_m / 2 for shift in self.element_offsets_m for s in (-1, 1)]
        bit_edges = np.linspace(-a, a, len(self.bits) + 1)
        edges = np.unique(
            np.round(np.concatenate([s * np.array([half, ring, near, far]) for s in (-1, 1)] + [bit_edges, ends]), 12)
        )
        # Openings as intervals (x0, x1, y0, y1).
        openings = [
            (ends[0], ends[1], near, far),
            (near, far, ends[2], ends[3]),
            (ends[4], ends[5], -far, -near),
            (-far, -near, ends[6], ends[7]),
        ]
        for x0, x1 in pairwise(edges):
            for y0, y1 in pairwise(edges):
                middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
                if any(left < middle_x < right and low < middle_y < high for left, right, low, high in openings):
                    continue
                x, y = abs(middle_x), abs(middle_y)
                material = "retro" if max(x, y) < ring else "absorber"
                if max(x, y) < a:
                    column, row = int(((x0 + x1) / 2 + a) / self.bit_m), int((a - (y0 + y1) / 2) / self.bit_m)
                    material = "retro" if self.bits[row, column] else "absorber"
                yield x0, x1, y0, y1, material

    def reflective_rectangles_m(self) -> FloatArray:
        """Tape on the front plane as rectangles x0, x1, y0, y1, (n, 4) [m]. The rest of the plane absorbs.

        Example:
            >>> from scenes.marker import MarkerDesign
            >>> marker = MarkerDesign()
            >>> marker.bits.shape, marker.reflective_rectangles_m().shape[1]
            ((6, 6), 4)
        """
        return np.array([cell[:4] for cell in self.plane_cells() if cell[4] == "retro"])

    def meshes(self) -> dict[str, Mesh]:
        """Triangles by material, 'retro' and 'absorber'.

        Returns:
            By material, vertices (n, 3) [m] and triangles (m, 3), counter-clockwise as seen from outside.
        """
        parts: dict[str, list[FloatArray]] = {"retro": [], "absorber": []}
        for x0, x1, y0, y1, material in self.plane_cells():
            parts[material].append(_quad([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], (0, 0, 1)))
        for element in self.elements:
            floor, slats = self._element_quads(element)
            parts["retro"].append(floor)
            parts["absorber"].extend(slats)
        half, back = self.size_m / 2, -self.thickness_m
        for nx, ny in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            (ax, ay), (bx, by) = (nx - ny, ny + nx), (nx + ny, ny - nx)
            side = [
                (half * ax, half * ay, 0),
                (half * bx, half * by, 0),
                (half * bx, half * by, back),
                (half * ax, half * ay, back),
            ]
            parts["absorber"].append(_quad(side, (nx, ny, 0)))
        return {material: _join(quads) for material, quads in parts.items()}

    def _element_quads(self, e: Element) -> tuple[FloatArray, list[FloatArray]]:
        """Floor, and the walls and slats, of one element."""
        shrink = 1 - e.depth_m / e.virtual_depth_m  # every wall and slat converges on the virtual line
        z, hv, t = np.array([0.0, 0.0, 1.0]), e.width_m / 2, e.depth_m

        def at(u: float, v: float, depth: float) -> FloatArray:
            """Marker-frame point; u along the element at the front plane, carried down towards the line."""
            if depth > 0:
                u = e.virtual_offset_m + (u - e.virtual_offset_m) * shrink
            return e.centre_m + u * e.along + v * e.across - depth * z

        first, last = e.shift_m - e.length_m / 2, e.shift_m + e.length_m / 2
        floor = _quad([at(first, -hv, t), at(last, -hv, t), at(last, hv, t), at(first, hv, t)], z)
        solid = []
        for side in (-1.0, 1.0):
            wall = [at(first, side * hv, 0), at(last, side * hv, 0), at(last, side * hv, t), at(first, side * hv, t)]
            solid.append(_quad(wall, -side * e.across))
        pitch = e.length_m / self.slit_count
        for i in range(self.slit_count + 1):
            centre = first + i * pitch
            low, high = (
                max(centre - self.slat_fraction * pitch / 2, first),
                min(centre + self.slat_fraction * pitch / 2, last),
            )
            solid.append(_quad([at(low, -hv, 0), at(high, -hv, 0), at(high, hv, 0), at(low, hv, 0)], z))
            for u, outward in ((low, -1.0), (high, 1.0)):
                solid.append(_quad([at(u, -hv, 0), at(u, hv, 0), at(u, hv, t), at(u, -hv, t)], outward * e.along))
        return floor, solid


@lru_cache
def aruco_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Dictionary of a name.

    Args:
        name: one of `OWN_DICTIONARIES`, or an OpenCV dictionary without its DICT_ prefix.

    Raises:
        AttributeError: when OpenCV has no such dictionary.
    """
    if name not in OWN_DICTIONARIES:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    patterns = [
        np.array([[int(bit) for bit in row] for row in rows.split()], np.uint8) for rows in OWN_DICTIONARIES[name]
    ]
    as_bytes = [cv2.aruco.Dictionary.getByteListFromBits(pattern) for pattern in patterns]
    # Bits that may be wrong where OpenCV decodes: half the least distance, rounded down, less than half.
    return cv2.aruco.Dictionary(np.concatenate(as_bytes), len(patterns[0]), 1)


@lru_cache
def _bits(dictionary: str, identity: int) -> NDArray[np.bool_]:
    chosen = aruco_dictionary(dictionary)
    pattern = chosen.generateImageMarker(identity, chosen.markerSize + 2, borderBits=1) > 127
    pattern.flags.writeable = False
    return pattern


def _quad(points: list, outward: object) -> FloatArray:
    """Four corners (4, 3), reordered where needed so that they wind counter-clockwise as seen from outside."""
    quad = np.asarray(points, float)
    normal = np.cross(quad[1] - quad[0], quad[2] - quad[0])
    return quad if normal @ np.asarray(outward, float) > 0 else quad[::-1]


def _join(quads: list[FloatArray]) -> Mesh:
    """Vertices (4n, 3) and triangles (2n, 3) of n quads."""
    first = 4 * np.arange(len(quads), dtype=np.uint32)[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2], np.uint32), first + np.array([0, 2, 3], np.uint32)])
    return np.concatenate(quads), faces
