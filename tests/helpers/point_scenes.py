"""Scenes of points for the pose solvers: exact or noisy projections from random attitudes."""

from __future__ import annotations

import numpy as np

from radiometry.geometry import FloatArray, attitude_matrix
from radiometry.optics import Camera

CAMERA = Camera()
SQUARE = 0.25 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
FLAT = np.concatenate([SQUARE, 0.6 * SQUARE + [0.02, 0.01, 0]])
DEEP = np.concatenate([SQUARE, 0.5 * SQUARE - [0.01, 0.02, 0.05]])
Problem = tuple[FloatArray, FloatArray, np.ndarray, FloatArray, FloatArray]


def problem(points: FloatArray, count: int, seed: int, sigma_px: float = 0.0, range_m: float = 5.0) -> Problem:
    """Points, pixels, visible, rotation and translation of `count` scenes tilted by up to 45°."""
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(-1, 1, (count, 3)) * [np.pi / 4, np.pi / 4, np.pi]
    rotation = np.stack([attitude_matrix(*angles) for angles in tilt])
    translation = np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), range_m * rng.uniform(0.8, 1.2, count)])
    every = np.broadcast_to(points, (count, *points.shape))
    pixels = CAMERA.project(every @ np.swapaxes(rotation, 1, 2) + translation[:, None])
    return (
        every,
        pixels + sigma_px * rng.standard_normal(pixels.shape),
        np.ones(every.shape[:2], bool),
        rotation,
        translation,
    )
