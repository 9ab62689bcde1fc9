"""Frames, attitudes and the angles of retroreflection, shared by every package above.

Camera frame as OpenCV's: x right, y down, z forward. Marker frame: origin at the centre of the front plane,
x right, y up, z out of the face. A pose maps marker to camera, X_camera = R X_marker + t.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Real-valued array; the precision is a matter of run time, not of types.
FloatArray = NDArray[Any]

#: Attitude of a marker that squarely faces the camera.
FRONTAL: FloatArray = np.diag([1.0, -1.0, -1.0])


def attitude_matrix(pitch_rad: float, yaw_rad: float, roll_rad: float = 0.0) -> FloatArray:
    """Rotation from the marker frame to the camera frame for a tilt of the marker.

    The tilt is by pitch about x, then yaw about y, then roll about z: R = R_0 · Rz(roll) · Ry(yaw) · Rx(pitch) with
    R_0 = diag(1, −1, −1), in the column-vector convention.

    Args:
        pitch_rad: rotation about the marker's x axis [rad].
        yaw_rad: rotation about the marker's y axis [rad].
        roll_rad: rotation about the marker's normal [rad].

    Returns:
        R, (3, 3), so that X_camera = R X_marker + t.

    Example:
        The normal of a marker that faces the camera points back at it, along −z:

        >>> from radiometry.geometry import attitude_matrix
        >>> attitude_matrix(0.0, 0.0)[:, 2].tolist()
        [0.0, 0.0, -1.0]
    """
    cx, sx = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cz, sz = np.cos(roll_rad), np.sin(roll_rad)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return FRONTAL @ rz @ ry @ rx


def faces_camera(rotation: ArrayLike, translation_m: ArrayLike) -> bool:
    """Whether the camera is in front of the marker and sees its printed side (cheirality).

    Args:
        rotation: marker to camera, (3, 3).
        translation_m: the marker's origin in the camera frame, (3,) [m].
    """
    rotation, translation_m = np.asarray(rotation, float), np.asarray(translation_m, float)
    return bool(translation_m[2] > 0 and rotation[:, 2] @ translation_m < 0)


def rotation_angle(a: ArrayLike, b: ArrayLike) -> float:
    """Geodesic angle between two rotations [rad], 0 to π: |log(aᵀ b)|.

    Args:
        a: rotation matrix, (3, 3).
        b: rotation matrix, (3, 3).

    Example:
        >>> from radiometry.geometry import attitude_matrix, rotation_angle
        >>> round(rotation_angle(attitude_matrix(0.0, 0.0), attitude_matrix(0.0, 0.25)), 6)
        0.25
    """
    relative = np.asarray(a, float).T @ np.asarray(b, float)
    axis = np.array([relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]])
    # atan2 keeps full precision near zero, where arccos of the trace loses half the digits.
    return float(np.arctan2(np.linalg.norm(axis) / 2, (np.trace(relative) - 1) / 2))


def normal_to(vector: ArrayLike) -> FloatArray:
    """A unit vector (3,) perpendicular to a vector; which of them is arbitrary but always the same.

    Args:
        vector: (3,), of any length above zero.
    """
    vector = np.asarray(vector, float)
    normal = np.cross(vector, np.eye(3)[int(np.argmin(np.abs(vector)))])
    return normal / np.linalg.norm(normal)


def observation_angle(baseline_m: ArrayLike, range_m: ArrayLike) -> FloatArray:
    """Observation angle α = atan(b/R): the angle at the target between the directions to the source and to the lens [rad].

    Args:
        baseline_m: distance b between source and lens [m].
        range_m: distance R to the target [m]; broadcasts with the baseline.
    """
    return np.arctan(np.asarray(baseline_m, float) / np.asarray(range_m, float))


def sun_direction(phase_rad: float, azimuth_rad: float) -> FloatArray:
    """Unit vector from the target to the Sun in the camera frame, (3,).

    Args:
        phase_rad: phase angle Sun–target–camera [rad]. At 0 the Sun stands behind the camera.
        azimuth_rad: side on which the Sun stands [rad]: 0 is the camera's right, π/2 above.
    """
    sin_phase = np.sin(phase_rad)
    return np.array([sin_phase * np.cos(azimuth_rad), -sin_phase * np.sin(azimuth_rad), -np.cos(phase_rad)])
