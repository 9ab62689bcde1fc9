"""Pixels that count as a bit's, against the window that they are defined by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometry.link import sampling_window_px
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.bits import bit_pixels, bit_scale_px
from scenes.target import Target
from scenes.view import View

CAMERA = Camera(width_px=200, height_px=160)
VIEW = View(
    camera=CAMERA,
    marker=MarkerDesign(),
    target=Target(),
    leds=LedRing(),
    sun=Sun(),
    range_m=2.0,
    nodes_nm=(850,),
)


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 60.0])
def test_a_yawed_marker_is_foreshortened_along_x_alone(yaw_deg: float) -> None:
    x, y = bit_scale_px(replace(VIEW, target=Target(yaw_deg=yaw_deg)))
    assert x == pytest.approx(CAMERA.focal_px[0] / 2.0 * np.cos(np.radians(yaw_deg)), rel=1e-6)
    assert y == pytest.approx(CAMERA.focal_px[1] / 2.0, rel=1e-6)


@pytest.mark.parametrize("range_m", [1.5, 4.0])
def test_the_pixels_of_a_bit_are_those_within_its_window(range_m: float) -> None:
    """Of a frontal marker the window is a rectangle of pixels, found here by looking at every pixel of the frame."""
    view = replace(VIEW, range_m=range_m)
    centres = view.marker.white_bit_centres_m()
    half = sampling_window_px(view.marker.bit_m * np.array(bit_scale_px(view))) / 2
    row, column = np.mgrid[: CAMERA.height_px, : CAMERA.width_px]
    for (rows, columns), centre in zip(bit_pixels(view, centres), view.to_image(centres), strict=True):
        inside = (np.abs(column - centre[0]) <= half[0]) & (np.abs(row - centre[1]) <= half[1])
        assert set(zip(rows, columns, strict=True)) == set(zip(*np.nonzero(inside), strict=True))
        assert len(rows) > 0


def test_a_bit_smaller_than_a_pixel_has_at_least_the_nearest_one() -> None:
    view = replace(VIEW, range_m=40.0)
    centres = view.marker.white_bit_centres_m()
    for (rows, columns), centre in zip(bit_pixels(view, centres), view.to_image(centres), strict=True):
        nearest = np.rint(centre).astype(int)
        assert (nearest[1], nearest[0]) in set(zip(rows, columns, strict=True))


def test_a_bit_outside_the_frame_has_no_pixels() -> None:
    [(rows, columns)] = bit_pixels(VIEW, np.array([[1.0, 0.0, 0.0]]))
    assert len(rows) == len(columns) == 0


def test_a_large_bit_is_sampled_by_few_pixels() -> None:
    [(rows, columns)] = bit_pixels(replace(VIEW, range_m=0.1), np.zeros((1, 3)))
    assert len(np.unique(rows)) <= 33
    assert len(np.unique(columns)) <= 33
