"""Pixels that do not see: hot, dead or listed as bad. They are told from light by standing alone, or by a map."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel

#: A pixel is a defect where it differs from the median of its surroundings by this many noise deviations, and by this many times
#: what any of its four neighbours differs: a point of light reaches its neighbours more through a point spread of 0.35 px.
STANDS_OUT_SIGMAS, STANDS_ALONE = 8.0, 8.0


def isolated(image: NDArray[np.generic], noise: NoiseModel) -> NDArray[np.bool_]:
    """Mask (h, w) of the pixels of an image (h, w) [DN] that stand alone as no light through a lens does."""
    data = np.ascontiguousarray(image, np.float32)
    middle = cv2.medianBlur(data, 3)
    off = np.abs(data - middle)
    limit = noise.read_noise_dn**2 + noise.gain_dn_per_electron * np.maximum(middle - noise.offset_dn, 0)
    out = off > STANDS_OUT_SIGMAS * np.sqrt(limit)
    if not out.any():
        return np.asarray(out)
    padded = np.pad(data, 1, mode="edge")
    for beside in (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]):
        out &= off > STANDS_ALONE * np.abs(beside - middle)
    return np.asarray(out)


def mended(image: NDArray[np.generic], bad: NDArray[np.bool_]) -> NDArray[np.generic]:
    """A copy of an image (h, w) in which every bad pixel has the mean of the nearest good ones around it."""
    result, missing = image.copy(), bad.copy()
    data, good = np.where(bad, 0, image).astype(np.float64), (~bad).astype(np.float64)
    for side in (3, 5, 9, 17):
        if not missing.any():
            break
        total = cv2.boxFilter(data, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        count = cv2.boxFilter(good, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        filled = missing & (count > 0.5)
        value = total[filled] / count[filled]
        result[filled] = np.rint(value) if np.issubdtype(image.dtype, np.integer) else value
        missing &= ~filled
    return result


def without(noise: NoiseModel, bad: NDArray[np.bool_]) -> NoiseModel:
    """The noise of an image (h, w) whose bad pixels say nothing."""
    extra = np.zeros(bad.shape) if noise.extra_variance_dn2 is None else noise.extra_variance_dn2
    return replace(noise, extra_variance_dn2=np.where(bad, np.inf, extra))
