"""Where the rays of a pixel go: shifted rank-1 lattices, and the weights with which pixels gather them.

All pixels of one density share a lattice that repeats from pixel to pixel: points (s/N, s g mod N / N), shifted at random as a
whole (Sloan and Joe, Lattice Methods for Multiple Integration, 1994). The shift makes a pixel's mean unbiased. A pixel's error is
the sum of the image's spectrum, smoothed by the point spread, over the points of the dual lattice {h: h₁ + g h₂ ≡ 0 mod N}; an
edge's spectrum lies along its normal. So the generator g is chosen for each view such that the duals stay away from the two
directions in which the marker's edges, slats and bits run. The variance then falls with N² instead of jitter's N^1.5.
"""

from __future__ import annotations

from functools import lru_cache
from math import gcd

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from radiometry.geometry import FloatArray

#: Standard deviations of the point spread that a pixel gathers light from.
REACH_SIGMA = 4.0
#: Most generators tried for a lattice.
_CANDIDATES = 32
#: Point spread for which a generator is judged [px]: a duller image forgives more.
_JUDGED_SIGMA_PX = 0.5
#: Weight of what lies beside an edge's normal in the spectrum: edges end, and perspective turns them.
_ENDS = 0.02


def reach_px(psf_sigma_px: float) -> int:
    """Pixels by which a ray's own pixel can lie off a pixel that gathers it, along either axis."""
    return int(np.ceil(1.0 + REACH_SIGMA * psf_sigma_px)) - 1


def points(count: int, generator: int, shift: FloatArray) -> FloatArray:
    """Positions (count, 2) in a pixel, −0.5 … 0.5 from its centre, of a lattice shifted by (2,) in 0 … 1."""
    index = np.arange(count)
    unit = np.stack([index, index * generator % count], axis=-1) / count
    return (unit + shift) % 1.0 - 0.5


def axis_weights(positions_px: FloatArray, psf_sigma_px: float) -> FloatArray:
    """The kernel, point spread ⊗ pixel, of the pixels at −r … r along an axis, at positions (n,) in pixel 0: (n, 2r+1).

    Over all pixels it adds up to one, whatever the position; so do the weights, for all that the reach cuts off.
    """
    reach = reach_px(psf_sigma_px)
    away = positions_px[:, None] - np.arange(-reach, reach + 1)
    sigma = max(psf_sigma_px, 1e-6)
    kernel = ndtr((away + 0.5) / sigma) - ndtr((away - 0.5) / sigma)
    return kernel / kernel.sum(axis=1, keepdims=True)


def weights(positions_px: FloatArray, psf_sigma_px: float) -> NDArray[np.float32]:
    """Weights (n, (2r+1)²) with which the pixels around one, row by row, gather its rays at positions (n, 2)."""
    x, y = (axis_weights(positions_px[:, k], psf_sigma_px) for k in (0, 1))
    table = y[:, :, None] * x[:, None, :] / len(positions_px)
    return table.reshape(len(positions_px), -1).astype(np.float32)


def in_place_of(few: NDArray[np.float32], many: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (n, (2r+1)²) of a lattice's rays, scaled so that each pixel gathers as much as from another lattice's.

    Where the light is even over a pixel, few rays then stand for many, without a seam to neighbours that have many.
    """
    own, wanted = few.sum(axis=0), many.sum(axis=0)
    return few * np.where(own > 1e-6, wanted / np.maximum(own, 1e-6), 1.0).astype(np.float32)


def generator(count: int, normals: FloatArray, rank: int = 0) -> int:
    """Generator g of the lattice whose duals keep furthest from two directions in the image.

    Args:
        count: rays a pixel.
        normals: (2, 2), normals of the two families of edges in the image, x and y of each; any length.
        rank: 0 for the best generator, 1 for the next.
    """
    if count < 4:
        return 1
    angles = np.degrees(np.arctan2(normals[:, 1], normals[:, 0])) % 180.0
    first, second = sorted(round(float(a) * 2) / 2 % 180.0 for a in angles)
    return _ranked(count, first, second)[rank]


@lru_cache(maxsize=4096)
def _ranked(count: int, first_deg: float, second_deg: float) -> tuple[int, ...]:
    """Generators from the best to the worst for edges whose normals stand at two angles in the image."""
    tried, inverses = _generators(count)
    demerit = np.zeros(len(tried))
    for angle in np.radians([first_deg, second_deg]):  # 0 … π, so that the sine is not negative
        cosine, sine = np.cos(angle), np.sin(angle)
        # Walk along the longer component of the direction and take the dual next to it.
        if sine > abs(cosine):
            major, minor, factor = sine, cosine, tried
        else:
            major, minor, factor = abs(cosine), np.copysign(sine, cosine), inverses
        index = np.arange(1, count + 1)
        wanted = index * (minor / major)
        residue = -factor[:, None] * index % count
        nearest = residue + count * np.rint((wanted - residue) / count)
        along, across = index * major + nearest * minor, nearest * major - index * minor
        smooth = np.exp(-((2 * np.pi * _JUDGED_SIGMA_PX * across) ** 2))
        demerit += np.sum((smooth + _ENDS / (1 + across**2)) / np.maximum(along**2, 1), axis=1)
    return tuple(int(g) for g in tried[np.argsort(demerit, kind="stable")])


@lru_cache(maxsize=64)
def _generators(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Generators to try, spread evenly over those prime to the count, and their inverses modulo it."""
    prime = [g for g in range(2, count - 1) if gcd(g, count) == 1] or [1]
    tried = sorted({prime[int(k)] for k in np.linspace(0, len(prime) - 1, _CANDIDATES)})
    tried = tried * 2 if len(tried) == 1 else tried
    return np.array(tried, np.int64), np.array([pow(g, -1, count) for g in tried], np.int64)
