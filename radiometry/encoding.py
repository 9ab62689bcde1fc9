"""How well a marker tells the viewing angle: closed-form deviations of encoding elements and of a plane square.

An encoding element turns the viewing direction's slope s = tan θ into a place along itself. Whatever does it, slits or lenses,
the deviation of the angle is that of the place over the element's image, times how far the slope has to go for its length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray

#: Median over deviation of the length of an error with two equal, independent normal parts (Rayleigh): √(2 ln 2).
RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))


def slit_deviation(tilt_rad: ArrayLike, depth_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Deviation of the angle from one element with a virtual line [rad]: cos θ · σ / V.

    The blob lies at V tan θ along the element, whose image is cos θ shorter when tilted along itself; across, the same factor
    comes from the slope, tan(yaw) / cos(pitch).

    Args:
        depth_px: depth V of the line in pixels of the element's plane seen squarely.
        sigma_px: of the blob along the element's image.
    """
    return np.cos(np.asarray(tilt_rad, float)) * np.asarray(sigma_px, float) / np.asarray(depth_px, float)


def lens_deviation(tilt_rad: ArrayLike, field_rad: ArrayLike, length_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Deviation of the angle from one lens array on stripes [rad]: 2 tan(Θ/2) · cos θ · σ / w.

    The moiré stripe walks the whole length w of the pattern while the angle walks the field Θ, linearly in its tangent, as a lens
    of focal length f and pitch p has it: tan(Θ/2) = p / 2f. With Θ = 90° it is an element with its line at half its length.

    Args:
        length_px: of the pattern seen squarely.
        sigma_px: of the stripe along its image.
    """
    slope = 2 * np.tan(np.asarray(field_rad, float) / 2)
    return slit_deviation(tilt_rad, np.asarray(length_px, float) / slope, sigma_px)


def square_deviation(tilt_rad: ArrayLike, side_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Deviation of the tilt from the foreshortening of a plane square [rad]: σ √(1 + cos²θ) / (a sin θ).

    Weak perspective: cos θ is the ratio of two mean sides, each the mean of two differences of corners and so of variance σ².
    Infinite seen squarely, where only perspective is left; not valid within some degrees of it.

    Args:
        side_px: of the square seen squarely; sigma_px: of a corner along each axis.
    """
    tilt, ratio = np.asarray(tilt_rad, float), np.asarray(sigma_px, float) / np.asarray(side_px, float)
    with np.errstate(divide="ignore"):
        return ratio * np.sqrt(1 + np.cos(tilt) ** 2) / np.abs(np.sin(tilt))
