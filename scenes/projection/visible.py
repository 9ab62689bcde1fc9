"""What the camera sees of the marker: tape on its plane and through its slits; and what the marker hides of the face."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

from radiometry.geometry import FloatArray
from scenes.marker import Element, MarkerDesign
from scenes.target import face_mesh
from scenes.view import View

#: Sine of the Sun's height below which it gives the face nothing, while the marker's shadow is endless.
_GRAZING = 1e-6


def visible_tape(view: View) -> tuple[FloatArray, FloatArray]:
    """Where the camera sees tape, and how much of each place is tape.

    Printed cells count fully. Behind an element's opening, each slit counts with the share of its pitch through which the
    floor is seen, in the strip that the side walls leave free. Light is taken to come in as it goes out to the camera. That
    is right for the LEDs; the Sun stands aside and reaches less of the floors.

    Args:
        view: of the marker.

    Returns:
        Quadrilaterals of the image (m, 4, 2) [px], and the share of each that is tape, (m,).
    """
    camera = view.to_marker(np.zeros(3))
    x0, x1, y0, y1 = view.marker.reflective_rectangles_m().T
    printed = np.stack([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]).transpose(2, 0, 1)
    slits = [_slits(view.marker, element, camera) for element in view.marker.elements]
    corners = np.concatenate([printed, *(quads for quads, _ in slits)])
    shares = np.concatenate([np.ones(len(printed)), *(share for _, share in slits)])
    seen = shares > 0
    on_plane = np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=-1)
    return view.to_image(on_plane[seen]), shares[seen]


def hidden_face(view: View) -> dict[str, FloatArray]:
    """Convex outlines, in the image, of what the marker hides of the face.

    For the LEDs it is what the marker hides from the camera, because they stand beside it. For the Sun it is the hull of
    that and of the marker's shadow. The face counts as flat, at its mean depth.

    Args:
        view: of the target.

    Returns:
        Outlines (k, 2) [px] by light, 'led' and 'sun'.
    """
    half, back = view.marker.size_m / 2, -view.marker.thickness_m
    square = half * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    box = np.concatenate([np.column_stack([square, np.full(4, z)]) for z in (0.0, back)])
    result = {"led": _hull(view.to_image(box)), "sun": _hull(view.to_image(box))}
    to_sun = view.sun_in_marker
    if to_sun[2] > _GRAZING:
        depth = face_mesh(view.target, view.marker)[0][:, 2].mean()
        shadow = box - ((box[:, 2] - depth) / to_sun[2])[:, None] * to_sun
        result["sun"] = _hull(view.to_image(np.concatenate([box, shadow])))
    return result


def _hull(points: FloatArray) -> FloatArray:
    return points[ConvexHull(points).vertices]


def _slits(marker: MarkerDesign, e: Element, camera_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners of an element's slits on the front plane (n, 4, 2) [m], and the share of each that shows its floor (n,)."""
    edges = np.linspace(-e.length_m / 2, e.length_m / 2, marker.slit_count + 1)
    u, pitch = (edges[:-1] + edges[1:]) / 2, e.length_m / marker.slit_count
    fall = e.depth_m / camera_m[2]  # of a line of sight: sideways per distance off the camera's foot, down to the floor
    # Slats lie in planes through the virtual line, so name a point by where its plane cuts the front: a line of sight that keeps
    # its name stays between two slats, one whose name shifts by an opening's width meets a slat wherever it enters.
    below = u + fall * (u - camera_m @ e.along)
    name = e.virtual_offset_m + (below - e.virtual_offset_m) / (1 - e.depth_m / e.virtual_depth_m)
    share = np.clip(1 - marker.slat_fraction - np.abs(name - u) / pitch, 0.0, None)
    half, foot = e.width_m / 2, fall * ((camera_m - e.centre_m) @ e.across)
    low, high = max(-half, (foot - half) / (1 + fall)), min(half, (foot + half) / (1 + fall))
    quads = [
        [(e.centre_m + a * e.along + v * e.across)[:2] for a, v in ((a0, low), (a1, low), (a1, high), (a0, high))]
        for a0, a1 in pairwise(edges)
    ]
    return np.array(quads), share * (low < high)
