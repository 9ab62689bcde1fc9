"""How many rays a pixel of the marker gets, so that the renderer's noise stays invisible beside shot noise.

The variance of a shifted lattice's mean falls with the square of its number of rays. The constants were measured
(`benchmarks`). Every rendering also estimates its own variance from two independent halves, so the figure is reported and
not only hoped for.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray
from scenes.render.lanes import BLOCK
from scenes.view import Quality

#: Parts of the marker: the ArUco with its ring, slits whose floor the camera sees, and the elements' other slits.
PARTS = ("aruco", "blob", "slats")
#: Rays per pixel of one lattice, times the root of allowed variance over shot variance where the ArUco's brightest pixels hold
#: one electron. Measured from 1 to 16 m over attitudes of 30 deg so that most pixels need no more; the others get more later.
_RAYS = {"aruco": 0.24, "blob": 0.75, "slats": 0.13}
#: Fewest and most rays per pixel of one lattice. An edge along the pixels may fall anywhere between two rays: with the fewest,
#: its whole length is displaced by up to 1/64 px.
_FEWEST, _MOST = 32, 256 * BLOCK
#: Factor on the rays that the law asks for, where they did not suffice: the fraction that was found is itself uncertain.
_CAUTION = 1.3
#: Side of the neighbourhood over which the renderer's variance is averaged [px].
_POOL_PX = 5


def rays_per_pixel(quality: Quality, pixels: dict[str, int]) -> dict[str, int]:
    """Lattice sizes by part of the marker, for each of the two lattices: multiples of `BLOCK`, or one smaller number for all.

    The variance falls with the square of the rays, so their number grows with the root of the charge and falls with the
    root of the variance that is allowed.

    Args:
        quality: charge, variance allowed, and most rays.
        pixels: number of pixels of each of `PARTS`.
    """
    scale = np.sqrt(quality.electrons / quality.variance_fraction)
    wanted = {part: np.clip(_RAYS[part] * scale, _FEWEST, _MOST) for part in pixels}
    spent = sum(2 * wanted[part] * count for part, count in pixels.items())
    share = min(1.0, quality.marker_rays / max(spent, 1.0))
    evenly = quality.marker_rays / (2 * max(sum(pixels.values()), 1))
    if evenly >= BLOCK:
        return {part: max(BLOCK, lattice_size(float(size) * share)) for part, size in wanted.items()}
    # So large in the image that few rays a pixel are left: the same for all, and no fewer than elsewhere.
    return dict.fromkeys(pixels, max(lattice_size(evenly), lattice_size(quality.frame_samples**2 / 2)))


def more_rays(rays: int, fraction: float, quality: Quality) -> int:
    """Lattice size that should bring the renderer's share of the shot variance below the quality's.

    Args:
        rays: the lattice size so far.
        fraction: renderer's variance over shot variance, as found with it.
        quality: the share that is allowed.
    """
    growth = np.clip(_CAUTION * np.sqrt(fraction / quality.variance_fraction), 1.5, 4.0)
    return min(lattice_size(float(rays * growth)), _MOST)


def lattice_size(wanted: float) -> int:
    """Number of rays per pixel that fills whole blocks of lanes: 1, 2, 4, 8, or a multiple of 16.

    Args:
        wanted: the number that it should be close to.
    """
    if wanted < BLOCK * 0.75:
        return int(2 ** np.clip(np.rint(np.log2(max(wanted, 1.0))), 0, 3))
    return int(max(1, round(wanted / BLOCK)) * BLOCK)


def electrons_per_radiance(aruco: NDArray[np.float32], quality: Quality) -> float:
    """Electrons per unit of a basis that bring the brightest fiftieth of the ArUco's pixels to the quality's charge.

    Args:
        aruco: the basis at the ArUco's pixels, any shape.
        quality: for its charge.
    """
    brightest = float(np.percentile(aruco, 98)) if aruco.size else 0.0
    return quality.electrons / brightest if brightest > 0 else 0.0


def variance_fractions(noise: FloatArray, shot_variance: FloatArray, pixels: NDArray[np.bool_]) -> FloatArray:
    """The renderer's variance over shot variance, (height, width); zero outside the pixels that count.

    One sample of the error tells little about one pixel, so the ratio is averaged over `_POOL_PX`² neighbours among those
    pixels.

    Args:
        noise: a sample of the renderer's error, (height, width) [electrons].
        shot_variance: (height, width) [electrons²].
        pixels: which of them count, (height, width).
    """
    ratio = np.where(pixels, noise**2 / np.maximum(shot_variance, 1e-12), 0.0)
    total, count = (
        cv2.boxFilter(image.astype(float), -1, (_POOL_PX, _POOL_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for image in (ratio, pixels)
    )
    return np.where(pixels, total / np.maximum(count, 1.0), 0.0)
