"""Veiling glare and stray light: what they keep, and what they come to in electrons."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from radiometry.optics import Camera
from radiometry.spectrum import constant
from radiometry.stray import add_veiling_glare, point_source_transmittance, stray_rate


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.floats(0, 1), st.integers(0, 1000))
def test_veiling_glare_moves_light_and_keeps_it(glare: float, seed: int) -> None:
    rate = np.random.default_rng(seed).exponential(1e6, (12, 16))
    spread = add_veiling_glare(rate, glare)
    assert spread.sum() == pytest.approx(rate.sum(), rel=1e-12)
    assert np.ptp(spread) == pytest.approx((1 - glare) * np.ptp(rate), rel=1e-9, abs=1e-6)
    np.testing.assert_allclose(add_veiling_glare(rate[3, 4], glare, float(rate.mean())), spread[3, 4])


def test_point_source_transmittance_is_log_linear_and_ends_with_its_table() -> None:
    camera = Camera(point_source_transmittance=((20.0, 1e-4), (40.0, 1e-6), (60.0, 1e-7)))
    at = point_source_transmittance(camera, np.radians([0.0, 20.0, 30.0, 50.0, 60.0, 61.0, 180.0]))
    np.testing.assert_allclose(at, [1e-4, 1e-4, 1e-5, 10**-6.5, 1e-7, 0, 0], rtol=1e-9)
    assert point_source_transmittance(Camera(), 0.5) == 0


@pytest.mark.parametrize(
    "table", [((20.0, 1e-4),), ((20.0, 1e-4), (10.0, 1e-5)), ((20.0, 0.0), (30.0, 1e-5)), ((20.0, 1.0), (200.0, 1e-5))]
)
def test_a_stray_light_table_that_makes_no_sense_is_refused(table: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValidationError, match="expected two or more rows"):
        Camera(point_source_transmittance=table)


def test_stray_light_is_irradiance_times_transmittance_on_a_pixel() -> None:
    """2 W m⁻² nm⁻¹ over 800–802 nm (4 W/m²) at a PST of 1e-5 on (5 µm)², in photons of 801 nm at a QE of 0.5."""
    camera = Camera(pixel_pitch_x_m=5e-6, pixel_pitch_y_m=5e-6, point_source_transmittance=((10.0, 1e-5), (90.0, 1e-5)))
    rate = stray_rate(camera, 0.5, constant(2.0), constant(1.0, 800.0, 802.0), constant(0.5))
    photon_j = 6.62607015e-34 * 299792458 / 801e-9
    assert rate == pytest.approx(4 * 1e-5 * 25e-12 * 0.5 / photon_j, rel=1e-9)
