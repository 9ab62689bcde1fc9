"""How well a marker tells the viewing angle: standard deviations of the angle from encoding elements and from a plane square.

An encoding element turns the slope s = tan θ of the viewing direction into a position along itself. The standard deviation
of the angle is therefore that of the position over the length of the element's image, times the change of slope that moves
the position along the whole length. This holds for slits and for lenses alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray

#: Median over deviation of the length of an error with two equal, independent normal parts (Rayleigh): √(2 ln 2).
RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))


def slit_deviation(tilt_rad: ArrayLike, depth_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Standard deviation of the angle from one element with a virtual line [rad]: cos θ · σ / V.

    The blob lies at V tan θ along the element. A tilt along the element shortens its image by cos θ. For a tilt across it,
    the same factor comes from the slope, which is tan(yaw) / cos(pitch).

    Args:
        tilt_rad: angle θ between the normal and the viewing direction [rad].
        depth_px: depth V of the virtual line, in pixels of the element's plane seen head-on.
        sigma_px: standard deviation of the blob's position along the element's image [px].

    Returns:
        Of the shape to which the arguments broadcast.
    """
    return np.cos(np.asarray(tilt_rad, float)) * np.asarray(sigma_px, float) / np.asarray(depth_px, float)


def lens_deviation(tilt_rad: ArrayLike, field_rad: ArrayLike, length_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Standard deviation of the angle from one lens array on stripes [rad]: 2 tan(Θ/2) · cos θ · σ / w.

    The moiré stripe moves along the whole length w of the pattern while the angle moves through the field Θ, linearly in
    its tangent. For lenses of focal length f and pitch p, tan(Θ/2) = p / 2f. With Θ = 90° the array equals an element whose
    virtual line lies at half its length.

    Args:
        tilt_rad: angle θ between the normal and the viewing direction [rad].
        field_rad: field Θ of the lenses [rad].
        length_px: length w of the pattern seen head-on [px].
        sigma_px: standard deviation of the stripe's position along its image [px].

    Returns:
        Of the shape to which the arguments broadcast.
    """
    slope = 2 * np.tan(np.asarray(field_rad, float) / 2)
    return slit_deviation(tilt_rad, np.asarray(length_px, float) / slope, sigma_px)


def square_deviation(tilt_rad: ArrayLike, side_px: ArrayLike, sigma_px: ArrayLike) -> FloatArray:
    """Standard deviation of the tilt from the foreshortening of a plane square [rad]: σ √(1 + cos²θ) / (a sin θ).

    In weak perspective cos θ is the ratio of two mean sides. Each mean side is the mean of two differences of corners, so
    its variance is σ². The result is infinite for a square seen head-on, where only perspective tells the tilt, and it is
    not valid within some degrees of that.

    Args:
        tilt_rad: angle θ between the normal and the viewing direction [rad].
        side_px: side a of the square seen head-on [px].
        sigma_px: standard deviation of a corner along each axis [px].

    Returns:
        Of the shape to which the arguments broadcast.
    """
    tilt, ratio = np.asarray(tilt_rad, float), np.asarray(sigma_px, float) / np.asarray(side_px, float)
    with np.errstate(divide="ignore"):
        return ratio * np.sqrt(1 + np.cos(tilt) ** 2) / np.abs(np.sin(tilt))
