"""EPnP against truth, and the thesis routine's two faults with coplanar points."""

from __future__ import annotations

import numpy as np
import pytest
from point_scenes import CAMERA, DEEP, FLAT, problem
from scipy.spatial.transform import Rotation

from detector.pnp import pnp
from detector.pnp.epnp import epnp, epnp_as_used
from radiometry.geometry import FRONTAL


@pytest.mark.parametrize("points", [FLAT, DEEP], ids=["flat", "deep"])
def test_noise_free_pose_is_found(points: np.ndarray) -> None:
    every, pixels, visible, rotation, translation = problem(points, 12, 1)
    found_r, found_t = epnp(every, pixels, visible, CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found_r)).max() < 1e-4
    assert np.linalg.norm(found_t - translation, axis=1).max() < 1e-4
    assert np.linalg.det(found_r) == pytest.approx(np.ones(12))


def test_hidden_points_have_no_say() -> None:
    every, pixels, visible, rotation, _ = problem(DEEP, 20, 3)
    pixels, visible = pixels.copy(), visible.copy()
    visible[:, 6:] = False
    pixels[:, 6:] = 1e4
    assert np.rad2deg(pnp.geodesic_angles(rotation, epnp(every, pixels, visible, CAMERA)[0])).max() < 1e-3


def _as_used(rotation: np.ndarray, **kwargs: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, and the thesis routine's pose of a coplanar set in the thesis's frame, z into the face."""
    square = np.broadcast_to(FLAT, (len(rotation), *FLAT.shape))
    translation = np.tile([0, 0, 5.0], (len(rotation), 1))
    pixels = CAMERA.project(square @ np.swapaxes(rotation, 1, 2) + translation[:, None])
    found_r, found_t = epnp_as_used(square, pixels, np.ones(square.shape[:2], bool), CAMERA, **kwargs)
    return rotation, found_r, found_t


def _frontal(count: int, turned: bool) -> np.ndarray:
    tilt = np.random.default_rng(11).uniform(-0.6, 0.6, (count, 3))
    return (FRONTAL if turned else np.eye(3)) @ Rotation.from_rotvec(tilt).as_matrix()


def test_thesis_routine_puts_coplanar_points_seen_along_z_behind_the_camera() -> None:
    _, _, translation = _as_used(_frontal(100, turned=False))
    assert np.mean(translation[:, 2] < 0) > 0.9


def test_thesis_routine_turns_coplanar_points_seen_against_z_about_their_normal() -> None:
    rotation, found, translation = _as_used(_frontal(100, turned=True))
    turned = rotation @ np.diag([-1.0, -1.0, 1.0])
    assert np.mean((np.rad2deg(pnp.geodesic_angles(turned, found)) < 1) & (translation[:, 2] > 0)) > 0.9


def test_sign_of_the_reflection_is_that_of_householder() -> None:
    rotation = Rotation.random(400, rng=np.random.default_rng(12)).as_matrix()
    # Away from grazing views, and from the border where the points' uneven spread decides.
    decision = np.sign(rotation[:, 0, 0]) * rotation[:, 1, 1] + rotation[:, 2, 2]
    rotation = rotation[(np.abs(rotation[:, 2, 2]) > 0.3) & (np.abs(decision) > 0.15)]
    decision = np.sign(rotation[:, 0, 0]) * rotation[:, 1, 1] + rotation[:, 2, 2]
    _, found, _ = _as_used(rotation, gauss_newton=False)
    lost = np.rad2deg(pnp.geodesic_angles(rotation, found)) > 90
    assert np.mean(lost == (decision < 0)) > 0.98


def test_thesis_routine_is_sound_with_depth() -> None:
    every, pixels, visible, rotation, _ = problem(DEEP, 100, 13, sigma_px=0.05, range_m=3.0)
    found, _ = epnp_as_used(every, pixels, visible, CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found)).max() < 3
