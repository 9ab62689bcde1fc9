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
    """Rotation marker -> camera, (3, 3), of a tilt by pitch about x, then yaw about y, then roll about z.

    R = R_0 · Rz(roll) · Ry(yaw) · Rx(pitch) with R_0 = diag(1, −1, −1), column-vector convention.
    """
    cx, sx = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cz, sz = np.cos(roll_rad), np.sin(roll_rad)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return FRONTAL @ rz @ ry @ rx


def faces_camera(rotation: ArrayLike, translation_m: ArrayLike) -> bool:
    """True where the front of the marker plane is turned towards the camera and lies before it (cheirality)."""
    rotation, translation_m = np.asarray(rotation, float), np.asarray(translation_m, float)
    return bool(translation_m[2] > 0 and rotation[:, 2] @ translation_m < 0)


def rotation_angle(a: ArrayLike, b: ArrayLike) -> float:
    """Geodesic angle between two rotation matrices (3, 3), in radians: |log(aᵀ b)|."""
    relative = np.asarray(a, float).T @ np.asarray(b, float)
    axis = np.array([relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]])
    # atan2 keeps full precision near zero, where arccos of the trace loses half the digits.
    return float(np.arctan2(np.linalg.norm(axis) / 2, (np.trace(relative) - 1) / 2))


def normal_to(vector: ArrayLike) -> FloatArray:
    """Some unit vector (3,) square to a vector (3,)."""
    vector = np.asarray(vector, float)
    normal = np.cross(vector, np.eye(3)[int(np.argmin(np.abs(vector)))])
    return normal / np.linalg.norm(normal)


def observation_angle(baseline_m: ArrayLike, range_m: ArrayLike) -> FloatArray:
    """Observation angle α = atan(b/R) in radians: between the directions to the source and to the lens."""
    return np.arctan(np.asarray(baseline_m, float) / np.asarray(range_m, float))


def sun_direction(phase_rad: float, azimuth_rad: float) -> FloatArray:
    """Unit vector target -> Sun in the camera frame, (3,), for a phase angle Sun–target–camera.

    At phase 0 the Sun stands behind the camera. The azimuth turns from the camera's right (0) towards its up (π/2).
    """
    sin_phase = np.sin(phase_rad)
    return np.array([sin_phase * np.cos(azimuth_rad), -sin_phase * np.sin(azimuth_rad), -np.cos(phase_rad)])
