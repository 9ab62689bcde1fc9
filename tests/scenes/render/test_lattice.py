"""Lattices of rays: where they lie, what they weigh, and why their generators are chosen."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from radiometry.optics import pixel_profile_integral
from scenes.render import lattice
from scenes.render.lattice import axis_weights, generator, points, reach_px, weights

COUNTS = st.sampled_from([1, 2, 4, 8, 16, 48, 64, 192, 512])
SHIFTS = st.tuples(st.floats(0, 1, exclude_max=True), st.floats(0, 1, exclude_max=True)).map(np.array)
SIGMAS = st.sampled_from([0.0, 0.2, 0.5, 0.8, 1.2])
ANGLES = st.floats(-180, 180)


def normals(angle_deg: float, between_deg: float = 90.0) -> np.ndarray:
    angle = np.radians([angle_deg, angle_deg + between_deg])
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@settings(deadline=None, derandomize=True)
@given(COUNTS, SHIFTS, ANGLES)
def test_points_fill_a_pixel_evenly_along_both_axes(count: int, shift: np.ndarray, angle: float) -> None:
    place = points(count, generator(count, normals(angle)), shift)
    assert place.min() >= -0.5
    assert place.max() < 0.5
    for axis in place.T:
        np.testing.assert_allclose(np.diff(np.sort(axis)), 1 / count, atol=1e-9)


@settings(deadline=None, derandomize=True)
@given(COUNTS, SHIFTS, SIGMAS)
def test_an_even_scene_renders_evenly(count: int, shift: np.ndarray, sigma: float) -> None:
    """A pixel's weights over itself and its neighbours add up to one, so that what all pixels give one does, too."""
    table = weights(points(count, generator(count, normals(10.0)), shift), sigma)
    assert table.shape == (count, (2 * reach_px(sigma) + 1) ** 2)
    assert table.sum() == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0])
def test_weights_are_the_kernel_where_the_rays_are(sigma: float) -> None:
    place = np.linspace(-0.5, 0.5, 9)
    reach = reach_px(sigma)
    step = 1e-5
    for offset, found in zip(range(-reach, reach + 1), axis_weights(place, sigma).T, strict=True):
        away = place - offset
        slope = pixel_profile_integral(away + step, sigma) - pixel_profile_integral(away - step, sigma)
        np.testing.assert_allclose(found, slope / (2 * step), atol=2e-5)


def edge_variance(count: int, chosen: int, angle_deg: float, sigma: float = 0.5, shifts: int = 200) -> float:
    """Variance over shifts of a pixel that a straight edge crosses off its centre; brightness 0 and 1."""
    rng = np.random.default_rng(1)
    reach = reach_px(sigma)
    pixel = np.arange(-reach, reach + 1)
    values = []
    normal = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    for _ in range(shifts):
        place = points(count, chosen, rng.random(2))
        table = weights(place, sigma).reshape(count, len(pixel), len(pixel))[:, ::-1, ::-1]
        x, y = place[:, 0, None, None] + pixel, place[:, 1, None, None] + pixel[:, None]
        values.append(np.sum(table * (x * normal[0] + y * normal[1] < 0.2)))
    return float(np.var(values))


#: Variance that jitter leaves of an edge, times N^1.5 and over the contrast squared: measured, mean over angles.
JITTER = 0.023


@pytest.mark.parametrize("angle", [0.0, 3.0, 17.0, 33.0, 44.0, 71.0])
def test_an_edge_is_far_less_noisy_than_with_jitter(angle: float) -> None:
    for count in (64, 192):
        chosen = generator(count, normals(angle))
        assert edge_variance(count, chosen, angle) < 0.2 * JITTER / count**1.5


def test_an_edge_along_the_diagonal_is_the_worst_case() -> None:
    """Exactly at 45 deg, of even counts, every lattice has the dual (N/2, N/2): N² falls from as much as jitter leaves."""
    for count in (64, 192):
        assert edge_variance(count, generator(count, normals(45.0)), 45.0) < 2 * 2 / (np.pi * count / np.sqrt(2)) ** 2


def test_the_choice_matters() -> None:
    """The worst generator for a slanted edge is a hundred times noisier than the chosen one."""
    count, angle = 128, 33.0
    chosen = edge_variance(count, generator(count, normals(angle)), angle, shifts=60)
    every = [edge_variance(count, g, angle, shifts=60) for g in range(1, count, 2)]
    assert max(every) > 100 * chosen


def test_halves_get_lattices_of_their_own() -> None:
    assert generator(64, normals(20.0), 0) != generator(64, normals(20.0), 1)


def test_few_rays_weigh_as_many() -> None:
    rng = np.random.default_rng(2)
    few, many = (lattice.weights(lattice.points(n, g, rng.random(2)), 0.55) for n, g in ((16, 5), (160, 37)))
    scaled = lattice.in_place_of(few, many)
    np.testing.assert_allclose(scaled.sum(axis=0), many.sum(axis=0), rtol=1e-5, atol=2e-6)
    assert few.sum() == pytest.approx(scaled.sum(), rel=1e-3)
