"""Candidates: dark squares in something brighter are found wherever they are, and nothing else is needed of them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from detector.pattern.candidates import dark_squares, search
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray

NOISE = NoiseModel(gain_dn_per_electron=0.5, read_noise_dn=10.0, offset_dn=64.0, saturation_dn=4095.0)
SIZE = 160
#: Sub-pixels along a side of a pixel.
FINE = 8


def square(side_px: float, turn_deg: float, centre_px: tuple[float, float] = (80.3, 78.6)) -> FloatArray:
    """Corners (4, 2) of a square, clockwise as seen [px]."""
    turn = np.radians(turn_deg)
    corners = side_px / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return corners @ rotation + centre_px


def framed(corners: FloatArray, bright: float = 2000.0, dark: float = 200.0) -> FloatArray:
    """Image of a dark square in a bright frame a third as wide, on dark ground."""
    image = np.full((FINE * SIZE, FINE * SIZE), dark)
    centre = corners.mean(0)
    for scale, level in ((5 / 3, bright), (1.0, dark)):
        outline = FINE * (centre + scale * (corners - centre) + 0.5) - 0.5
        cv2.fillConvexPoly(image, np.rint(outline).astype(np.int32), level)
    return image.reshape(SIZE, FINE, SIZE, FINE).mean((1, 3))


def noisy(image: FloatArray, seed: int = 1) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(image, np.sqrt(NOISE.variance(image)))
    return np.clip(np.rint(drawn), 0, NOISE.saturation_dn).astype(np.uint16)


def distance(quad: FloatArray, corners: FloatArray) -> float:
    """Furthest distance of a corner, whichever of them comes first [px]."""
    return min(float(np.linalg.norm(np.roll(quad, k, axis=0) - corners, axis=1).max()) for k in range(4))


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, 45.0])
@pytest.mark.parametrize("side_px", [8.0, 25.0, 80.0])
def test_a_drawn_square_is_among_the_candidates(side_px: float, turn_deg: float) -> None:
    """To two pixels: from there the fit of the pattern finds its way."""
    corners = square(side_px, turn_deg)
    near = [distance(quad, corners) for quad, _ in search(noisy(framed(corners)), NOISE)]
    assert min(near) < 2.0


def test_a_large_square_is_found_where_it_is_without_noise() -> None:
    corners = square(60.0, 30.0)
    found = list(dark_squares(framed(corners).astype(np.float32), 7, (400.0, 0.0), NOISE.saturated_above_dn))
    assert min(distance(quad, corners) for quad in found) < 1.5


def test_candidates_run_clockwise_as_seen() -> None:
    for quad, _ in search(noisy(framed(square(30.0, 20.0))), NOISE):
        sides = np.roll(quad, -1, axis=0) - quad
        after = np.roll(sides, -1, axis=0)
        assert np.all(sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0] > 0)


def test_the_largest_of_several_comes_first() -> None:
    small, large = square(15.0, 10.0, (35.0, 35.0)), square(40.0, 10.0, (105.0, 105.0))
    image = np.maximum(framed(small), framed(large)).astype(np.float32)
    found = list(dark_squares(image, 7, (400.0, 0.0), NOISE.saturated_above_dn))
    places = [[distance(quad, corners) < 2.0 for quad in found].index(True) for corners in (large, small)]
    assert places[0] < places[1]


def test_a_square_in_saturated_light_is_found() -> None:
    corners = square(30.0, 25.0)
    image = noisy(framed(corners, bright=50_000.0))
    assert min(distance(quad, corners) for quad, _ in search(image, NOISE)) < 2.0


def test_a_faint_square_is_found_on_a_smoothed_copy_and_its_blur_is_told() -> None:
    """Rationale: 12 DN over 14 DN of noise is less than the threshold of single pixels."""
    corners = square(60.0, 5.0)
    image = noisy(framed(corners, bright=212.0, dark=200.0))
    near = [blur for quad, blur in search(image, NOISE) if distance(quad, corners) < 5.0]
    assert near
    assert min(near) > 0


def test_a_square_that_the_image_s_edge_cuts_is_none() -> None:
    corners = square(40.0, 0.0, (12.0, 80.0))
    assert all(distance(quad, corners) > 5.0 for quad, _ in search(noisy(framed(corners)), NOISE))


@pytest.mark.parametrize("level", [0.0, 300.0, 4095.0])
def test_an_even_image_has_no_candidates(level: float) -> None:
    assert list(search(np.full((SIZE, SIZE), level), NOISE)) == []
