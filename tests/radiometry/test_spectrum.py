"""Spectra as functions: a product, an integral and a value mean what they say on any grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from radiometry.spectrum import Spectrum, constant, gaussian_line


@st.composite
def spectra(draw: st.DrawFn) -> Spectrum:
    """Up to eight knots on a grid of quarter nanometres, values of either sign."""
    knots = draw(st.lists(st.integers(1200, 4800), min_size=2, max_size=8, unique=True))
    values = draw(st.lists(st.floats(-1e3, 1e3), min_size=len(knots), max_size=len(knots)))
    return Spectrum(np.sort(knots) / 4, np.array(values))


@settings(deadline=None, derandomize=True)
@given(spectra(), spectra())
def test_products_commute_to_the_last_bit(a: Spectrum, b: Spectrum) -> None:
    left, right = a * b, b * a
    assert np.array_equal(left.wavelength_nm, right.wavelength_nm)
    assert np.array_equal(left.values, right.values)


@settings(deadline=None, derandomize=True)
@given(spectra(), spectra())
def test_a_product_is_exact_at_every_knot_of_either_factor(a: Spectrum, b: Spectrum) -> None:
    low = max(a.wavelength_nm[0], b.wavelength_nm[0])
    high = min(a.wavelength_nm[-1], b.wavelength_nm[-1])
    assume(low < high)
    knots = np.union1d(a.wavelength_nm, b.wavelength_nm)
    inside = knots[(knots >= low) & (knots <= high)]
    assert np.array_equal((a * b)(inside), a(inside) * b(inside))
    outside = knots[(knots < low) | (knots > high)]
    assert not np.any((a * b)(outside))


@settings(deadline=None, derandomize=True)
@given(spectra(), st.floats(-1e3, 1e3))
def test_scaling_scales_the_integral(a: Spectrum, factor: float) -> None:
    scale = np.sum(np.abs(a.values)) * np.ptp(a.wavelength_nm) * abs(factor)
    assert (factor * a).integral() == pytest.approx(factor * a.integral(), abs=1e-13 * scale)
    assert np.array_equal((factor * a).values, (a * factor).values)


@settings(deadline=None, derandomize=True)
@given(spectra(), st.floats(0.5, 300))
def test_resampling_changes_the_grid_and_not_the_function(a: Spectrum, step_nm: float) -> None:
    fine = a.resampled(step_nm)
    assert np.isin(a.wavelength_nm, fine.wavelength_nm).all()
    assert np.diff(fine.wavelength_nm).max() <= step_nm * (1 + 1e-12)
    # The grid points carry rounding errors of 1e-13 nm, which steep edges turn into errors of value.
    steepest = np.max(np.abs(np.diff(a.values)) / np.diff(a.wavelength_nm))
    probe = np.linspace(a.wavelength_nm[0], a.wavelength_nm[-1], 101)
    np.testing.assert_allclose(fine(probe), a(probe), atol=1e-12 * (steepest + np.abs(a.values).max() + 1))
    scale = np.sum(np.abs(a.values)) * np.ptp(a.wavelength_nm)
    assert fine.integral() == pytest.approx(a.integral(), abs=1e-11 * scale + 1e-200)


def test_a_spectrum_is_zero_outside_its_samples() -> None:
    triangle = Spectrum([800, 850, 900], [1.0, 2.0, 1.0])
    assert triangle([799.999, 800, 825, 900, 900.001]) == pytest.approx([0, 1, 1.5, 1, 0], abs=0)


def test_spectra_without_common_support_multiply_to_zero() -> None:
    product = constant(1.0, 400, 500) * constant(1.0, 800, 900)
    assert product.integral() == 0
    assert not np.any(product([450, 650, 850]))


def test_a_spectrum_cannot_be_changed_through_its_arrays() -> None:
    source = np.array([1.0, 2.0])
    spectrum = Spectrum(np.array([800.0, 900.0]), source)
    source[0] = 5.0
    assert spectrum(800.0) == 1.0
    with pytest.raises(ValueError, match="read-only"):
        spectrum.values[0] = 3.0


@pytest.mark.parametrize(
    ("wavelength", "values", "message"),
    [
        ([800], [1], "at least 2"),
        ([800, 900], [1, 2, 3], r"\(2,\) and values \(3,\)"),
        ([[800, 900]], [[1, 2]], "1-D"),
        ([900, 800], [1, 2], "increase strictly"),
        ([800, 800], [1, 2], "increase strictly"),
        ([800, np.nan], [1, 2], "finite"),
        ([800, 900], [1, np.inf], "finite"),
    ],
)
def test_what_is_no_spectrum_is_refused(wavelength: list[float], values: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Spectrum(np.array(wavelength, float), np.array(values, float))


@pytest.mark.parametrize(
    ("values", "support"),
    [
        ([0, 0, 1, 0, 0], (820, 840)),
        ([1, 0, 0, 0, 0], (810, 820)),
        ([0, 1, 0, 1, 0], (810, 850)),
        ([0, 0, 0, 0, 2], (840, 850)),
        ([0, 0, 0, 0, 0], (810, 850)),
    ],
)
def test_support_ends_where_the_function_reaches_zero(values: list[float], support: tuple[float, float]) -> None:
    assert Spectrum(np.arange(810.0, 851.0, 10.0), np.array(values, float)).support_nm == support


@settings(deadline=None, derandomize=True)
@given(st.floats(400, 1000), st.floats(0.5, 60))
def test_a_line_has_unit_area_and_the_stated_width(centre: float, fwhm: float) -> None:
    line = gaussian_line(centre, fwhm)
    assert line.integral() == pytest.approx(1, abs=1e-13)
    # Linear interpolation between samples σ/20 apart errs by (1/20)²/8 of the curvature, less than 1/σ² of the peak;
    # the ends at ±5σ and the normalisation add less than 4e-6.
    assert line(centre + fwhm / 2) / line(centre) == pytest.approx(0.5, abs=(1 / 20) ** 2 / 8)
    mean = Spectrum(line.wavelength_nm, line.values * (line.wavelength_nm - centre)).integral()
    assert mean == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("centre", "fwhm"), [(850, 0), (850, -1), (0, 30), (850, np.nan), (np.nan, 30)])
def test_a_line_without_width_is_refused(centre: float, fwhm: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        gaussian_line(centre, fwhm)


@settings(deadline=None, derandomize=True)
@given(spectra())
def test_the_integral_is_that_of_the_piecewise_linear_function(a: Spectrum) -> None:
    expected = sum(quad(a, low, high)[0] for low, high in zip(a.wavelength_nm[:-1], a.wavelength_nm[1:], strict=True))
    scale = np.sum(np.abs(a.values)) * np.ptp(a.wavelength_nm)
    assert a.integral() == pytest.approx(expected, abs=1e-12 * scale + 1e-200)
