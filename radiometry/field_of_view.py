"""Field of view of an encoding element and of the marker: equations 5.17 to 5.20 of the thesis, as printed and corrected.

An element of length w has its virtual line at a depth V behind the front plane, at a distance d from one end. A far camera
lies in a direction c, a unit vector in the marker frame that points out of the face. Its slope along the element is s =
c_along / c_z, and it sees the blob at V·s from the foot of the line. Every limit is therefore a limit of slope: the blob
must lie on the opening, whole or nearly so, and the side walls must leave the floor in sight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiometry.geometry import FloatArray


class Sides(NamedTuple):
    """Angles from the normal up to which a blob is seen [rad].

    An angle is negative where the blob is not whole even along the normal.

    Attributes:
        near: towards the nearer end of the opening.
        far: towards the farther end.
    """

    near: float
    far: float


def one_sided_field(length_m: float, depth_m: float) -> float:
    """Field of an element whose virtual line lies under one end: atan(w / V) [rad]. Equation 5.17 of the thesis as printed.

    Args:
        length_m: length w of the opening [m].
        depth_m: depth V of the virtual line [m].
    """
    return float(np.arctan(length_m / depth_m))


def centred_field(length_m: float, depth_m: float) -> float:
    """Field of an element whose virtual line lies under its middle: 2 atan(w / 2V) [rad]. Equation 5.17 as it should read.

    Args:
        length_m: length w of the opening [m].
        depth_m: depth V of the virtual line [m].
    """
    return float(2 * np.arctan(length_m / (2 * depth_m)))


def element_sides(length_m: float, near_end_m: float, depth_m: float, margin_m: float = 0.0) -> Sides:
    """Field of an element on either side: the two terms of equation 5.18, with a margin in length that a blob of one width needs.

    Args:
        length_m: length w of the opening [m].
        near_end_m: distance d from the virtual line to the nearer end [m].
        depth_m: depth V of the virtual line [m].
        margin_m: how far the middle of the blob must stay from an end [m].
    """
    return Sides(
        float(np.arctan((near_end_m - margin_m) / depth_m)),
        float(np.arctan((length_m - near_end_m - margin_m) / depth_m)),
    )


def with_margin(sides: Sides, margin_rad: float = 0.0) -> Sides:
    """Field of an element on either side, less one angle on both: the margin as the thesis takes it in equation 5.18.

    Args:
        sides: the field without a margin.
        margin_rad: angle to take off either side [rad]; the thesis estimates 18°.
    """
    return Sides(sides.near - margin_rad, sides.far - margin_rad)


def combined_field(sides: Sides) -> float:
    """Field of two opposite elements together [rad]: twice the field of one, less their overlap. Equation 5.19 of the thesis.

    The overlap is twice the near side where that is positive; otherwise the two fields leave a gap between them.

    Args:
        sides: the field of one element.
    """
    return 2 * (sides.near + sides.far) - max(2 * sides.near, 0.0)


def ellipse(
    across_rad: ArrayLike, along_rad: ArrayLike, across_limit_rad: ArrayLike, along_limit_rad: ArrayLike
) -> FloatArray:
    """Right-hand side of equation 5.20: ψ²/a² + θ²/b², which is one on the ellipse.

    As printed, the semi-axis a is the *full* lateral field (100°) beside a one-sided longitudinal one. It must be half of
    it.

    Args:
        across_rad: angle ψ across the element [rad].
        along_rad: angle θ along the element [rad].
        across_limit_rad: semi-axis a [rad].
        along_limit_rad: semi-axis b [rad].

    Returns:
        Of the shape to which the arguments broadcast.
    """
    across, along = np.asarray(across_rad, float), np.asarray(along_rad, float)
    return (across / np.asarray(across_limit_rad)) ** 2 + (along / np.asarray(along_limit_rad)) ** 2


def equal_angles(across_limit_rad: float, along_limit_rad: float) -> float:
    """The angle at which ψ = θ meets the ellipse of equation 5.20 [rad]: 1/√(1/a² + 1/b²).

    Args:
        across_limit_rad: semi-axis a [rad].
        along_limit_rad: semi-axis b [rad].
    """
    return float(1 / np.hypot(1 / across_limit_rad, 1 / along_limit_rad))


def slopes(pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Slopes c_x / c_z and c_y / c_z of the direction from the marker to a camera on whose axis it stands.

    c = Rx(−pitch) Ry(−yaw) ẑ, so c_x / c_z = −tan(yaw) / cos(pitch) and c_y / c_z = tan(pitch). Roll only turns the image.

    Args:
        pitch_rad: pitch of `attitude_matrix` [rad].
        yaw_rad: yaw of `attitude_matrix` [rad]; broadcasts with the pitch.
    """
    pitch, yaw = np.asarray(pitch_rad, float), np.asarray(yaw_rad, float)
    return -np.tan(yaw) / np.cos(pitch), np.tan(pitch) + 0 * yaw


def blob_half_base(slit_m: float, cavity_depth_m: float, virtual_depth_m: float) -> float:
    """Distance from the middle of the blob beyond which a slit shows nothing any more [m]: o · V / t.

    A line of sight enters a slit of opening o at a distance x from the middle of the blob. On its way down to the floor, at
    a depth t, it moves sideways out of the slit by x · t / V. What is left in sight falls linearly with x, so the blob is a
    triangle. Its full width at half height equals this half base.

    Args:
        slit_m: opening o of a slit [m].
        cavity_depth_m: depth t of the floor [m].
        virtual_depth_m: depth V of the virtual line [m].
    """
    return slit_m * virtual_depth_m / cavity_depth_m


def margin_of_cut(half_base_m: float, cut_fraction: float) -> float:
    """Distance between the middle of the blob and the end of the opening at which a share of its light falls outside [m].

    A triangle of half base h loses (1 − x/h)² / 2 of its area beyond a distance x ≥ 0 from its middle, so at most one half.

    Args:
        half_base_m: half base h of the blob [m].
        cut_fraction: share of the light beyond the end, 0 to 0.5.

    Raises:
        ValueError: when the share is not between 0 and 0.5.
    """
    if not 0 <= cut_fraction <= 0.5:
        raise ValueError(f"cut_fraction: {cut_fraction:g}, expected 0 to 0.5")
    return half_base_m * (1 - float(np.sqrt(2 * cut_fraction)))


def lateral_share(slope_across: ArrayLike, width_m: float, cavity_depth_m: float) -> FloatArray:
    """Share of the floor's width that is both lit and seen between straight side walls: 1 − (t/h) |s|, and at least zero.

    The light is taken to come in along the line of sight. The share counts at the front plane, before foreshortening: the
    image of the element shrinks by the same cosine as everything else.

    Args:
        slope_across: slope s of the line of sight across the element [-].
        width_m: width h of the opening [m].
        cavity_depth_m: depth t of the cavity [m].
    """
    return np.clip(1 - cavity_depth_m / width_m * np.abs(np.asarray(slope_across, float)), 0.0, 1.0)


def lateral_limit(width_m: float, cavity_depth_m: float, share: float) -> float:
    """Angle from the normal, across the element, at which a share of the floor's width is left in sight [rad].

    Args:
        width_m: width of the opening [m].
        cavity_depth_m: depth of the cavity [m].
        share: share of the floor's width, as from `lateral_share`.
    """
    return float(np.arctan((1 - share) * width_m / cavity_depth_m))


def in_field(
    slope_along: ArrayLike, slope_across: ArrayLike, sides: Sides, across_limit_rad: float
) -> NDArray[np.bool_]:
    """Whether a far camera sees an element's blob. The field is a rectangle in slopes, not an ellipse in angles.

    Args:
        slope_along: slope along the element, positive towards the farther end of the opening [-].
        slope_across: slope across the element, of either sign [-]; broadcasts with the slope along.
        sides: limits along the element, from `element_sides`.
        across_limit_rad: limit across the element, from `lateral_limit` [rad].
    """
    along, across = np.asarray(slope_along, float), np.asarray(slope_across, float)
    return (along >= -np.tan(sides.near)) & (along <= np.tan(sides.far)) & (np.abs(across) <= np.tan(across_limit_rad))
