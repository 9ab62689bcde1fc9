"""Mean electron rate of a whole frame in the closed form: the light that veiling glare spreads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radiometry.geometry import FloatArray
from scenes.transport import View

#: Electron rate (n,) of points (n, 3) of the marker's plane, were they of a material.
Rate = Callable[[FloatArray, str], FloatArray]

#: Points of the frame, across and down, at which the face is evaluated.
_ACROSS, _DOWN = 32, 24


def mean_frame_rate(view: View, rate: Rate) -> float:
    """Mean electron rate of a frame's pixels [e⁻/s].

    The face counts as a flat sheet in the marker's plane, sampled on a grid of the frame; the marker by its area in the image,
    with the share of it that is printed tape. Light out of its slits, and an Earth behind the target, are left out.
    """
    camera, target, marker = view.camera, view.target, view.marker
    columns = (np.arange(_ACROSS) + 0.5) * camera.width_px / _ACROSS - 0.5
    rows = (np.arange(_DOWN) + 0.5) * camera.height_px / _DOWN - 0.5
    points = view.to_plane(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    reach = np.abs(points[:, :2]).max(axis=1)
    face = points[(reach < target.face_m / 2) & (reach >= marker.size_m / 2)]
    total = rate(face, target.face_material).sum() / len(points) if len(face) else 0.0

    x, y = view.to_image(marker.corners_m * (marker.size_m / marker.aruco_m)).T
    x, y = x.clip(-0.5, camera.width_px - 0.5), y.clip(-0.5, camera.height_px - 0.5)
    area_px = abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2  # shoelace formula
    x0, x1, y0, y1 = marker.reflective_rectangles_m().T
    printed = float(np.sum((x1 - x0) * (y1 - y0))) / marker.size_m**2
    tape, black = (rate(np.zeros((1, 3)), name)[0] for name in (target.tape_material, target.absorber_material))
    return float(total + area_px / (camera.width_px * camera.height_px) * (printed * tape + (1 - printed) * black))
