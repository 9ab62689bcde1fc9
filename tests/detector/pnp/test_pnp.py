"""The batched pose solvers against truth, each other, their noise-free limits and their own covariance."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from point_scenes import CAMERA, DEEP, FLAT, SQUARE, problem
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from detector.pnp import pnp
from radiometry.geometry import attitude_matrix


@pytest.mark.parametrize("points", [FLAT, DEEP], ids=["flat", "deep"])
@pytest.mark.parametrize(
    ("solver", "tolerance_deg"),
    [(pnp.epnp_refined, 1e-5), (pnp.sqpnp, 1e-3), (pnp.two_start, 1e-5)],
    ids=["epnp_refined", "sqpnp", "two_start"],
)
def test_noise_free_pose_is_found(points: np.ndarray, solver: pnp.Solver, tolerance_deg: float) -> None:
    every, pixels, visible, rotation, translation = problem(points, 12, 1)
    found_r, found_t = solver(every, pixels, visible, CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found_r)).max() < tolerance_deg
    assert np.linalg.norm(found_t - translation, axis=1).max() < 1e-4
    assert np.linalg.det(found_r) == pytest.approx(np.ones(12))


def test_ippe_finds_the_noise_free_pose_of_coplanar_points() -> None:
    every, pixels, visible, rotation, _ = problem(FLAT, 12, 2)
    assert np.rad2deg(pnp.geodesic_angles(rotation, pnp.ippe_refined(every, pixels, visible, CAMERA)[0])).max() < 1e-5


def test_hidden_points_have_no_say() -> None:
    every, pixels, visible, rotation, _ = problem(DEEP, 20, 3)
    pixels, visible = pixels.copy(), visible.copy()
    visible[:, 6:] = False
    pixels[:, 6:] = 1e4
    found_r, _ = pnp.two_start(every, pixels, visible, CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found_r)).max() < 1e-3


@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.1, 3.1), st.floats(2.0, 30.0))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_mirror_of_the_mirror_is_the_pose(pitch: float, yaw: float, roll: float, range_m: float) -> None:
    rotation, translation = attitude_matrix(pitch, yaw, roll)[None], np.array([[0.1, -0.2, range_m]])
    other = pnp.mirrored((rotation, translation))
    assert np.linalg.det(other[0]) == pytest.approx(1)
    assert pnp.mirrored(other)[0] == pytest.approx(rotation)
    # Both show the same side of the marker, under the same angle to the line of sight.
    assert other[0][0, :, 2] @ translation[0] == pytest.approx(rotation[0, :, 2] @ translation[0])


def test_refinement_never_raises_the_error_and_ends_at_a_minimum() -> None:
    every, pixels, visible, rotation, translation = problem(DEEP, 60, 4, sigma_px=0.3)
    turned = Rotation.from_rotvec(np.random.default_rng(5).normal(0, 0.1, (60, 3))).as_matrix() @ rotation
    start = turned, translation * 1.05
    before = pnp.squared_error(every, pixels, visible, CAMERA, start)
    found_r, found_t, after = pnp.refine(every, pixels, visible, CAMERA, start)
    assert np.all(after <= before)
    assert after == pytest.approx(pnp.squared_error(every, pixels, visible, CAMERA, (found_r, found_t)))
    for step in np.vstack([np.eye(6), -np.eye(6)]) * 1e-4:
        moved = Rotation.from_rotvec(step[:3]).as_matrix() @ found_r, found_t + step[3:]
        assert np.all(pnp.squared_error(every, pixels, visible, CAMERA, moved) >= after - 1e-9)


def test_scene_behind_the_camera_is_left_alone() -> None:
    every, pixels, visible, rotation, translation = problem(DEEP, 2, 6)
    behind = translation * [[1, 1, -1], [1, 1, 1]]
    found_r, found_t, error = pnp.refine(every, pixels, visible, CAMERA, (rotation, behind))
    assert list(np.isfinite(error)) == [False, True]
    assert np.array_equal(found_r[0], rotation[0])
    assert np.array_equal(found_t[0], behind[0])


def test_covariance_is_that_of_the_draws() -> None:
    sigma, count = 0.2, 800
    every, pixels, visible, rotation, translation = problem(DEEP, 1, 7, range_m=4.0)
    repeat = [np.repeat(a, count, axis=0) for a in (every, pixels, visible, rotation, translation)]
    noisy = repeat[1] + sigma * np.random.default_rng(8).standard_normal(repeat[1].shape)
    found_r, found_t = pnp.two_start(repeat[0], noisy, repeat[2], CAMERA)
    turn = Rotation.from_matrix(found_r @ rotation[0].T).as_rotvec()
    error = np.concatenate([turn, found_t - translation], axis=1)
    expected = pnp.covariance(every, np.array([sigma]), visible, CAMERA, (rotation, translation))[0]
    distance = np.einsum("ni,ij,nj->n", error, np.linalg.inv(expected), error)
    # The sum of squared Mahalanobis distances is χ² with 6 n degrees of freedom: 99.9 % interval.
    low, high = chi2(6 * count).ppf([0.0005, 0.9995])
    assert low < distance.sum() < high


def test_solvers_reach_the_same_minimum() -> None:
    every, pixels, visible, _, _ = problem(DEEP, 100, 9, sigma_px=0.2, range_m=8.0)
    two = pnp.squared_error(every, pixels, visible, CAMERA, pnp.two_start(every, pixels, visible, CAMERA))
    for solver in (pnp.epnp_refined, pnp.sqpnp):
        other = pnp.squared_error(every, pixels, visible, CAMERA, solver(every, pixels, visible, CAMERA))
        assert np.all(two <= other * (1 + 1e-6))


def test_two_start_serves_a_marker_too_small_for_opencv_sqpnp() -> None:
    points = 0.05 * np.concatenate([SQUARE / 0.5, [[0, 0, -0.5]]])
    every, pixels, visible, rotation, _ = problem(points, 50, 10, sigma_px=0.05, range_m=20.0)
    assert np.isnan(pnp.sqpnp(every, pixels, visible, CAMERA)[1]).all()
    assert np.rad2deg(pnp.geodesic_angles(rotation, pnp.two_start(every, pixels, visible, CAMERA)[0])).max() < 10


@pytest.mark.parametrize("solve", [pnp.sqpnp, pnp.iterative, pnp.two_start])
def test_too_few_points_give_no_pose(solve: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    every, pixels, visible, _, _ = problem(DEEP, 3, 17)
    visible = visible.copy()
    visible[:, 2:] = False
    assert np.isnan(solve(every, pixels, visible, CAMERA)[1]).all()
