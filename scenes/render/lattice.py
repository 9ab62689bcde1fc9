"""Where the rays of a pixel go: shifted rank-1 lattices, and the weights with which pixels gather the rays.

All pixels of one density share a lattice that repeats from pixel to pixel: points (s/N, s g mod N / N), shifted at random
as a whole (Sloan and Joe, Lattice Methods for Multiple Integration, 1994). The shift makes the mean of a pixel unbiased.
The error of a pixel is the sum of the image's spectrum, smoothed by the point spread, over the points of the dual lattice
{h: h₁ + g h₂ ≡ 0 mod N}. The spectrum of an edge lies along its normal. For each view the generator g is therefore chosen
such that the duals stay away from the two directions in which the marker's edges, slats and bits run. The variance then
falls with N², against N^1.5 for jitter.
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
#: Point spread for which a generator is judged [px]; a more blurred image forgives more.
_JUDGED_SIGMA_PX = 0.5
#: Weight of what lies beside an edge's normal in the spectrum: edges end, and perspective turns them.
_ENDS = 0.02


def reach_px(psf_sigma_px: float) -> int:
    """Largest distance, along either axis, between a ray's own pixel and a pixel that gathers it [px].

    Args:
        psf_sigma_px: standard deviation of the point spread [px].
    """
    return int(np.ceil(1.0 + REACH_SIGMA * psf_sigma_px)) - 1


def points(count: int, generator: int, shift: FloatArray) -> FloatArray:
    """Positions in a pixel of the points of a shifted lattice.

    Args:
        count: number of points N.
        generator: generator g.
        shift: of the whole lattice, (2,) in 0 … 1.

    Returns:
        (count, 2), −0.5 … 0.5 from the pixel's centre [px].
    """
    index = np.arange(count)
    unit = np.stack([index, index * generator % count], axis=-1) / count
    return (unit + shift) % 1.0 - 0.5


def axis_weights(positions_px: FloatArray, psf_sigma_px: float) -> FloatArray:
    """Weights of the kernel, point spread ⊗ pixel, with which pixels at −r … r along an axis gather rays in pixel 0.

    The weights of one ray add up to one, although the kernel is cut off at the reach r.

    Args:
        positions_px: of the rays along the axis, (n,), −0.5 … 0.5 [px].
        psf_sigma_px: standard deviation of the point spread [px].

    Returns:
        (n, 2r+1).
    """
    reach = reach_px(psf_sigma_px)
    away = positions_px[:, None] - np.arange(-reach, reach + 1)
    sigma = max(psf_sigma_px, 1e-6)
    kernel = ndtr((away + 0.5) / sigma) - ndtr((away - 0.5) / sigma)
    return kernel / kernel.sum(axis=1, keepdims=True)


def weights(positions_px: FloatArray, psf_sigma_px: float) -> NDArray[np.float32]:
    """Weights with which the pixels around one pixel gather its rays.

    Args:
        positions_px: of the rays in the pixel, (n, 2) [px].
        psf_sigma_px: standard deviation of the point spread [px].

    Returns:
        (n, (2r+1)²), the pixels row by row.
    """
    x, y = (axis_weights(positions_px[:, k], psf_sigma_px) for k in (0, 1))
    table = y[:, :, None] * x[:, None, :] / len(positions_px)
    return table.reshape(len(positions_px), -1).astype(np.float32)


def in_place_of(few: NDArray[np.float32], many: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights of a lattice's rays, scaled so that each pixel gathers as much as it would from another lattice.

    Where light is uniform over a pixel, a few rays then stand for many, without a seam to neighbours that have many.

    Args:
        few: weights of the lattice, (n, (2r+1)²).
        many: weights of the lattice in whose place it stands, (m, (2r+1)²).
    """
    own, wanted = few.sum(axis=0), many.sum(axis=0)
    return few * np.where(own > 1e-6, wanted / np.maximum(own, 1e-6), 1.0).astype(np.float32)


def generator(count: int, normals: FloatArray, rank: int = 0) -> int:
    """Generator g of the lattice whose duals stay farthest from two directions in the image.

    Args:
        count: rays per pixel.
        normals: normals of the two families of edges in the image, (2, 2), x and y of each; any length.
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
