"""Bounds against what is known without them: derivatives by moving the scene, closed forms, an estimator that attains them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from detector.pose.bounds import Exposure, FineImage, bound, corner_bound, displacement, information
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

SAMPLES, SIGMA = 8, 0.5


def scene(x: FloatArray, y: FloatArray) -> FloatArray:
    """Smooth lights at places (x, y) that count from the frame's centre [px]."""
    spots = ((-4.0, 3.0, 1.5, 900.0), (5.0, -2.0, 2.0, 700.0), (1.0, 6.0, 1.0, 1200.0))
    return 50 + sum(a * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * s**2)) for u, v, s, a in spots)


def fine(moved: FloatArray | None = None) -> FineImage:
    """The scene on sub-pixels of a 32 × 28 frame, moved by coefficients of the eight motions."""
    empty = FineImage(np.zeros((28 * SAMPLES, 32 * SAMPLES)), SAMPLES, SIGMA)
    column, row = empty.places_px
    x, y = np.meshgrid(column - empty.centre_px[0], row - empty.centre_px[1])
    if moved is not None:
        points = np.stack([x.ravel(), y.ravel()], axis=-1)
        back = points - displacement(points) @ moved
        x, y = (back[:, k].reshape(x.shape) for k in range(2))
    return FineImage(scene(x, y), SAMPLES, SIGMA)


@pytest.mark.parametrize("motion", range(8))
def test_derivatives_are_those_of_moving_the_scene(motion: int) -> None:
    step = np.zeros(8)
    step[motion] = 1e-3 if motion < 2 else 1e-4 if motion < 6 else 1e-5
    moved = (fine(step).image() - fine(-step).image()) / (2 * step[motion])
    inner = (slice(4, -4), slice(4, -4))  # at the frame's edge the kernel ends
    expected = fine().motions()[motion][inner]
    assert np.abs(moved[inner] - expected).max() < 2e-3 * np.abs(expected).max()


def test_a_shifted_image_is_the_image_of_the_shifted_scene() -> None:
    step = np.array([0.3, -0.2, 0, 0, 0, 0, 0, 0])
    inner = (slice(4, -4), slice(4, -4))
    difference = fine().image((0.3, -0.2))[inner] - fine(step).image()[inner]
    assert np.abs(difference).max() < 1e-3 * np.ptp(fine().rate)


def test_bound_of_an_edges_place_is_the_closed_form() -> None:
    """A straight edge of height A over n rows, its place alone unknown: σ² / (n A² Σ k(x)²), k the blurred pixel."""
    column = fine().places_px[0]
    edge = FineImage(np.tile(np.where(column > 15.75, 1000.0, 0.0), (28 * SAMPLES, 1)), SAMPLES, SIGMA)
    derivative = edge.motions()[0][:, 4:-4].reshape(1, -1)
    found = bound(derivative, np.full(derivative.shape[1], 900.0), np.empty((0, derivative.shape[1])))
    x = np.arange(4, 28)[:, None] - 15.75 + np.linspace(-0.5, 0.5, 401)
    kernel = (np.exp(-0.5 * (x / SIGMA) ** 2) / (SIGMA * np.sqrt(2 * np.pi))).mean(axis=1)
    assert found[0, 0] == pytest.approx(900.0 / (28 * 1000.0**2 * (kernel**2).sum()), rel=5e-3)


def test_nuisance_never_lowers_a_bound_and_parallel_ones_are_refused() -> None:
    rng = np.random.default_rng(1)
    derivatives, nuisance, variance = rng.normal(size=(3, 200)), rng.normal(size=(2, 200)), rng.uniform(1, 3, 200)
    alone = bound(derivatives, variance, np.empty((0, 200)))
    with_nuisance = bound(derivatives, variance, nuisance)
    assert np.linalg.eigvalsh(with_nuisance - alone)[0] > -1e-15
    np.testing.assert_allclose(alone, np.linalg.inv(information(derivatives, variance)), rtol=1e-9)
    with pytest.raises(ValueError, match="tell the parameters apart"):
        bound(derivatives, variance, derivatives[:1] * 2)
    with pytest.raises(ValueError, match="leaves every pixel as it is"):
        bound(np.zeros((1, 200)), variance, nuisance)


def test_least_squares_on_noisy_frames_attains_the_bound() -> None:
    """Weighted least squares of the place of the scene, brightness and background: its covariance is the bound."""
    image = fine()
    exposure = Exposure(1.0, 20.0, 10.0)
    mean, derivatives = image.image(), image.motions()[:2].reshape(2, -1)
    nuisance = np.stack([mean.ravel(), np.ones(mean.size)])
    variance = exposure.variance(mean).ravel()
    expected = bound(derivatives, variance, nuisance)
    columns = np.concatenate([derivatives, nuisance])
    solve = np.linalg.solve((columns / variance) @ columns.T, columns / variance)
    rng, draws = np.random.default_rng(2), 400
    noise = (
        rng.poisson(mean.ravel() + 20.0, (draws, mean.size))
        - 20.0
        + rng.normal(0, 10.0, (draws, mean.size))
        - mean.ravel()
    )
    estimate = (noise @ solve.T)[:, :2]
    statistic = np.einsum("ni,ij,nj->", estimate, np.linalg.inv(expected), estimate)
    low, high = chi2.ppf([0.0005, 0.9995], 2 * draws)
    assert low < statistic < high


def test_a_brighter_marker_has_a_tighter_bound_and_its_corners_move_with_the_frame() -> None:
    """A flat print, 3 px a bit: four times the light halves the deviation where shot noise prevails."""
    marker = MarkerDesign()
    corners = np.array([[30.0, 30.0], [48.0, 30.0], [48.0, 48.0], [30.0, 48.0]])
    samples = 4
    empty = FineImage(np.zeros((80 * samples, 80 * samples)), samples, SIGMA)
    column, row = empty.places_px
    half = marker.aruco_m / 2
    x, y = np.meshgrid((column - 39) / 9 * half, (39 - row) / 9 * half)
    light = np.zeros_like(x)
    for x0, x1, y0, y1 in marker.reflective_rectangles_m():
        light[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = 1.0
    sigma = {}
    for level in (1e4, 4e4):
        frame = FineImage(light * level, samples, SIGMA)
        covariance = corner_bound(frame, marker, corners, Exposure(1.0, 0.0, 1.0))
        assert np.linalg.eigvalsh(covariance)[0] > 0
        sigma[level] = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(sigma[1e4] / sigma[4e4], 2.0, rtol=2e-2)
    shifted = corner_bound(FineImage(light * 1e4, samples, SIGMA), marker, corners, Exposure(1.0, 0.0, 1.0), (0.4, 0.1))
    np.testing.assert_allclose(np.sqrt(np.diag(shifted)).mean(), sigma[1e4].mean(), rtol=0.1)
