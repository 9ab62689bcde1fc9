"""Which identity and which of the four turns best explains the pixels within a quadrilateral.

Rather than thresholding sampled bits, every pattern of the dictionary is rendered through the homography with the
blur of lens and pixel, and fitted with a free level and amplitude; all of it in the space of cells, where the patterns
are linear. Blur between neighbouring bits is then part of the signal instead of an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from detector.compiled import BLOCK, kernel, mirror
from detector.pattern.corners import moved, sample, winsorised
from detector.pattern.pattern import Pattern, Sight, homography, inverse3, nearest_pixels, new_block, pixels_of, see
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign, aruco_dictionary

#: A quadrilateral is worth a fit from this correlation with the marker's own pattern on, or with another identity's. Chosen
#: between what markers and marker-free frames show.
MIN_CORRELATION, MIN_OTHER = 0.45, 0.9
#: Most pixels a decode uses: about six per cell of the default dictionary.
MAX_PIXELS = 350


@dataclass(frozen=True)
class Decoded:
    """Best match of a quadrilateral whose corners are numbered clockwise."""

    identity: int
    turn: int  # corners rolled by −turn start at the marker's top left
    correlation: float  # with the image less its noise; 1 is perfect
    rival: float  # the best correlation of any other identity


class Decoder:
    """All identities of a marker's dictionary in all four turns, as cells."""

    def __init__(self, marker: MarkerDesign):
        self.pattern = Pattern(marker)
        self.own = marker.identity
        dictionary = aruco_dictionary(marker.dictionary)
        count = dictionary.markerSize + 2
        cells = []
        for identity in range(len(dictionary.bytesList)):
            bits = dictionary.generateImageMarker(identity, count, borderBits=1) > 127
            # Turn k: the marker's top left is corner k of the quadrilateral, so the print appears turned clockwise.
            cells += [np.rot90(bits, -turn)[1:-1, 1:-1][::-1].T.ravel() for turn in range(4)]
        #: Cells inside the border, first index along x, second along y; then the ring, which all have.
        self.templates = np.pad(np.array(cells, float), ((0, 0), (0, 1)), constant_values=1.0)
        self.own_templates = self.templates[4 * self.own : 4 * self.own + 4]

    def decode(
        self, image: np.ndarray, corners_px: FloatArray, sigma_px: float, noise: NoiseModel
    ) -> tuple[Decoded, Decoded] | None:
        """Decode a quadrilateral: the best match over all identities, and over this marker's own.

        Args:
            image: (height, width) [DN].
            corners_px: corners of the quadrilateral, (4, 2), clockwise as seen [px].
            sigma_px: standard deviation of point spread and pixel box together [px].
            noise: of the image.

        Returns:
            Both matches; None where the quadrilateral holds too little, or clearly neither this marker's pattern nor any other.
        """
        origin = np.round(corners_px.mean(0))
        matrix = homography(corners_px - origin)
        reach = 1 + 2 * self.pattern.marker.ring_fraction
        columns, rows = pixels_of(moved(matrix, origin), reach, image.shape, 0.0, MAX_PIXELS)
        seen = winsorised(sample(image, columns, rows, origin, noise))
        if len(seen.data) < 40:
            return None
        size = self.templates.shape[1]
        normal, match = np.zeros((size, size)), np.zeros(size)
        sight = Sight(inverse3(matrix), self.pattern.lines, sigma_px)
        power, grain = _gather_cells(seen, sight, normal, match)
        # What noise adds to the variance is no fault of the match; it never is all of it.
        power = max(power - grain, 0.1 * power)
        if power <= 0 or not np.trace(normal) > 0:  # no reading differs from another, or none is of a cell
            return None
        own = self._correlations(self.own_templates, normal, match, power).max()
        if own < MIN_CORRELATION and self._ceiling(normal, match, power) < MIN_OTHER:
            return None
        correlation = self._correlations(self.templates, normal, match, power).reshape(-1, 4)
        best = correlation.max(1)
        first = int(best.argmax())
        return self._result(correlation, best, first), self._result(correlation, best, self.own)

    @staticmethod
    def _correlations(templates: FloatArray, normal: FloatArray, match: FloatArray, power: float) -> FloatArray:
        """Correlations (n,) of the data with the images of templates (n, cells)."""
        norm = ((templates @ normal) * templates).sum(1)
        return np.asarray((templates @ match) / np.sqrt(np.maximum(norm, 1e-12) * power))

    @staticmethod
    def _ceiling(normal: FloatArray, match: FloatArray, power: float) -> float:
        """Correlation that no pattern of these cells exceeds: that of the best grey levels."""
        regular = normal + 1e-9 * np.trace(normal) * np.eye(len(normal))
        return float(np.sqrt(max(float(match @ np.linalg.solve(regular, match)), 0.0) / power))

    @staticmethod
    def _result(correlation: FloatArray, best: FloatArray, identity: int) -> Decoded:
        rival = max(best[:identity].max(initial=0.0), best[identity + 1 :].max(initial=0.0))
        return Decoded(identity, int(correlation[identity].argmax()), float(best[identity]), float(rival))


@kernel
def _gather_cells(readings, sight, normal, match) -> tuple[float, float]:
    """Products (n, n) of the images of the cells inside the border and of the ring, their means removed, and with the data.

    Returns the data's sum of squares about its mean, and the part of it that is noise.
    """
    columns, rows, data, _, extra, noise, _ = readings
    last = len(sight.lines) - 2
    block = new_block(sight, columns, rows)
    first_x, share_x, _, _ = block.columns
    first_y, share_y, _, _ = block.rows
    size, inner, strips = len(match), len(sight.lines) - 5, len(share_x)
    value, where, total = np.empty(size), np.empty(size, np.int64), np.zeros(size)
    read_variance, gain, offset, limit = noise
    mean = 0.0
    for p in range(len(data)):
        mean += min(data[p], limit) / len(data)
    power = grain = 0.0
    for start in range(0, len(data), BLOCK):
        used = min(BLOCK, len(data) - start)
        see(block, sight, columns, rows, start, used)
        for p in range(used):
            reading = min(data[start + p], limit)
            grain += read_variance + gain * max(reading - offset, 0.0) + extra[start + p]
            reading -= mean
            power += reading * reading
            seen, ring = 0, 0.0
            for i in range(first_x[p], min(first_x[p] + strips, last + 1)):
                for j in range(first_y[p], min(first_y[p] + strips, last + 1)):
                    part = share_x[i - first_x[p], p] * share_y[j - first_y[p], p]
                    if i == 0 or j == 0 or i == last or j == last:
                        ring += part
                    elif 1 < i < last - 1 and 1 < j < last - 1:
                        value[seen], where[seen] = part, (i - 2) * inner + j - 2
                        seen += 1
            value[seen], where[seen] = ring, size - 1
            for a in range(seen + 1):
                total[where[a]] += value[a]
                match[where[a]] += value[a] * reading
                for b in range(a + 1):
                    normal[where[a], where[b]] += value[a] * value[b]
    for a in range(size):
        for b in range(a + 1):
            normal[a, b] -= total[a] * total[b] / len(data)
    mirror(normal)
    return power, grain


@lru_cache(maxsize=8)
def decoder_of(marker: MarkerDesign) -> Decoder:
    """The decoder of a marker; made once, as a dictionary's patterns take longer than a frame."""
    return Decoder(marker)


def has_ring(image: np.ndarray, corners_px: FloatArray, pattern: Pattern, noise_dn: float) -> bool:
    """Cheap first test of a quadrilateral: whether all four sides of a reflective ring outshine the dark border inside.

    Args:
        image: (height, width) [DN].
        corners_px: corners of the quadrilateral, (4, 2), clockwise as seen [px].
        pattern: what is printed.
        noise_dn: noise of a single pixel [DN]. The weakest side of the ring and the strongest side of the border, means over
            eight pixels, may cross by that much.
    """
    columns, rows = np.empty(len(pattern.probes), np.int64), np.empty(len(pattern.probes), np.int64)
    if not nearest_pixels(homography(corners_px), pattern.probes, image.shape[0], image.shape[1], columns, rows):
        return False
    bright, dark = image[rows, columns].astype(float).reshape(2, 4, -1).mean(2)
    return bool(
        (bright > dark).all() and bright.mean() > dark.mean() + noise_dn and bright.min() > dark.max() - noise_dn
    )
