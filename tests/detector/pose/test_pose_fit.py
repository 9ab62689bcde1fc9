"""The pose solver's loops: derivatives, rotations, descent, and the two attitudes it starts from."""

from __future__ import annotations

import numpy as np
import pytest
from projected import CAMERA, MARKER, features
from scipy.spatial.transform import Rotation
from synthetic import pose_at

from detector.pose.pose import problem_of
from detector.pose.pose_fit import exponential, first_poses, minimise, residuals
from radiometry.geometry import FloatArray, rotation_angle
from scenes.marker import ELEMENT_NAMES

TILTED = pose_at(2.0, 12.0, -20.0, 40.0, (80.0, -60.0), CAMERA)


def test_the_derivatives_are_those_of_the_residuals():
    rotation, translation = pose_at(2.0, 12.0, -20.0, 40.0, (80.0, -60.0), CAMERA)
    seen = features(rotation, translation, ELEMENT_NAMES)
    problem = problem_of([(seen, MARKER, np.zeros(3))], CAMERA)

    def at(step: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, slopes = np.empty(problem.measurements), np.empty((problem.measurements, 6))
        residuals(problem, exponential(step[:3]) @ rotation, translation + step[3:], values, slopes)
        return values, slopes

    _, analytic = at(np.zeros(6))
    for step, slope in zip(1e-6 * np.eye(6), analytic.T, strict=True):
        difference = (at(step)[0] - at(-step)[0]) / 2e-6
        assert difference == pytest.approx(slope, rel=1e-5, abs=1e-4 * np.abs(slope).max())


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, np.pi])
def test_the_exponential_is_the_rotation_of_its_vector(angle: float) -> None:
    omega = angle * np.array([2.0, -1.0, 2.0]) / 3
    assert exponential(omega) == pytest.approx(Rotation.from_rotvec(omega).as_matrix(), abs=1e-14)


def test_the_descent_ends_at_the_pose_of_exact_features() -> None:
    rotation, translation = TILTED
    problem = problem_of([(features(rotation, translation, ELEMENT_NAMES), MARKER, np.zeros(3))], CAMERA)
    turn = Rotation.from_rotvec([0.1, -0.15, 0.2]).as_matrix()
    rotations, translations, cost = (turn @ rotation)[None], 1.1 * translation[None], np.empty(1)
    minimise(problem, problem.measurements, rotations, translations, cost)
    assert cost[0] < 1e-6
    assert rotation_angle(rotations[0], rotation) < 1e-6
    assert translations[0] == pytest.approx(translation, rel=1e-6)


def test_one_start_is_near_the_truth_and_the_other_its_mirror() -> None:
    """IPPE's two attitudes tilt by the same angle to either side of the line of sight."""
    rotation, translation = pose_at(8.0, 25.0, 0.0, 0.0, (0.0, 0.0), CAMERA)
    problem = problem_of([(features(rotation, translation, ()), MARKER, np.zeros(3))], CAMERA)
    rotations, translations = np.empty((2, 3, 3)), np.empty((2, 3))
    first_poses(problem, MARKER.aruco_m / 2, rotations, translations)
    off = np.degrees(sorted(rotation_angle(turn, rotation) for turn in rotations))
    assert off == pytest.approx([0.0, 50.0], abs=0.5)
    for start in translations:
        assert start == pytest.approx(translation, rel=1e-3, abs=1e-6)


def test_blobs_replace_the_nearer_start_by_the_attitude_they_point_at() -> None:
    rotation, translation = pose_at(8.0, 25.0, -10.0, 30.0, (5.0, 3.0), CAMERA)
    problem = problem_of([(features(rotation, translation, ("top", "right")), MARKER, np.zeros(3))], CAMERA)
    rotations, translations = np.empty((2, 3, 3)), np.empty((2, 3))
    first_poses(problem, MARKER.aruco_m / 2, rotations, translations)
    near, far = sorted(rotation_angle(turn, rotation) for turn in rotations)
    assert np.degrees(near) < 0.5
    assert np.degrees(far) > 30.0
