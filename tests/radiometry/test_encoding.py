"""Deviations of the viewing angle against the marker's geometry and against drawn corners."""

from __future__ import annotations

import numpy as np
import pytest

from radiometry.encoding import RAYLEIGH_MEDIAN, lens_deviation, slit_deviation, square_deviation
from radiometry.geometry import attitude_matrix
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

FAR_M = 2000.0  # weak perspective
CAMERA = Camera(focal_length_m=10.0)


@pytest.mark.parametrize("pitch_deg", [0.0, 20.0, 45.0])
@pytest.mark.parametrize("axis", ["along", "across"])
def test_slits_against_the_moving_blob(pitch_deg: float, axis: str) -> None:
    """The blob's image per radian, by differences of the marker's own geometry."""
    marker, step = MarkerDesign(), 1e-4
    # The right element lies along y: a pitch tilts it along itself, and a yaw is seen by the top one, across.
    element = marker.elements[1 if axis == "along" else 0]

    def place_px(turn: float) -> float:
        pitch = np.radians(pitch_deg)
        rotation = attitude_matrix(pitch + turn, 0.0) if axis == "along" else attitude_matrix(pitch, turn)
        offset = np.array([0.0, 0.0, FAR_M])
        u = element.blob_offset_m(-rotation.T @ offset)
        points = element.centre_m + np.array([[0.0], [float(u)]]) * element.along
        image = CAMERA.project(points @ rotation.T + offset)
        return float(
            (image[1] - image[0]) @ (rotation @ element.along)[:2] / np.linalg.norm((rotation @ element.along)[:2])
        )

    scale = CAMERA.focal_px[1 if axis == "along" else 0] / FAR_M
    per_radian = abs(place_px(step) - place_px(-step)) / (2 * step)
    # Tilted along itself the element's own foreshortening shifts its blob too, which the corners tell: taken out here.
    if axis == "along":
        u = element.virtual_offset_m + np.tan(np.radians(pitch_deg)) * element.virtual_depth_m
        wander = np.sin(np.radians(pitch_deg)) * u * scale
        per_radian = abs((place_px(step) - place_px(-step)) / (2 * step) + wander)
    expected = float(slit_deviation(np.radians(pitch_deg), element.virtual_depth_m * scale, 1.0))
    assert 1 / per_radian == pytest.approx(expected, rel=2e-3)


def test_a_lens_with_a_field_of_a_right_angle_is_an_element_with_its_line_at_half_its_length() -> None:
    tilt = np.radians([0.0, 30.0, 60.0])
    assert lens_deviation(tilt, np.pi / 2, 80.0, 0.1) == pytest.approx(slit_deviation(tilt, 40.0, 0.1))
    assert np.all(lens_deviation(tilt, np.radians(30), 80.0, 0.1) < lens_deviation(tilt, np.radians(60), 80.0, 0.1))


@pytest.mark.parametrize("tilt_deg", [15.0, 30.0, 60.0])
def test_a_squares_tilt_from_drawn_corners(tilt_deg: float) -> None:
    """The ratio of mean sides of 20 000 noisy squares; a standard deviation's relative error is 1/√(2n), four of them."""
    draws, side, sigma, tilt = 20_000, 100.0, 0.1, np.radians(tilt_deg)
    corners = side * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * [1, np.cos(tilt)]
    seen = corners + np.random.default_rng(7).normal(0, sigma, (draws, 4, 2))
    width = (seen[:, 1, 0] - seen[:, 0, 0] + seen[:, 2, 0] - seen[:, 3, 0]) / 2
    height = (seen[:, 3, 1] - seen[:, 0, 1] + seen[:, 2, 1] - seen[:, 1, 1]) / 2
    found = np.arccos(np.clip(height / width, -1, 1))
    assert found.std() == pytest.approx(float(square_deviation(tilt, side, sigma)), rel=4 / np.sqrt(2 * draws))
    assert square_deviation(0.0, side, sigma) == np.inf


def test_median_of_two_equal_normal_parts() -> None:
    drawn = np.linalg.norm(np.random.default_rng(1).standard_normal((200_000, 2)), axis=1)
    assert np.median(drawn) == pytest.approx(RAYLEIGH_MEDIAN, rel=0.005)
