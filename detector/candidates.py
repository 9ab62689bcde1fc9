"""Candidates for the ArUco: dark squares enclosed by something brighter, on a locally thresholded image.

The image keeps its full bit depth: a pixel counts as bright where it exceeds the mean of its surroundings by some noise
deviations, or where it saturates. The ArUco's border then is a dark component that the ring cuts off from the rest,
whatever the brightness of the surroundings. Smoothed and binned copies find markers of low contrast.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.noise import NoiseModel
from radiometry.geometry import FloatArray

#: Smallest side of a candidate [px of the searched copy].
MIN_SIDE_PX = 5
#: A dark component fills at least this part of its bounding box: a turned 4×4 pattern of mostly white bits has 0.25.
MIN_FILL = 0.15


class Look(NamedTuple):
    """One pass over the image."""

    binning: int
    blur: float  # Gaussian after binning, standard deviation [px of the copy]; 0 for none
    window: int  # side of the surroundings [px of the copy]
    sigmas: float  # bright is this many noise deviations above the mean of the surroundings


#: The narrow window keeps glaring foil out and finds the smallest markers; the wide one bears more noise. On smoothed
#: copies a lower threshold keeps a faint ring closed, and correlated specks stay apart.
LOOKS = (
    Look(1, 0.0, 7, 2.0), Look(1, 0.5, 7, 0.5), Look(1, 0.7, 13, 1.5), Look(1, 1.0, 9, 0.5), Look(2, 0.9, 9, 0.5),
    Look(4, 0.9, 9, 0.5),
)  # fmt: skip


def dark_squares(
    image: NDArray[np.float32], window: int, threshold: tuple[float | NDArray[np.float32], float], ceiling: float
) -> list[FloatArray]:
    """Quadrilaterals (4, 2) [px], clockwise as seen, around dark components of a float32 image (H, W).

    `window`: side of the surroundings [px]. Bright is what exceeds their mean by √(c₀ + c₁ · mean), `threshold` (c₀, c₁;
    c₀ may be of each pixel, (H, W)), or reaches the `ceiling`.
    """
    mean = cv2.blur(image, (window, window), borderType=cv2.BORDER_REPLICATE)
    constant, slope = threshold
    if slope > 0:
        limit = mean * np.float32(slope)
        limit += np.asarray(constant, np.float32)
        np.sqrt(np.maximum(limit, np.float32(0), out=limit), out=limit)
        limit += mean
    else:
        limit = np.asarray(mean + np.sqrt(np.asarray(constant, np.float32)))
    dark = image <= np.minimum(limit, np.nextafter(np.float32(ceiling), np.float32(-np.inf)), out=limit)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dark.view(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    left, top, width, height, area = stats.T
    h, w = image.shape
    fits = (np.minimum(width, height) >= MIN_SIDE_PX) & (area >= MIN_FILL * width * height)
    # The ring is outside the component, so a whole marker never touches the image's border.
    fits &= (left > 0) & (top > 0) & (left + width < w) & (top + height < h)
    fits[0] = False
    quads = []
    for k in np.flatnonzero(fits):
        x, y, bw, bh = left[k] - 1, top[k] - 1, width[k] + 2, height[k] + 2
        quad = _quadrilateral((labels[y : y + bh, x : x + bw] == k).view(np.uint8))
        if quad is not None:
            quads.append(quad + np.array([x, y]))
    return quads


def _quadrilateral(mask: np.ndarray) -> FloatArray | None:
    """Four corners (4, 2) of a mask's outline, clockwise as seen, or None where the outline is no quadrilateral."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)
    hull = cv2.convexHull(outline)
    # Contours run through pixel centres; half a pixel lies outside all around.
    perimeter = cv2.arcLength(hull, True)
    hull_area = cv2.contourArea(hull) + perimeter / 2 + 1
    inside = cv2.contourArea(outline) + cv2.arcLength(outline, True) / 2 + 1
    if inside < 0.75 * hull_area or len(hull) < 4:
        return None
    corners = cv2.approxPolyN(hull, 4, ensure_convex=True).reshape(-1, 2).astype(float)
    if len(corners) != 4:
        return None
    side = np.roll(corners, -1, 0) - corners
    length = np.linalg.norm(side, axis=1)
    turn = side[:, 0] * np.roll(side[:, 1], -1) - side[:, 1] * np.roll(side[:, 0], -1)
    if length.min() < 0.35 * length.max() or length.min() < MIN_SIDE_PX - 2 or np.ptp(np.sign(turn)) != 0:
        return None
    if turn[0] < 0:  # counter-clockwise in an image whose y runs down
        corners = corners[::-1]
    quad_area = cv2.contourArea(corners.astype(np.float32)) + perimeter / 2
    if not 0.75 < quad_area / hull_area < 1.35:
        return None
    centre = corners.mean(0)
    return centre + (corners - centre) * (1 + 1.0 / length.mean())


def search(image: np.ndarray, noise: NoiseModel) -> Iterator[tuple[FloatArray, float]]:
    """Candidate quadrilaterals in the image's pixels and the blur [px] they were seen through.

    Pass by pass: the plain image, then smoothed, then binned copies.
    """
    plain = image.astype(np.float32)
    gain, ceiling = noise.gain_dn_per_electron, noise.saturated_above_dn
    constant = noise.read_noise_dn**2 - gain * noise.offset_dn
    extra = noise.extra_variance_dn2
    if extra is not None:  # a clipped reading that says nothing to a fit still is bright or dark
        extra = np.where(np.isfinite(extra), extra, 0.0).astype(np.float32)
    for look in LOOKS:
        shape = (image.shape[1] // look.binning, image.shape[0] // look.binning)
        if min(shape) < 16:
            return
        copy, averaged = plain, 1.0
        if look.binning > 1:
            copy = _binned(plain, shape, look.binning)
        if look.blur > 0:
            copy = np.asarray(cv2.GaussianBlur(copy, (0, 0), look.blur), np.float32)
            # A Gaussian of deviation s averages over 4πs² pixels.
            averaged = 4 * np.pi * (look.blur * look.binning) ** 2
        scale = look.sigmas**2 / averaged
        offset: float | NDArray[np.float32] = scale * constant
        if extra is not None:
            offset = np.float32(offset) + np.float32(scale) * _binned(extra, shape, look.binning)
        for quad in dark_squares(copy, look.window, (offset, scale * gain), ceiling):
            yield quad * look.binning + (look.binning - 1) / 2, look.blur * look.binning


def _binned(image: NDArray[np.float32], shape: tuple[int, int], binning: int) -> NDArray[np.float32]:
    """Means over squares of `binning` pixels; `shape` is the result's (width, height)."""
    if binning == 1:
        return image
    whole = image[: shape[1] * binning, : shape[0] * binning]
    return np.asarray(cv2.resize(whole, shape, interpolation=cv2.INTER_AREA), np.float32)
