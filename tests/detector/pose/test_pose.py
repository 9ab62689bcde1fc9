"""Pose from exact, from noisy and from imaged features."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from projected import CAMERA, MARKER, features
from scipy.stats import chi2
from synthetic import NOISE, electrons, expose, pose_at

from detector.features import Features, find_features
from detector.pose.pose import solve_pose
from radiometry.geometry import FloatArray, faces_camera, rotation_angle
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES

SUBSETS = [names for count in range(5) for names in combinations(ELEMENT_NAMES, count)]


def error_vector(
    pose_rotation: FloatArray, pose_translation: FloatArray, rotation: FloatArray, translation: FloatArray
) -> FloatArray:
    """(ω, δt) from an estimate to the truth, as `Pose.covariance` defines it, for small angles."""
    turn = rotation @ pose_rotation.T
    omega = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return np.concatenate([omega, translation - pose_translation])


angles = st.floats(-40, 40)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    range_m=st.floats(0.7, 12),
    pitch=angles,
    yaw=angles,
    roll=st.floats(-180, 180),
    x=st.floats(-200, 200),
    y=st.floats(-150, 150),
    blobs=st.sampled_from(SUBSETS[5:]),
)
def test_exact_features_give_the_exact_pose(range_m, pitch, yaw, roll, x, y, blobs):
    rotation, translation = pose_at(range_m, pitch, yaw, roll, (x, y), CAMERA)
    found = solve_pose(features(rotation, translation, blobs), MARKER, CAMERA)
    assert found is not None
    assert faces_camera(found.rotation, found.translation_m)
    assert found.rotation @ found.rotation.T == pytest.approx(np.eye(3), abs=1e-9)
    # Two blobs along the same axis leave the mirror about it; elsewhere the truth is the only zero of the cost.
    if found.residual > 1e-6 or not found.ambiguous:
        assert rotation_angle(found.rotation, rotation) < 1e-4
    assert found.translation_m == pytest.approx(translation, rel=2e-3, abs=1e-4)


@pytest.mark.parametrize("blobs", SUBSETS)
@pytest.mark.parametrize(("pitch", "yaw"), [(0.0, 0.0), (20.0, -15.0)])
def test_any_subset_of_blobs_gives_a_pose(blobs, pitch, yaw):
    rotation, translation = pose_at(4.4, pitch, yaw, 10.0, (50.0, -30.0), CAMERA)
    found = solve_pose(features(rotation, translation, blobs, 0.02, np.random.default_rng(0)), MARKER, CAMERA)
    assert found is not None
    assert faces_camera(found.rotation, found.translation_m)
    both = bool({"top", "bottom"} & set(blobs)) and bool({"right", "left"} & set(blobs))
    if both:
        assert not found.ambiguous
        assert np.degrees(rotation_angle(found.rotation, rotation)) < 0.5
    assert found.translation_m == pytest.approx(translation, rel=0.01, abs=0.001)


def test_corners_alone_are_ambiguous_at_long_range_and_say_so():
    rotation, translation = pose_at(10.0, 12.0, 0.0, 0.0, (0.0, 0.0), CAMERA)
    assert solve_pose(features(rotation, translation, ()), MARKER, CAMERA).ambiguous
    assert not solve_pose(features(rotation, translation, ("top", "right")), MARKER, CAMERA).ambiguous


def test_corners_alone_are_enough_at_close_range():
    rotation, translation = pose_at(0.8, 25.0, -10.0, 5.0, (0.0, 0.0), CAMERA)
    found = solve_pose(features(rotation, translation, (), 0.01, np.random.default_rng(1)), MARKER, CAMERA)
    assert not found.ambiguous
    assert np.degrees(rotation_angle(found.rotation, rotation)) < 0.3


@pytest.mark.parametrize("blobs", [("top", "right"), ELEMENT_NAMES])
@pytest.mark.parametrize(
    ("range_m", "pitch", "yaw"), [(2.0, 25.0, 10.0), (4.4, 0.0, 0.0), (10.0, 0.0, 0.0), (8.0, -15.0, 20.0)]
)
def test_the_covariance_is_the_scatter(range_m, pitch, yaw, blobs):
    rotation, translation = pose_at(range_m, pitch, yaw, 30.0, (20.0, 10.0), CAMERA)
    rng = np.random.default_rng(2)
    trials, total = 60, 0.0
    for _ in range(trials):
        found = solve_pose(features(rotation, translation, blobs, 0.02, rng), MARKER, CAMERA)
        error = error_vector(found.rotation, found.translation_m, rotation, translation)
        total += error @ np.linalg.solve(found.covariance, error)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 6 * trials)
    # One frame in a hundred is widened for an improbable residual.
    assert 0.97 * low < total < high


def test_an_improbable_residual_widens_the_covariance():
    rotation, translation = pose_at(3.0, 10.0, 5.0, 0.0, (0.0, 0.0), CAMERA)
    plain = solve_pose(features(rotation, translation, ELEMENT_NAMES), MARKER, CAMERA)
    spoilt = features(rotation, translation, ELEMENT_NAMES)
    spoilt.corners_px[0] += 0.5
    worse = solve_pose(spoilt, MARKER, CAMERA)
    assert worse.residual > 10
    assert np.all(np.diag(worse.covariance) > 5 * np.diag(plain.covariance))


def test_no_corners_no_pose():
    nothing = Features(
        identity=None,
        corners_px=None,
        corners_covariance_px2=None,
        blobs_px=dict.fromkeys(ELEMENT_NAMES),
        blob_sigma_px={},
        virtual_points_px={},
        reason="no marker found",
    )
    assert solve_pose(nothing, MARKER, CAMERA) is None


def test_attitude_from_images_of_28_pixels_is_good_to_a_quarter_degree():
    # At 4.4 m the ArUco spans 28 columns.
    rng = np.random.default_rng(3)
    squares = []
    camera = Camera(width_px=128, height_px=128)
    for _ in range(15):
        rotation, translation = pose_at(
            4.4, *rng.uniform(-30, 30, 2), rng.uniform(-180, 180), tuple(rng.uniform(-2, 2, 2)), camera
        )
        mean = electrons(MARKER, camera, rotation, translation, rng, samples=8)
        for _ in range(2):
            found = solve_pose(find_features(expose(mean, rng), MARKER, camera, NOISE), MARKER, camera)
            assert found is not None
            squares.append(rotation_angle(found.rotation, rotation) ** 2)
    assert np.degrees(np.sqrt(np.mean(squares))) <= 0.25


@pytest.mark.parametrize("range_m", [1.0, 2.0, 4.0, 6.0, 8.0, 10.0])
def test_a_frontal_marker_has_one_attitude_at_every_range(range_m):
    camera = CAMERA if range_m < 2 else Camera(width_px=256, height_px=256)
    rotation, translation = pose_at(range_m, 0.0, 0.0, 0.0, (0.3, -0.4), camera)
    rng = np.random.default_rng(4)
    mean = electrons(MARKER, camera, rotation, translation, rng, samples=4 if range_m < 3 else 12)
    for _ in range(4):
        f = find_features(expose(mean, rng), MARKER, camera, NOISE)
        found = solve_pose(f, MARKER, camera)
        assert found is not None
        assert not found.ambiguous
        assert np.degrees(rotation_angle(found.rotation, rotation)) < (0.2 if range_m < 5 else 1.0)
        assert np.linalg.norm(found.translation_m) == pytest.approx(np.linalg.norm(translation), rel=3e-3)
        assert np.all(np.linalg.eigvalsh(found.covariance) > 0)


def test_blobs_that_contradict_the_corners_give_way() -> None:
    """Near by, a tilted square's corners know the attitude to 0.1 deg; blobs 1 px off would turn it by degrees."""
    rotation, translation = pose_at(1.0, 25.0, -20.0, 30.0)
    seen = features(rotation, translation, ELEMENT_NAMES, rng=np.random.default_rng(5))
    moved = {n: at + np.array([1.0, 1.0]) for n, at in seen.blobs_px.items() if at is not None}
    pose = solve_pose(replace(seen, blobs_px=moved), MARKER, CAMERA)
    assert pose is not None
    assert np.degrees(rotation_angle(pose.rotation, rotation)) < 0.3
    error = error_vector(pose.rotation, pose.translation_m, rotation, translation)
    assert error @ np.linalg.solve(pose.covariance, error) < chi2.isf(1e-4, 6)


def test_corners_that_do_not_fit_by_themselves_leave_the_blobs_their_weight() -> None:
    """One corner half a pixel off, seen squarely: the blobs still hold the attitude, which the corners alone would lose."""
    rotation, translation = pose_at(5.0, 0.0, 0.0, 10.0)
    seen = features(rotation, translation, ELEMENT_NAMES)
    assert seen.corners_px is not None
    wrong = seen.corners_px + np.array([[0.5, 0.0], [0, 0], [0, 0], [0, 0]])
    pose = solve_pose(replace(seen, corners_px=wrong), MARKER, CAMERA)
    alone = solve_pose(replace(seen, corners_px=wrong, blobs_px={}), MARKER, CAMERA)
    assert pose is not None
    assert alone is not None
    by_both, by_corners = (np.degrees(rotation_angle(p.rotation, rotation)) for p in (pose, alone))
    assert by_both < 0.2 * by_corners
