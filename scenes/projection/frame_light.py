"""Mean electron rate of a whole frame in closed form: the light that veiling glare spreads over the frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radiometry.geometry import FloatArray
from scenes.projection.visible import visible_tape
from scenes.view import View

#: Electron rate (n,) of points (n, 3) of the marker's plane, were they of a material.
Rate = Callable[[FloatArray, str], FloatArray]

#: Points of the frame, across and down, at which the face is evaluated.
_ACROSS, _DOWN = 32, 24


def mean_frame_rate(view: View, rate: Rate) -> float:
    """Mean electron rate of a frame's pixels [e⁻/s].

    The face counts as a flat sheet in the marker's plane and is sampled on a grid of the frame. The marker counts by the
    areas of tape and of the rest in the image, both lit as at the marker's centre. An Earth behind the target is left out.
    Against rendered frames from 1 to 20 m the result is within 3 % for a flat face. For the default crinkled foil, whose
    facets turn gloss away, it is up to 25 % too bright.

    Args:
        view: of the target.
        rate: electron rate (n,) [e⁻/s] that points (n, 3) of the marker's plane [m] would give if they were of a material.
    """
    camera, target, marker = view.camera, view.target, view.marker
    columns = (np.arange(_ACROSS) + 0.5) * camera.width_px / _ACROSS - 0.5
    rows = (np.arange(_DOWN) + 0.5) * camera.height_px / _DOWN - 0.5
    points = view.to_plane(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    points = np.column_stack([points, np.zeros(len(points))])
    on_face = np.abs(points[:, :2] - target.face_centre_m).max(axis=1) < target.face_m / 2
    face = points[on_face & (np.abs(points).max(axis=1) >= marker.size_m / 2)]
    total = rate(face, target.face_material).sum() / len(points) if len(face) else 0.0

    # Areas in the image, in pixels, of the tape that the camera sees and of the marker's front.
    frame = np.array([camera.width_px, camera.height_px])
    cells, shares = visible_tape(view)
    front = view.to_image(marker.corners_m * (marker.size_m / marker.aruco_m))
    tape_px = float(shares @ _area(cells.clip(-0.5, frame - 0.5)))
    black_px = float(_area(front.clip(-0.5, frame - 0.5))) - tape_px
    tape, black = (rate(np.zeros((1, 3)), name)[0] for name in (target.tape_material, target.absorber_material))
    return float(total + (tape_px * tape + black_px * black) / frame.prod())


def _area(polygons: FloatArray) -> FloatArray:
    """Areas of polygons (..., k, 2) by the shoelace formula."""
    x, y = polygons[..., 0], polygons[..., 1]
    return np.abs(np.sum(x * np.roll(y, 1, axis=-1) - y * np.roll(x, 1, axis=-1), axis=-1)) / 2
