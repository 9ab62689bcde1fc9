"""Pixels that do not see: hot, dead or listed as bad. They are told from light by standing alone, or by a map."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel

#: A pixel is a defect where it differs from the median of its surroundings by this many noise deviations, and by this many times
#: what any of its four neighbours stands above the lowest pixel around. A point of light reaches its neighbours more than that
#: through a point spread of 0.35 px.
STANDS_OUT_SIGMAS, STANDS_ALONE = 8.0, 8.0


def isolated(image: NDArray[np.generic], noise: NoiseModel) -> NDArray[np.bool_]:
    """Mask (h, w) of the pixels of an image (h, w) [DN] that stand alone as no light through a lens does."""
    data = np.ascontiguousarray(image, None if image.dtype in (np.uint8, np.uint16) else np.float32)
    middle = np.asarray(cv2.medianBlur(data, 3))
    out = np.zeros(data.shape, np.bool_)
    # Few pixels differ from the median by more than read noise; only these are looked at closely.
    rows, columns = np.nonzero(np.asarray(cv2.absdiff(data, middle)) > STANDS_OUT_SIGMAS * noise.read_noise_dn)
    level = middle[rows, columns].astype(float)
    off = np.abs(data[rows, columns] - level)
    alone = off > STANDS_OUT_SIGMAS * np.sqrt(noise.of(level, 0.0))
    # Light leaves its neighbours above the lowest pixel around it, and a dark spot leaves them below the highest.
    around = np.ones((3, 3), np.uint8)
    low, high = np.asarray(cv2.erode(data, around)), np.asarray(cv2.dilate(data, around))
    floor = np.where(data[rows, columns] > level, low[rows, columns], high[rows, columns]).astype(float)
    last_row, last_column = data.shape[0] - 1, data.shape[1] - 1
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = data[(rows + down).clip(0, last_row), (columns + right).clip(0, last_column)]
        at_edge = (rows + down < 0) | (rows + down > last_row) | (columns + right < 0) | (columns + right > last_column)
        alone &= at_edge | (off > STANDS_ALONE * np.abs(beside - floor))
    out[rows, columns] = alone
    return out


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
