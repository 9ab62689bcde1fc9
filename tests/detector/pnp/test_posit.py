"""POSIT against truth, and SoftPOSIT's pose and correspondences."""

from __future__ import annotations

import numpy as np
import pytest
from point_scenes import CAMERA, DEEP, FLAT, problem
from scipy.spatial.transform import Rotation

from detector.pnp import pnp
from detector.pnp.posit import posit, softposit


@pytest.mark.parametrize("points", [FLAT, DEEP], ids=["flat", "deep"])
def test_noise_free_pose_is_found(points: np.ndarray) -> None:
    every, pixels, visible, rotation, translation = problem(points, 12, 1)
    found_r, found_t = posit(every, pixels, visible, CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found_r)).max() < 1e-3
    assert np.linalg.norm(found_t - translation, axis=1).max() < 1e-4
    assert np.linalg.det(found_r) == pytest.approx(np.ones(12))


def test_softposit_finds_pose_and_correspondences() -> None:
    points = np.random.default_rng(14).uniform(-0.25, 0.25, (8, 3)) * [1, 1, 0.4]
    every, pixels, visible, rotation, translation = problem(points, 40, 15, range_m=5.0)
    turn = Rotation.from_rotvec(np.random.default_rng(16).normal(0, np.deg2rad(4), (40, 3))).as_matrix()
    found, _, match = softposit(every, pixels, visible, CAMERA, (turn @ rotation, translation * 1.03))
    right = np.rad2deg(pnp.geodesic_angles(rotation, found)) < 5
    assert right.mean() > 0.8
    assert (match[right].argmax(axis=2) == np.arange(8)).mean() > 0.95
    with pytest.raises(ValueError, match="every point must be visible"):
        softposit(every, pixels, ~visible, CAMERA, (rotation, translation))
