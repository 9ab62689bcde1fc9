"""Distortion: OpenCV's formula, its derivative and its inverse, and what happens where it folds back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from radiometry.distortion import BrownConrady
from radiometry.geometry import FloatArray
from radiometry.optics import Camera

#: 32° off the axis at the corners.
WIDE = {"width_px": 320, "height_px": 240, "focal_length_m": 2.7e-3}
BARREL = Camera(**WIDE, k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3, k3=-0.004)
small_coefficient = st.floats(-0.12, 0.12)


def directions(camera: Camera, image_px: FloatArray) -> FloatArray:
    """Points (..., 3) that an ideal lens images at positions (..., 2)."""
    tangents = (image_px - camera.principal_point_px) / camera.focal_px
    return np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    k1=small_coefficient,
    k2=small_coefficient,
    p1=st.floats(-5e-3, 5e-3),
    p2=st.floats(-5e-3, 5e-3),
    k3=small_coefficient,
    x=st.floats(0, 319),
    y=st.floats(0, 239),
)
def test_projection_undoes_undistortion_everywhere_in_the_frame(
    k1: float, k2: float, p1: float, p2: float, k3: float, x: float, y: float
) -> None:
    camera = Camera(**WIDE, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    image = np.array([x, y])
    # 1e-10 in tangents, the inverse's stated residual, is 3e-8 px here.
    np.testing.assert_allclose(camera.project(directions(camera, camera.undistort_px(image))), image, atol=1e-7)


def test_distortion_is_opencvs() -> None:
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (500, 3))
    coefficients = np.array([BARREL.k1, BARREL.k2, BARREL.p1, BARREL.p2, BARREL.k3])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), BARREL.matrix, coefficients)
    np.testing.assert_allclose(BARREL.project(points), theirs[:, 0], atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.tuples(*[st.floats(-0.3, 0.3)] * 5), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_the_derivative_of_distortion_is_its_derivative(k: tuple[float, ...], x: float, y: float) -> None:
    lens, step = BrownConrady(*k), 1e-6
    by_x = (np.array(lens.distort(x + step, y)) - lens.distort(x - step, y)) / (2 * step)
    by_y = (np.array(lens.distort(x, y + step)) - lens.distort(x, y - step)) / (2 * step)
    xx, xy, yy = lens.derivative(x, y)
    np.testing.assert_allclose([by_x, by_y], [[xx, xy], [xy, yy]], atol=1e-8)


def test_without_coefficients_the_lens_is_a_pinhole_to_the_last_bit() -> None:
    camera = Camera(**WIDE)
    points = np.random.default_rng(2).uniform([-1, -1, 2], [1, 1, 4], (100, 3))
    np.testing.assert_array_equal(
        camera.project(points), points[:, :2] / points[:, 2:] * camera.focal_px + camera.principal_point_px
    )
    assert camera.without_distortion is camera
    assert not BARREL.without_distortion.distorted


def test_what_stands_outside_the_frame_is_not_folded_back_into_it() -> None:
    angle = np.linspace(0, 2 * np.pi, 60)[:, None]
    far = np.linspace(1.0, 30.0, 40)
    points = np.stack([far * np.cos(angle), far * np.sin(angle), np.ones_like(far * angle)], axis=-1)
    polynomial = np.stack(BARREL.distortion.distort(points[..., 0], points[..., 1]), axis=-1) * BARREL.focal_px
    corner = np.array(BARREL.principal_point_px)
    assert np.any(np.all(np.abs(polynomial) < corner, axis=-1))  # as the bare polynomial would
    assert not np.any(np.all(np.abs(BARREL.project(points) - corner) < corner, axis=-1))


@pytest.mark.parametrize("coefficients", [{"k1": -1.5}, {"k1": 0.1, "k2": -2.0}, {"p1": 0.5}, {"k3": -4.0}])
def test_a_lens_that_folds_the_frame_back_is_refused(coefficients: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match="folds the image back within the frame"):
        Camera(**WIDE, **coefficients)


def test_distortion_spreads_light_without_making_any() -> None:
    """What falls on all pixels of a uniform scene is what the pupil takes from the solid angle that they show."""
    sharp = BARREL.relative_illumination() / BARREL.natural_falloff()  # ideal area of each pixel
    right, bottom = BARREL.width_px - 0.5, BARREL.height_px - 0.5
    x, y = np.linspace(-0.5, right, 2001), np.linspace(-0.5, bottom, 2001)
    sides = [(x, 0 * x - 0.5), (0 * y + right, y), (x[::-1], 0 * x + bottom), (0 * y - 0.5, y[::-1])]
    px, py = BARREL.undistort_px(np.concatenate([np.column_stack(side) for side in sides])).T
    area = abs(px @ np.roll(py, -1) - py @ np.roll(px, -1)) / 2
    assert sharp.sum() == pytest.approx(area, rel=1e-5)  # midpoint rule over the pixels
    assert area > BARREL.width_px * BARREL.height_px  # a barrel shows more
