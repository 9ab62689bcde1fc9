"""Which pixels see a bit of the marker."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiometry import link
from radiometry.geometry import FloatArray
from scenes.view import View

#: Pixels across a bit's window: enough for the mean of what varies smoothly over it.
_ACROSS = 32


def bit_scale_px(scene_view: View) -> tuple[float, float]:
    """Pixels per metre along the marker's x and y axes at its centre, foreshortening included.

    Args:
        scene_view: of the marker.
    """
    step = 1e-4
    ends = scene_view.to_image(np.array([[step, 0, 0], [-step, 0, 0], [0, step, 0], [0, -step, 0]]))
    return (
        float(np.linalg.norm(ends[0] - ends[1]) / (2 * step)),
        float(np.linalg.norm(ends[2] - ends[3]) / (2 * step)),
    )


def bit_pixels(scene_view: View, centres_m: FloatArray) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Pixels that count as each bit: those within `link.sampling_window_px` of its centre, or else the nearest one.

    Of a wide window every second, third … row and column is taken, so that no more than `_ACROSS` pixels lie across it.

    Args:
        scene_view: of the marker.
        centres_m: centres of the bits in the marker frame, (n, 3) [m].

    Returns:
        For each bit, rows (k,) and columns (k,) of its pixels; empty where the bit lies outside the frame.
    """
    scale = np.array(bit_scale_px(scene_view))
    half = link.sampling_window_px(scene_view.marker.bit_m * scale) / 2
    step = int(np.ceil(2 * half.max() / _ACROSS))
    reach = (int(np.ceil(half.max() * 1.5)) // step + 1) * step
    offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1, step)] * 2), axis=-1).reshape(-1, 2)
    size = np.array([scene_view.camera.width_px, scene_view.camera.height_px])
    pixels = []
    for centre, middle in zip(scene_view.to_image(centres_m), centres_m, strict=True):
        nearest = np.rint(centre).astype(int)
        nearby = nearest + offsets
        nearby = nearby[np.all((nearby >= 0) & (nearby < size), axis=1)]
        inside = np.all(np.abs(scene_view.to_plane(nearby) - middle[:2]) * scale <= half, axis=1)
        if not inside.any():
            inside = np.all(nearby == nearest, axis=1)
        column, row = nearby[inside].T
        pixels.append((row, column))
    return pixels
