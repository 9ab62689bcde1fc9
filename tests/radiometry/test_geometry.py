"""Frames and angles: every sign convention that the rest of the project leans on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from radiometry.geometry import (
    FRONTAL,
    FloatArray,
    attitude_matrix,
    faces_camera,
    observation_angle,
    rotation_angle,
    sun_direction,
)

tilts = st.floats(-np.radians(80), np.radians(80))
turns = st.floats(-np.pi, np.pi)
#: A few roundings of numbers near one.
ROUNDING = 1e-14


@settings(deadline=None, derandomize=True)
@given(tilts, tilts, turns, st.floats(0.1, 100))
def test_every_tilt_within_80_deg_shows_the_camera_the_face(
    pitch: float, yaw: float, roll: float, range_m: float
) -> None:
    rotation = attitude_matrix(pitch, yaw, roll)
    assert faces_camera(rotation, [0, 0, range_m])
    # The cosine of the tilt is that of a pitch and a yaw in turn; rolling about the line of sight leaves it.
    assert -rotation[2, 2] == pytest.approx(np.cos(pitch) * np.cos(yaw), abs=ROUNDING)


@settings(deadline=None, derandomize=True)
@given(tilts, tilts, turns)
def test_attitude_is_the_documented_product_of_column_vector_rotations(pitch: float, yaw: float, roll: float) -> None:
    right_handed = [Rotation.from_euler(axis, angle) for axis, angle in (("z", roll), ("y", yaw), ("x", pitch))]
    expected = FRONTAL @ (right_handed[0] * right_handed[1] * right_handed[2]).as_matrix()
    matrix = attitude_matrix(pitch, yaw, roll)
    np.testing.assert_allclose(matrix, expected, atol=ROUNDING)
    assert np.linalg.det(matrix) == pytest.approx(1, abs=ROUNDING)


def test_a_frontal_marker_is_upright_and_not_mirrored_in_the_image() -> None:
    right, up, out = np.eye(3)
    assert np.array_equal(attitude_matrix(0, 0) @ right, [1, 0, 0])
    assert np.array_equal(attitude_matrix(0, 0) @ up, [0, -1, 0])
    assert np.array_equal(attitude_matrix(0, 0) @ out, [0, 0, -1])


@pytest.mark.parametrize(
    ("rotation", "translation"),
    [
        (np.eye(3), [0, 0, 2.0]),  # seen from behind
        (FRONTAL, [0, 0, -2.0]),  # behind the camera
        (attitude_matrix(np.radians(100), 0), [0, 0, 2.0]),  # tilted past edge-on
        (attitude_matrix(np.radians(80), 0), [0, 1.0, 2.0]),  # tilt less than 90°, yet past edge-on from off the axis
    ],
)
def test_a_face_that_cannot_be_seen_is_told_apart(rotation: FloatArray, translation: list[float]) -> None:
    assert not faces_camera(rotation, translation)


@settings(deadline=None, derandomize=True)
@given(st.floats(0, np.pi), st.floats(-2 * np.pi, 2 * np.pi))
def test_sun_direction_makes_the_stated_phase_angle_with_the_camera(phase: float, azimuth: float) -> None:
    to_sun, to_camera = sun_direction(phase, azimuth), np.array([0, 0, -1.0])
    recovered = np.arctan2(np.linalg.norm(np.cross(to_sun, to_camera)), to_sun @ to_camera)
    assert recovered == pytest.approx(phase, abs=ROUNDING)
    assert np.linalg.norm(to_sun) == pytest.approx(1, abs=ROUNDING)


def test_sun_azimuth_turns_from_the_cameras_right_to_its_up() -> None:
    np.testing.assert_allclose(sun_direction(np.pi / 2, 0), [1, 0, 0], atol=ROUNDING)
    np.testing.assert_allclose(sun_direction(np.pi / 2, np.pi / 2), [0, -1, 0], atol=ROUNDING)


@settings(deadline=None, derandomize=True)
@given(st.floats(-12, 0.49), tilts, tilts, turns, st.tuples(*[st.floats(-1, 1)] * 3))
def test_rotation_angle_keeps_its_precision_from_zero_to_half_a_turn(
    exponent: float, pitch: float, yaw: float, roll: float, axis: tuple[float, float, float]
) -> None:
    """An arccos of the trace would lose everything below 1e-8 rad."""
    angle = min(10.0**exponent, np.pi)
    direction = np.array(axis) if np.linalg.norm(axis) > 1e-3 else np.array([0, 0, 1.0])
    turn = Rotation.from_rotvec(angle * direction / np.linalg.norm(direction)).as_matrix()
    start = attitude_matrix(pitch, yaw, roll)
    assert rotation_angle(start, start @ turn) == pytest.approx(angle, abs=10 * np.finfo(float).eps)


def test_rotation_angle_of_half_a_turn_and_of_none() -> None:
    assert rotation_angle(FRONTAL, FRONTAL) == 0
    assert rotation_angle(np.eye(3), FRONTAL) == np.pi


@pytest.mark.parametrize(
    ("baseline_m", "angles_deg"),  # at 1, 2, 5, 10, 15 and 20 m, as the audit of the thesis prints them
    [
        (0.03, (1.72, 0.86, 0.34, 0.17, 0.115, 0.086)),
        (0.05, (2.86, 1.43, 0.57, 0.29, 0.19, 0.14)),
        (0.08, (4.57, 2.29, 0.92, 0.46, 0.31, 0.23)),
    ],
)
def test_observation_angle_over_range(baseline_m: float, angles_deg: tuple[float, ...]) -> None:
    found = np.degrees(observation_angle(baseline_m, [1, 2, 5, 10, 15, 20]))
    half_a_digit = [0.5 * 10.0 ** -len(f"{a:g}".split(".")[1]) for a in angles_deg]
    assert np.all(np.abs(found - angles_deg) <= np.array(half_a_digit))
