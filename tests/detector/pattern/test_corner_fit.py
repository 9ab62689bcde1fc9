"""The fit of homography and light, on images that the pattern's own model makes: what is put in comes out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from detector.pattern.corner_fit import LEVELS
from detector.pattern.corners import PatternFit, fit_pattern
from detector.pattern.pattern import Pattern, homography, kernel_sigma_px, project
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

PATTERN = Pattern(MarkerDesign())
SIGMA_PX = kernel_sigma_px(0.5)
CORNERS = np.array([[52.3, 50.1], [91.2, 54.8], [86.9, 93.4], [48.6, 88.2]])
SHAPE = (140, 140)
NOISE = NoiseModel(gain_dn_per_electron=0.0, read_noise_dn=20.0)
EVEN = {"white": 3000.0, "black": 150.0}
SLOPING = EVEN | {"white_x": 400.0, "white_y": -250.0, "black_x": 30.0, "black_y": 50.0}
CURVED = SLOPING | {"white_xx": -300.0, "white_xy": 150.0, "white_yy": 200.0}


def lit(light: dict[str, float]) -> FloatArray:
    """The pattern's image under a light, without noise [DN]."""
    column, row = np.meshgrid(np.arange(float(SHAPE[1])), np.arange(float(SHAPE[0])))
    pixels = np.stack([column, row], axis=-1).reshape(-1, 2)
    matrix = homography(CORNERS)
    value, _ = PATTERN.value_and_gradient(pixels, matrix, SIGMA_PX)
    x, y = project(np.linalg.inv(matrix), pixels).T
    white, black, white_x, white_y, black_x, black_y, white_xx, white_xy, white_yy = (light.get(k, 0.0) for k in LEVELS)
    amplitude = white + white_x * x + white_y * y + white_xx * x**2 + white_xy * x * y + white_yy * y**2
    return np.asarray(black + black_x * x + black_y * y + amplitude * value).reshape(SHAPE)


def fitted(image: FloatArray, noise: NoiseModel = NOISE) -> PatternFit:
    """The fit from corners that are half a pixel off and more."""
    start = CORNERS + 0.6 * np.array([[1, -1], [-1, -0.5], [0.5, 1], [1, 1]])
    fit = fit_pattern(image, PATTERN, start, SIGMA_PX, noise)
    assert fit is not None
    return fit


@pytest.mark.parametrize("light", [EVEN, SLOPING, CURVED], ids=["even", "sloping", "curved"])
def test_corners_and_light_that_made_an_image_are_found_in_it(light: dict[str, float]) -> None:
    fit = fitted(lit(light))
    assert fit.corners_px == pytest.approx(CORNERS, abs=0.01)
    assert fit.levels_dn == pytest.approx([light.get(key, 0.0) for key in LEVELS], abs=10.0)
    assert fit.reduced_chi2 < 0.01


def test_uneven_light_is_fitted_only_where_there_is_evidence_of_it() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(0, NOISE.read_noise_dn, SHAPE)
    assert np.all(fitted(lit(EVEN) + noise).levels_dn[2:] == 0)
    sloping = fitted(lit(SLOPING) + noise).levels_dn
    assert np.all(sloping[2:6] != 0)
    assert sloping[2:6] == pytest.approx([SLOPING[key] for key in LEVELS[2:6]], abs=60.0)


def test_the_covariance_is_the_scatter() -> None:
    """Over 80 draws eᵀ C⁻¹ e is chi-square: its sum lies within 99.9 %. The covariance is widened at times, never narrowed."""
    rng, draws, total = np.random.default_rng(2), 80, 0.0
    # So much noise that what the model of the blur leaves is small beside it.
    clean, noise = lit(EVEN), NoiseModel(gain_dn_per_electron=0.0, read_noise_dn=200.0)
    for _ in range(draws):
        fit = fitted(clean + rng.normal(0, noise.read_noise_dn, SHAPE), noise)
        error = (fit.corners_px - CORNERS).ravel()
        total += float(error @ np.linalg.solve(fit.covariance_px2, error))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 8 * draws)
    assert 0.9 * low < total < high


def test_clipped_light_still_leaves_the_corners_in_place() -> None:
    """A censored reading says only that the model should reach the ceiling."""
    noise = NoiseModel(gain_dn_per_electron=0.0, read_noise_dn=20.0, saturation_dn=2000.0)
    image = np.minimum(lit(EVEN) + np.random.default_rng(3).normal(0, 20.0, SHAPE), 2000.0)
    fit = fit_pattern(image, PATTERN, CORNERS + 0.4, SIGMA_PX, noise)
    assert fit is not None
    assert fit.corners_px == pytest.approx(CORNERS, abs=0.05)
    assert fit.white_dn > 2000.0


def test_corners_of_another_place_lead_to_no_fit_of_the_pattern() -> None:
    image = np.random.default_rng(4).normal(150.0, 20.0, SHAPE)
    fit = fit_pattern(image, PATTERN, CORNERS, SIGMA_PX, NOISE)
    assert fit is None or fit.unexplained > 0.5 or fit.significance < 12.0
