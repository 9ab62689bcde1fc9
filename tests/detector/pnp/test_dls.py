"""The direct least-squares method against truth."""

from __future__ import annotations

import numpy as np
import pytest
from point_scenes import CAMERA, DEEP, FLAT, problem
from scipy.spatial.transform import Rotation

from detector.pnp import pnp
from detector.pnp.dls import dls
from radiometry.geometry import FRONTAL


@pytest.mark.parametrize("points", [FLAT, DEEP], ids=["flat", "deep"])
def test_dls_finds_the_noise_free_pose(points: np.ndarray) -> None:
    every, pixels, visible, rotation, _ = problem(points, 2, 18)
    assert np.rad2deg(pnp.geodesic_angles(rotation, dls(every, pixels, visible, CAMERA)[0])).max() < 1e-3


def test_a_half_turn_about_the_line_of_sight_is_found_too() -> None:
    """Rationale: Cayley's rotation cannot turn by 180 degrees, so the solver starts from three attitudes."""
    rotation = np.stack([FRONTAL @ Rotation.from_euler("z", turn, degrees=True).as_matrix() for turn in (0, 180, 300)])
    every, translation = np.broadcast_to(DEEP, (3, *DEEP.shape)), np.array([0.1, -0.2, 5.0])
    pixels = CAMERA.project(every @ np.swapaxes(rotation, 1, 2) + translation)
    found_r, found_t = dls(every, pixels, np.ones(every.shape[:2], bool), CAMERA)
    assert np.rad2deg(pnp.geodesic_angles(rotation, found_r)).max() < 1e-3
    assert np.linalg.norm(found_t - translation, axis=1).max() < 1e-4
