"""Candidates for the ArUco: dark squares enclosed by something brighter, on a locally thresholded image.

The image keeps its full bit depth: a pixel counts as bright where it exceeds the mean of its surroundings by some noise
deviations, or where it saturates. The ArUco's border then is a dark component that the ring cuts off from the rest,
whatever the brightness of the surroundings. Places of high contrast are looked at first; where they hold no marker, the
whole image is, and smoothed and binned copies of it, which find markers of low contrast.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray

Image = NDArray[np.float32]
#: A rectangle of pixels: x, y, width, height.
Place = tuple[int, int, int, int]

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
    Look(1, 0.0, 7, 2.0),
    Look(1, 0.5, 7, 0.5),
    Look(1, 0.7, 13, 1.5),
    Look(1, 1.0, 9, 0.5),
    Look(2, 0.9, 9, 0.5),
    Look(2, 0.5, 7, 0.5),
    Look(4, 0.9, 9, 0.5),
    Look(4, 0.5, 7, 0.5),
    Look(8, 0.5, 7, 0.5),
)
#: Places of high contrast: means over CELL × CELL pixels that exceed the lowest of their surroundings (cells) by one of these
#: parts of the frame's highest contrast, and by this many deviations of a single pixel's noise.
CELL, SURROUNDINGS, CONTRASTS, CONTRAST_SIGMAS = 4, 5, (0.3, 0.06), 2.0
#: Smallest side of a place worth a look [cells]; most places; and the part of the image they may fill. Beyond either, looking
#: at the whole image costs less.
MIN_PLACE, MAX_PLACES, MAX_FILLED = 5, 12, 0.4
#: A place is binned to this many pixels a side at most before it is looked at.
PLACE_PX = 90


def dark_squares(
    image: Image, window: int, threshold: tuple[float | NDArray[np.float32], float], ceiling: float
) -> Iterator[FloatArray]:
    """Quadrilaterals around the dark components of an image, the largest first.

    Args:
        image: (height, width) float32 [DN].
        window: side of a pixel's surroundings [px].
        threshold: (c₀, c₁): a pixel is bright where it exceeds the mean of its surroundings by √(c₀ + c₁ · mean). c₀ may be given
            for each pixel, (height, width) [DN²]; c₁ is in DN.
        ceiling: a pixel that reaches this level is bright in any case [DN].

    Yields:
        Corners (4, 2), clockwise as seen [px].
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
    found = np.flatnonzero(fits)
    for k in found[np.argsort(-(width * height)[found], kind="stable")]:
        x, y, bw, bh = left[k] - 1, top[k] - 1, width[k] + 2, height[k] + 2
        quad = _quadrilateral((labels[y : y + bh, x : x + bw] == k).view(np.uint8))
        if quad is not None:
            yield quad + np.array([x, y])


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
    shape = cv2.approxPolyN(hull, 4, ensure_convex=True).reshape(-1, 2)
    if len(shape) != 4:
        return None
    points = shape.tolist()
    sides = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(points, points[1:] + points[:1], strict=True)]
    lengths = [math.hypot(*side) for side in sides]
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(sides, sides[1:] + sides[:1], strict=True)]
    if min(lengths) < max(0.35 * max(lengths), MIN_SIDE_PX - 2) or not (max(turns) < 0 or min(turns) > 0):
        return None
    area = abs(sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(points, points[1:] + points[:1], strict=True))) / 2
    if not 0.75 < (area + perimeter / 2) / hull_area < 1.35:
        return None
    corners = np.array(points if turns[0] > 0 else points[::-1], float)  # clockwise in an image whose y runs down
    centre = corners.mean(0)
    return centre + (corners - centre) * (1 + 4.0 / sum(lengths))


class _Copies:
    """Parts of an image as float32, binned, with what the threshold needs to know of their noise."""

    def __init__(self, image: np.ndarray, noise: NoiseModel):
        # Halving works in the integers of cameras; other numbers become real at once.
        self.image = image if image.dtype in (np.uint8, np.uint16) else image.astype(np.float32)
        self.gain, self.ceiling = noise.gain_dn_per_electron, noise.saturated_above_dn
        self.constant = noise.read_noise_dn**2 - self.gain * noise.offset_dn
        self.extra: Image | None = None
        if noise.extra_variance_dn2 is not None:
            # A clipped reading that says nothing to a fit still is bright or dark.
            extra = noise.extra_variance_dn2
            self.extra = np.where(np.isfinite(extra), extra, 0.0).astype(np.float32)

    def noise_dn(self, level: Image | np.floating) -> Image:
        """Noise of single pixels [DN] at levels (h, w) of cells; see `CELL`."""
        variance = level * np.float32(self.gain) + np.float32(self.constant)
        if self.extra is not None:
            variance += _binned(self.extra, CELL)
        return np.sqrt(np.maximum(variance, np.float32(0)))

    def squares(self, look: Look, place: Place | None = None) -> Iterator[tuple[FloatArray, float]]:
        """Quadrilaterals [px of the image] in a part of a binned copy, and the blur they were seen through [px]."""
        x, y, width, height = place or (0, 0, self.image.shape[1], self.image.shape[0])
        part = slice(y, y + height), slice(x, x + width)
        copy = _binned(self.image[part].astype(np.float32), look.binning)
        if min(copy.shape) < 16:
            return
        averaged = float(look.binning**2)
        if look.blur > 0:
            copy = np.asarray(cv2.GaussianBlur(copy, (0, 0), look.blur), np.float32)
            # A Gaussian of deviation s averages over 4πs² pixels.
            averaged = 4 * np.pi * (look.blur * look.binning) ** 2
        scale = look.sigmas**2 / averaged
        offset: float | Image = scale * self.constant
        if self.extra is not None:
            offset = np.float32(offset) + np.float32(scale) * _binned(self.extra[part], look.binning)
        blur = max(look.blur, 0.5 if look.binning > 1 else 0.0) * look.binning
        for quad in dark_squares(copy, look.window, (offset, scale * self.gain), self.ceiling):
            yield quad * look.binning + (look.binning - 1) / 2 + np.array([x, y]), blur


def search(image: np.ndarray, noise: NoiseModel) -> Iterator[tuple[FloatArray, float]]:
    """Candidates for the ArUco's outline: first where contrast is high, then in the whole image, smoothed and binned copies last.

    Args:
        image: (height, width) [DN].
        noise: of the image.

    Yields:
        Corners (4, 2) in the image, clockwise as seen [px], and the standard deviation of the blur they were seen through [px].
    """
    copies = _Copies(image, noise)
    for place in _places(copies):
        binning = 1
        while max(place[2:]) > PLACE_PX * binning and binning < 16:
            binning *= 2
        yield from copies.squares(Look(binning, 0.0, 7, 2.0), place)
    for look in LOOKS:
        yield from copies.squares(look)


def _places(copies: _Copies) -> Iterator[Place]:
    """Places of high contrast, those of the highest first."""
    cells = _binned(copies.image, CELL).astype(np.float32, copy=False)
    if min(cells.shape) < MIN_PLACE:
        return
    low = np.asarray(cv2.erode(cells, np.ones((SURROUNDINGS, SURROUNDINGS), np.uint8)), np.float32)
    contrast = cells - low
    highest, most_noise, seen = float(contrast.max()), CONTRAST_SIGMAS * copies.noise_dn(low.max()).max(), set()
    for part in CONTRASTS:
        limit: np.floating | Image = np.float32(part * highest)
        if limit < most_noise:
            limit = np.maximum(np.float32(CONTRAST_SIGMAS) * copies.noise_dn(low), limit)
        active = cv2.dilate((contrast > limit).view(np.uint8), np.ones((3, 3), np.uint8))
        outlines, _ = cv2.findContours(active, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        boxes = [box for box in map(cv2.boundingRect, outlines) if min(box[2:]) >= MIN_PLACE]
        if len(boxes) > MAX_PLACES or sum(w * h for _, _, w, h in boxes) > MAX_FILLED * active.size:
            return
        for left, top, width, height in sorted(boxes, key=lambda box: -box[2] * box[3]):
            x, y = max(CELL * (left - 1), 0), max(CELL * (top - 1), 0)
            right, bottom = CELL * (left + width + 1), CELL * (top + height + 1)
            place = x, y, min(right, cells.shape[1] * CELL) - x, min(bottom, cells.shape[0] * CELL) - y
            if place not in seen:
                seen.add(place)
                yield place


def _binned(image: np.ndarray, binning: int) -> np.ndarray:
    """Means over squares of `binning` pixels, a power of two."""
    while binning > 1:
        height, width = image.shape[0] // 2, image.shape[1] // 2
        image = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
        binning //= 2
    return image
