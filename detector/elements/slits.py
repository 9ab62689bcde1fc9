"""What shows through the slits of an encoding element: the closed form of its blob.

Slats and end walls lie in planes through the virtual line, so between two of them a sight line that enters at the blob
goes straight to the floor, and one that enters at a distance from it meets the wall where that distance is too large. The
light's way is the same as the sight line's where the light stands at the lens; from a ring around the lens it enters a
little beside it, so that part of the floor that is seen is dark.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from detector.compiled import kernel, normal_cdf
from radiometry.geometry import FloatArray
from scenes.marker import Element, MarkerDesign

#: Eight lights that stand for a ring of radius 1: distances from the lens along the element of points evenly around it.
_RING = np.cos(np.pi * (np.arange(8) + 0.5) / 8)


def _dot(one: Sequence[float] | FloatArray, two: FloatArray) -> float:
    """Scalar product of two vectors (3,): for so few NumPy takes ten times as long."""
    return float(one[0] * two[0] + one[1] * two[1] + one[2] * two[2])


class Slits:
    """The slits of one element as a camera (3,) in the marker frame sees them, with lights on a ring around its lens [m].

    Coordinates run along the element from the marker's centre [m].
    """

    def __init__(self, marker: MarkerDesign, element: Element, camera_m: FloatArray, light_ring_m: float = 0.0):
        self.pitch = element.length_m / marker.slit_count
        self.start = element.shift_m - element.length_m / 2
        self.count = marker.slit_count
        self.half_slat = marker.slat_fraction * self.pitch / 2
        depth = element.depth_m
        range_m = max(float(camera_m[2]), depth)
        #: Rate at which the sight line leaves the slit's wall, per metre between slit and blob, over the depth.
        leave = depth * (1 / range_m + 1 / element.virtual_depth_m)
        #: How far the edge of the seen floor moves per distance between slit and blob.
        self.follow = leave / (1 - depth / element.virtual_depth_m + leave)
        #: Distance from the blob at which a slit shows nothing [m].
        self.half_width = (self.pitch - 2 * self.half_slat) / self.follow
        # Across the slits a floor point hides behind the side wall where the sight line is oblique.
        x, y, z = camera_m.tolist()
        k, across = depth / range_m, _dot((x, y, z), element.across) - _dot(element.centre_m, element.across)
        side = element.width_m / 2
        #: Ends of the seen floor across the slits, from the element's centre [m].
        self.across = max((-side + across * k) / (1 + k), -side), min((side + across * k) / (1 + k), side)
        #: How far beside the sight line each light's way enters the slits (k,) [m].
        self.beside = np.zeros(1)
        if light_ring_m > 0:
            # The ring is square to the line of sight, near enough; tilted, it is narrower along the element.
            tilt = _dot((x, y, z), element.along) / math.sqrt(x * x + y * y + z * z)
            self.beside = _RING * (light_ring_m * math.sqrt(1 - tilt**2) * depth / (depth + range_m))
        #: Start, pitch, half slat and follow, for the kernels.
        self.numbers = np.array([self.start, self.pitch, self.half_slat, self.follow])

    @property
    def middle(self) -> float:
        """Middle of the opening [m]."""
        return self.start + self.count * self.pitch / 2

    def seen_up_to(self, u: FloatArray, blob: FloatArray) -> FloatArray:
        """Length of lit floor seen below each u (n,) for each blob coordinate (k,), mean over the lights, (k, n) [m]."""
        low = self.start + self.half_slat + self.pitch * np.arange(self.count)
        high = low + self.pitch - 2 * self.half_slat
        away = np.asarray(blob)[:, None]
        wall_low = (low + np.maximum((away - low) * self.follow, 0))[..., None]
        wall_high = (high + np.minimum((away - high) * self.follow, 0))[..., None]
        lit_low = np.maximum(wall_low, low[:, None] - self.beside)[..., None]
        lit_high = np.minimum(wall_high, high[:, None] - self.beside)[..., None]
        length = np.clip(np.asarray(u) - lit_low, 0, np.maximum(lit_high - lit_low, 0))
        return np.asarray(length.mean(2).sum(1))

    def cut_fraction(self, blob: float) -> float:
        """Part of the blob's triangle that lies beyond the ends of the element."""
        room = min(max((self.count * self.pitch / 2 - abs(blob - self.middle)) / self.half_width, -1.0), 1.0)
        return (1 - room) ** 2 / 2 if room > 0 else 1 - (1 + room) ** 2 / 2


@kernel
def lit_cells(numbers, slit_count, beside, blob, grid, lit) -> None:
    """Part of each cell where lit floor is seen, mean over the lights. `grid`: start of the first cell, and a cell's size [m]."""
    low, step = grid
    start, pitch, half_slat, follow = numbers
    cells, share = len(lit), 1.0 / len(beside)
    lit[:] = 0.0
    for slit in range(slit_count):
        left = start + slit * pitch + half_slat
        right = left + pitch - 2 * half_slat
        wall_left, wall_right = left + max((blob - left) * follow, 0.0), right + min((blob - right) * follow, 0.0)
        if wall_left >= wall_right:
            continue
        for way in beside:
            a, b = (max(wall_left, left - way) - low) / step, (min(wall_right, right - way) - low) / step
            a, b = max(a, 0.0), min(b, float(cells))
            if a >= b:
                continue
            first, last = int(a), min(int(b), cells - 1)
            if first == last:
                lit[first] += (b - a) * share
                continue
            lit[first] += (first + 1 - a) * share
            for cell in range(first + 1, last):
                lit[cell] += share
            lit[last] += (b - last) * share


#: How far the blur reaches, in deviations.
BLUR_REACH = 4.5


@kernel
def blur_taps(blur, cells_per_sigma):
    """Size of a grid's cells [m], so many per deviation of the blur, and the weights (2n + 1,) of the cells around a place.

    `blur`: standard deviation of the point spread, and the two sides of a pixel projected onto the element [m]. Their
    convolution is a trapezoid blurred by a Gaussian, a fourth difference of ∫∫ of the Gaussian.
    """
    sigma, wide, narrow = blur[0], max(blur[1], blur[2]), min(blur[1], blur[2])
    step = math.sqrt(sigma**2 + (wide**2 + narrow**2) / 12) / cells_per_sigma
    # Cells and the interpolation between them blur by step²/12 and step²/6; the Gaussian does the rest.
    sigma = math.sqrt(max(sigma**2 - step**2 / 4, 0.01 * step**2))
    narrow = max(narrow, 0.01 * wide)
    reach = math.ceil(BLUR_REACH * cells_per_sigma)
    taps = np.empty(2 * reach + 1)
    for k in range(-reach, reach + 1):
        tap = 0.0
        for one in (-1.0, 1.0):
            for two in (-1.0, 1.0):
                z = (k * step + (one * wide + two * narrow) / 2) / sigma
                tap += one * two * (z * normal_cdf(z) + math.exp(-0.5 * z * z) / math.sqrt(2 * math.pi))
        taps[k + reach] = tap
    return step, taps / taps.sum()


@kernel
def blurred_cells(numbers, slit_count, beside, blob, step, taps):
    """Light of a blob in cells (n,) along the element, blurred by taps; 1 is fully lit floor.

    The grid is centred on the element's middle and reaches beyond its ends, so cell k lies (k + 0.5 − n/2) cells from there.
    """
    length, reach = slit_count * numbers[1], len(taps) // 2
    cells = math.ceil(length / step) + 2 * reach + 4
    lit, blurred = np.empty(cells), np.zeros(cells)
    lit_cells(numbers, slit_count, beside, blob, (numbers[0] + length / 2 - cells / 2 * step, step), lit)
    for cell in range(cells):
        if lit[cell] > 0:
            for k in range(max(-reach, -cell), min(reach, cells - 1 - cell) + 1):
                blurred[cell + k] += lit[cell] * taps[k + reach]
    return blurred


@kernel
def blob_profile(numbers, slit_count, blurred, step, places, profile) -> None:
    """Light of a blob in `profile` (n,) at places (n,) along the element [m], from its cells; see `blurred_cells`."""
    cells, middle = len(blurred), numbers[0] + slit_count * numbers[1] / 2
    for p in range(len(places)):
        at = min(max((places[p] - middle) / step + cells / 2 - 0.5, 0.0), cells - 1.001)
        index = int(at)
        part = at - index
        profile[p] = blurred[index] * (1 - part) + blurred[index + 1] * part
