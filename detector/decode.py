"""Which identity and which of the four turns best explains the pixels within a quadrilateral.

Rather than thresholding sampled bits, every pattern of the dictionary is rendered through the homography with the
blur of lens and pixel, and fitted with a free level and amplitude; all of it in the space of cells, where the patterns
are linear. Blur between neighbouring bits is then part of the signal instead of an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from detector.corners import gather
from detector.noise import NoiseModel
from detector.pattern import SQUARE, Pattern, PixelSet, homography, pixels_within
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign, aruco_dictionary

#: Most pixels a decode uses: about eight per cell of the default dictionary.
MAX_PIXELS = 500


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
            cells += [Pattern.with_bits(np.rot90(bits, -turn)).ravel() for turn in range(4)]
        self.templates = np.array(cells)

    def decode(
        self, image: np.ndarray, corners_px: FloatArray, sigma_px: float, noise: NoiseModel
    ) -> tuple[Decoded, Decoded] | None:
        """Best match over all identities, and over this marker's identity; None where the quadrilateral holds too little."""
        origin = np.round(corners_px.mean(0))
        matrix = homography(corners_px - origin)
        reach = 1 + 2 * self.pattern.marker.ring_fraction
        absolute = homography(corners_px)
        pixels = pixels_within(absolute, reach, (image.shape[0], image.shape[1]), most=MAX_PIXELS)
        pixels = noise.readable(pixels)
        if len(pixels) < 40:
            return None
        data = np.minimum(gather(image, pixels), noise.saturated_above_dn)
        grain = float(noise.at(pixels).variance(data).sum())
        data -= data.mean()
        # What noise adds to the variance is no fault of the match; it never is all of it.
        power = float(data @ data)
        power = max(power - grain, 0.1 * power)
        if power <= 0:
            return None
        across, up = self.pattern.cell_responses(PixelSet(pixels - origin, matrix, sigma_px))
        basis = (across[:, :, None] * up[:, None, :]).reshape(len(pixels), -1)
        basis -= basis.mean(0)
        match = self.templates @ (basis.T @ data)
        norm = np.einsum("ti,ti->t", self.templates @ (basis.T @ basis), self.templates)
        correlation = (match / np.sqrt(np.maximum(norm, 1e-12) * power)).reshape(-1, 4)
        best = correlation.max(1)
        first = int(best.argmax())
        return self._result(correlation, best, first), self._result(correlation, best, self.own)

    @staticmethod
    def _result(correlation: FloatArray, best: FloatArray, identity: int) -> Decoded:
        rival = float(np.delete(best, identity).max()) if len(best) > 1 else 0.0
        return Decoded(identity, int(correlation[identity].argmax()), float(best[identity]), rival)


@lru_cache(maxsize=8)
def decoder_of(marker: MarkerDesign) -> Decoder:
    """The decoder of a marker; made once, as a dictionary's patterns take longer than a frame."""
    return Decoder(marker)


def has_ring(image: np.ndarray, corners_px: FloatArray, pattern: Pattern, noise_dn: float) -> bool:
    """Cheap first test of a quadrilateral: all four sides of a reflective ring outshine all four of the border inside.

    `noise_dn`: of a single pixel; the weakest and the strongest mean of eight pixels may cross by that much.
    """
    matrix = cv2.getPerspectiveTransform(SQUARE.astype(np.float32), corners_px.astype(np.float32))
    points = pattern.probes @ matrix[:, :2].T + matrix[:, 2]
    at = np.rint(points[:, :2] / points[:, 2:])
    if not ((at >= 0) & (at < image.shape[::-1])).all():
        return False
    bright, dark = gather(image, at).reshape(2, 4, -1).mean(2)
    return bool(
        (bright > dark).all() and bright.mean() > dark.mean() + noise_dn and bright.min() > dark.max() - noise_dn
    )
