"""Field of view of an encoding element and of the marker: the thesis's equations 5.17 to 5.20, as printed and right.

An element of length w has its virtual line at a depth V behind the front plane and at a distance d from one end. A far
camera whose direction c (unit vector in the marker frame, out of the face) has the slope s = c_along / c_z sees the blob at
V·s from the line's foot. Every limit is therefore a limit of slope: the blob must lie on the opening, whole or nearly so,
and the floor must show between the side walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometry.geometry import FloatArray


class Sides(NamedTuple):
    """Angles from the normal to which a blob is seen [rad]: towards the near end of the opening, and the far one.

    Negative where the blob is not whole even when seen along the normal."""

    near: float
    far: float


def one_sided_field(length_m: float, depth_m: float) -> float:
    """As printed: FOV = atan(w / V) [rad]. It is the field of an element whose virtual line lies under one end, d = 0."""
    return float(np.arctan(length_m / depth_m))


def centred_field(length_m: float, depth_m: float) -> float:
    """What equation 5.17 is meant to be, for a line under the middle: 2 atan(w / 2V) [rad]."""
    return float(2 * np.arctan(length_m / (2 * depth_m)))


def element_sides(length_m: float, near_end_m: float, depth_m: float, margin_m: float = 0.0) -> Sides:
    """The two terms of equation 5.18 with a margin in length, as a blob of one width needs on either side.

    Args:
        length_m: w, of the opening.
        near_end_m: d, from the virtual line to the nearer end.
        depth_m: V.
        margin_m: how far the blob's middle must stay from an end.
    """
    return Sides(
        float(np.arctan((near_end_m - margin_m) / depth_m)),
        float(np.arctan((length_m - near_end_m - margin_m) / depth_m)),
    )


def with_margin(sides: Sides, margin_rad: float = 0.0) -> Sides:
    """As the thesis takes its margin: the same angle off either side, 18° by estimate."""
    return Sides(sides.near - margin_rad, sides.far - margin_rad)


def combined_field(sides: Sides) -> float:
    """Field of two opposite elements, 2·FOV − overlap [rad]; their overlap is twice the near side, where that is positive."""
    return 2 * (sides.near + sides.far) - max(2 * sides.near, 0.0)


def ellipse(
    across_rad: ArrayLike, along_rad: ArrayLike, across_limit_rad: ArrayLike, along_limit_rad: ArrayLike
) -> FloatArray:
    """Right-hand side of equation 5.20: ψ²/a² + θ²/b², one on the ellipse; everything broadcasts.

    As printed the semi-axis a is the *full* lateral field (100°) beside a one-sided longitudinal one; it must be half of it.
    """
    across, along = np.asarray(across_rad, float), np.asarray(along_rad, float)
    return (across / np.asarray(across_limit_rad)) ** 2 + (along / np.asarray(along_limit_rad)) ** 2


def equal_angles(across_limit_rad: float, along_limit_rad: float) -> float:
    """Where ψ = θ meets the ellipse of equation 5.20 [rad]: 1/√(1/a² + 1/b²)."""
    return float(1 / np.hypot(1 / across_limit_rad, 1 / along_limit_rad))


def slopes(pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Slopes c_x / c_z and c_y / c_z of the direction to a camera on the axis, for `attitude_matrix(pitch, yaw)`.

    c = Rx(−pitch) Ry(−yaw) ẑ, hence c_x / c_z = −tan(yaw) / cos(pitch) and c_y / c_z = tan(pitch). Roll turns the image only.
    """
    pitch, yaw = np.asarray(pitch_rad, float), np.asarray(yaw_rad, float)
    return -np.tan(yaw) / np.cos(pitch), np.tan(pitch) + 0 * yaw


def blob_half_base(slit_m: float, cavity_depth_m: float, virtual_depth_m: float) -> float:
    """Distance from the blob's middle at which a slit shows nothing any more [m]: o · V / t.

    A sight line that enters a slit of opening o at x from the blob leaves the slit's plane by x · t / V on its way to the floor
    at depth t. The blob is the triangle of what is left; its width at half height is the same length.
    """
    return slit_m * virtual_depth_m / cavity_depth_m


def margin_of_cut(half_base_m: float, cut_fraction: float) -> float:
    """Room between the blob's middle and the end of the opening that leaves `cut_fraction` of its light outside [m].

    A triangle of half base h loses (1 − x/h)² / 2 beyond a distance x ≥ 0 from its middle; at most one half.
    """
    if not 0 <= cut_fraction <= 0.5:
        raise ValueError(f"cut_fraction: {cut_fraction:g}, expected 0 to 0.5")
    return half_base_m * (1 - float(np.sqrt(2 * cut_fraction)))


def lateral_share(slope_across: ArrayLike, width_m: float, cavity_depth_m: float) -> FloatArray:
    """Share of the floor's width that is both lit and seen between straight side walls: 1 − (t/h) |s|, zero at least.

    The light comes along the sight line; t is the cavity's depth and h the opening's width. (At the front plane, before
    foreshortening: the image of the element shrinks by the same cosine as everything else.)
    """
    return np.clip(1 - cavity_depth_m / width_m * np.abs(np.asarray(slope_across, float)), 0.0, 1.0)


def lateral_limit(width_m: float, cavity_depth_m: float, share: float) -> float:
    """Angle from the normal across the element at which a share of the floor's width is left [rad]."""
    return float(np.arctan((1 - share) * width_m / cavity_depth_m))


def in_field(
    slope_along: ArrayLike, slope_across: ArrayLike, sides: Sides, across_limit_rad: float
) -> NDArray[np.bool_]:
    """Where a far camera sees an element's blob: a rectangle in slopes, not an ellipse in angles.

    Args:
        slope_along: counted towards the far end of the opening.
        slope_across: of either sign.
        sides: `element_sides`.
        across_limit_rad: `lateral_limit`.
    """
    along, across = np.asarray(slope_along, float), np.asarray(slope_across, float)
    return (along >= -np.tan(sides.near)) & (along <= np.tan(sides.far)) & (np.abs(across) <= np.tan(across_limit_rad))
