"""Chessboard corners on drawn images, and a camera from exact corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.stats import t as student

from detector.calibration.camera import calibrate_camera, chessboard_corners
from radiometry.geometry import FloatArray, attitude_matrix
from radiometry.optics import Camera

COLUMNS, ROWS, SQUARE_M = 8, 6, 0.03
CAMERA = Camera(width_px=320, height_px=240, focal_length_m=6e-3, k1=-0.1, p1=5e-4)


def board_m() -> FloatArray:
    x, y = (np.arange(COLUMNS) - 3.5) * SQUARE_M, (2.5 - np.arange(ROWS)) * SQUARE_M
    return np.stack([*np.meshgrid(x, y), np.zeros((ROWS, COLUMNS))], axis=-1).reshape(-1, 3)


def drawn(rotation: FloatArray, translation: FloatArray, samples: int = 5) -> FloatArray:
    """Bright and dark squares through the lens, sampled at jittered places, then point spread and pixel."""
    rng = np.random.default_rng(9)
    height, width = CAMERA.height_px, CAMERA.width_px
    row, column = np.indices((height * samples, width * samples))
    places = np.stack([column, row], axis=-1) + rng.random((height * samples, width * samples, 2))
    points = CAMERA.undistort_px(places.reshape(-1, 2) / samples - 0.5)
    homography = CAMERA.matrix @ np.column_stack([rotation[:, :2], translation])
    plane = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(homography).T
    x, y = (plane[:, :2] / plane[:, 2:]).T / SQUARE_M
    on_board = (np.abs(x) < (COLUMNS + 1) / 2) & (np.abs(y) < (ROWS + 1) / 2)
    dark = on_board & ((np.floor(x + 0.5).astype(int) + np.floor(y + 0.5).astype(int)) % 2 == 0)
    light = np.where(dark, 100.0, 4000.0).reshape(height * samples, width * samples)
    blurred = cv2.GaussianBlur(light, (0, 0), CAMERA.psf_sigma_px * samples)
    return blurred.reshape(height, samples, width, samples).mean(axis=(1, 3))


def poses() -> list[tuple[FloatArray, FloatArray]]:
    tilts = [(0, 0, 0), (25, 5, 0), (-25, -5, 5), (5, 25, -5), (-5, -25, 0), (20, 20, 10), (-20, 20, 0)]
    return [(attitude_matrix(*np.radians(t)), np.array([0.01 * k - 0.03, 0.01, 0.66])) for k, t in enumerate(tilts)]


def test_corners_are_found_without_bias() -> None:
    rotation, translation = poses()[1]
    image, truth = drawn(rotation, translation), CAMERA.project(board_m() @ rotation.T + translation)
    exact = chessboard_corners(image, (COLUMNS, ROWS), CAMERA.psf_sigma_px)
    assert exact is not None
    order = truth if np.abs(exact - truth).mean() < np.abs(exact - truth[::-1]).mean() else truth[::-1]
    # What is left is the drawing: edges at random places among the samples.
    assert np.sqrt(np.mean((exact - order) ** 2)) < 0.012
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(4):
        noisy = np.rint(image + rng.normal(0, 40.0, image.shape)).clip(0, 4095).astype(np.uint16)
        found = chessboard_corners(noisy, (COLUMNS, ROWS), CAMERA.psf_sigma_px)
        assert found is not None
        errors.append(found - order)
    error = np.array(errors).reshape(-1, 2)
    assert error.std() < 0.02
    # What is left without noise is no bias of the noise's.
    limit = student.ppf(0.9995, len(error) - 1) * error.std(axis=0) / np.sqrt(len(error))
    assert np.all(np.abs(error.mean(axis=0) - (exact - order).mean(axis=0)) < limit)


def test_an_image_without_the_board_gives_nothing() -> None:
    noise = np.random.default_rng(2).normal(1000, 30, (120, 160))
    assert chessboard_corners(noise, (COLUMNS, ROWS)) is None
    assert chessboard_corners(np.full((120, 160), 7), (COLUMNS, ROWS)) is None
    with pytest.raises(ValueError, match=r"image: shape \(2, 3, 4\)"):
        chessboard_corners(np.zeros((2, 3, 4)), (COLUMNS, ROWS))


def test_a_camera_comes_back_from_its_corners() -> None:
    rng = np.random.default_rng(3)
    corners = [CAMERA.project(board_m() @ r.T + t) + rng.normal(0, 0.01, (COLUMNS * ROWS, 2)) for r, t in poses()]
    found = calibrate_camera(corners, board_m(), (CAMERA.width_px, CAMERA.height_px))
    truth = np.array([*CAMERA.focal_px, *CAMERA.principal_point_px, CAMERA.k1, 0, CAMERA.p1, 0])
    values = np.array([*found.focal_px, *found.principal_point_px, *found.distortion[:4]])
    assert np.all(np.abs(values - truth) < 4 * found.sigma[:8])
    assert np.abs(found.focal_px / CAMERA.focal_px - 1).max() < 1e-3
    assert found.rms_px == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
    assert found.views == 7
    straight = calibrate_camera(corners, board_m(), (CAMERA.width_px, CAMERA.height_px), distorted=False)
    assert not straight.distortion.any()
    assert straight.rms_px > 2 * found.rms_px


def test_too_few_views_are_refused() -> None:
    with pytest.raises(ValueError, match="corners_px: 1 views, expected three or more"):
        calibrate_camera([np.zeros((48, 2))], board_m(), (320, 240))
