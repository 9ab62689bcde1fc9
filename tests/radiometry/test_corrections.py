"""The thesis's link model corrected step by step, against the listing at one end and independent closed forms at the other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import constants

from radiometry import link
from radiometry.corrections import (
    CORRECTIONS,
    LED,
    NOISE_IN_QUADRATURE,
    SHEETING_BRDF_SR,
    SUN,
    beam_power_w,
    corrected,
    printed_model,
    waterfall,
)
from radiometry.optics import Camera, electrons_per_joule, etendue_m2_sr
from radiometry.sources import LedRing
from radiometry.thesis import PrintedModel

RANGES = np.arange(1.0, 21.0)
CASES = [((LED,), 1 / 30, False), ((LED, SUN), 1e-3, True)]


@pytest.mark.parametrize("cone_deg", [16.0, 8.0])
@pytest.mark.parametrize(("sources", "exposure_s", "sun"), CASES)
def test_uncorrected_model_is_the_listing(
    sources: tuple[str, ...], exposure_s: float, sun: bool, cone_deg: float
) -> None:
    printed = PrintedModel(light_cone_deg=cone_deg)
    model = printed_model(printed)
    assert model.signal_e(RANGES, exposure_s, sources) == pytest.approx(
        printed.signal_e(RANGES, exposure_s, sun=sun), rel=1e-14
    )
    assert model.snr(RANGES, exposure_s, sources) == pytest.approx(printed.snr(RANGES, exposure_s, sun=sun), rel=1e-14)


@pytest.mark.parametrize("cone_deg", [16.0, 8.0])
def test_corrected_model_is_the_camera_equation(cone_deg: float) -> None:
    """By `link.ring_transport` and `optics.etendue_m2_sr`, which share no code with the corrections."""
    camera = Camera(pixel_pitch_x_m=8.6e-6, pixel_pitch_y_m=8.6e-6, focal_length_m=20.19e-3, f_number=2.8)
    # Light of 100 emitters of 3.5 W/sr in a cone of 24°, spread evenly over the beam.
    intensity = 350 * (1 - np.cos(np.radians(12))) / (1 - np.cos(np.radians(cone_deg / 2)))
    model = corrected(printed_model(PrintedModel(light_cone_deg=cone_deg)), CORRECTIONS)
    band = 101.307  # ASTM G173-03, 800–900 nm

    def flat(normal: np.ndarray, to_source: np.ndarray, to_viewer: np.ndarray, wavelength: np.ndarray) -> np.ndarray:
        return np.full(np.broadcast_shapes(to_source.shape[:-1], np.shape(wavelength)), 200.0)

    per_radiance = etendue_m2_sr(camera) * electrons_per_joule(850.0) * 0.35 * 0.35
    for range_m in RANGES:
        viewer = np.array([0.0, 0.0, range_m])
        led = (
            link.ring_transport(
                np.zeros(3), viewer, viewer[None], axis=[0, 0, -1], ring=LedRing(), brdf=flat, wavelength_nm=[850.0]
            )[0]
            * intensity
        )
        fill = min(1.0, 0.005 * camera.focal_px[0] / range_m * 0.005 * camera.focal_px[1] / range_m)
        for sources, radiance in (((LED,), led), ((SUN,), band * 0.10), ((LED, SUN), led + band * 0.10)):
            signal = per_radiance * radiance * fill * 1e-3
            assert model.signal_e(range_m, 1e-3, sources) == pytest.approx(signal, rel=1e-12)
            assert model.snr(range_m, 1e-3, sources) == pytest.approx(signal / np.sqrt(signal + 28.2**2), rel=1e-12)


def test_corrected_model_is_the_flux_through_the_lens() -> None:
    """The other way round: power of the bit into the aperture, over the pixels of its image."""
    model = corrected(printed_model(), CORRECTIONS)
    radiance = model.intensity_w_sr / RANGES**2 * 200
    aperture_sr = np.pi * (20.19e-3 / 2.8 / 2) ** 2 / RANGES**2
    pixels = (0.005 * 20.19e-3 / 8.6e-6 / RANGES) ** 2
    photons = radiance * 0.005**2 * aperture_sr / np.maximum(pixels, 1) * 850e-9 / (constants.h * constants.c)
    assert model.signal_e(RANGES, 1 / 30, (LED,)) == pytest.approx(photons * 0.35 * 0.35 / 30, rel=1e-12)


def test_corrections_multiply_to_the_published_errors() -> None:
    start, end = printed_model(), corrected(printed_model(), CORRECTIONS)
    near, far = 8.0, 20.0

    def ratio(range_m: float, source: str) -> float:
        return float(end.signal_e(range_m, 1e-3, (source,)) / start.signal_e(range_m, 1e-3, (source,)))

    assert ratio(near, LED) == pytest.approx(3.47e6, rel=0.005)
    assert ratio(far, LED) == pytest.approx(1.20e6, rel=0.005)
    assert ratio(near, SUN) == pytest.approx(2.25, abs=0.005)
    # A pixel of 0.34 bit: 0.776 of the printed signal; with a black of 1 % around the bit, as an independent audit has it, 0.82.
    assert ratio(far, SUN) == pytest.approx(0.776, abs=0.001)
    with_black = replace(end, sun_brdf_dark=lambda s, r: np.full_like(r, 0.01 / np.pi))
    signal = with_black.signal_e(far, 1e-3, (SUN,)) / start.signal_e(far, 1e-3, (SUN,))
    assert float(signal) == pytest.approx(0.82, abs=0.005)


def test_single_factors_are_what_their_formulas_say() -> None:
    factors = {
        s.correction.name: float(s.signal_factor) for s in waterfall(printed_model(), CORRECTIONS, 20.0, 1 / 30, (LED,))
    }
    assert factors["degrees taken for radians"] == pytest.approx((np.arctan(np.radians(12)) / np.arctan(12)) ** 2)
    assert factors["flux for irradiance"] == pytest.approx(1 / 0.005**2)
    assert factors["diameter for radius"] == pytest.approx(0.25)
    assert factors["second pixel area, in mm²"] == pytest.approx(1 / 8.6e-3**2)
    assert factors["field of view of 16°"] == pytest.approx(1.316, abs=5e-4)
    assert factors["bits smaller than a pixel"] == pytest.approx(0.344, abs=5e-4)
    assert [factors[n] for n in ("retro peak for the Sun", "solar band", "noise added linearly")] == [1, 1, 1]
    by_sun = {
        s.correction.name: float(s.signal_factor) for s in waterfall(printed_model(), CORRECTIONS, 20.0, 1e-3, (SUN,))
    }
    assert by_sun["retro peak for the Sun"] == pytest.approx(SHEETING_BRDF_SR / 200)
    assert by_sun["solar band"] == pytest.approx(1.013, abs=5e-4)


@given(st.permutations(CORRECTIONS), st.floats(0.5, 40))
@settings(deadline=None, derandomize=True, max_examples=30)
def test_order_changes_single_factors_but_not_the_end(order: list, range_m: float) -> None:
    steps = waterfall(printed_model(), order, range_m, 1e-3, (LED, SUN))
    end = corrected(printed_model(), CORRECTIONS)
    assert steps[-1].signal_e == pytest.approx(end.signal_e(range_m, 1e-3, (LED, SUN)), rel=1e-12)
    product = np.prod([s.snr_factor for s in steps]) * printed_model().snr(range_m, 1e-3, (LED, SUN))
    assert float(product) == pytest.approx(float(end.snr(range_m, 1e-3, (LED, SUN))), rel=1e-12)


@given(st.floats(1e-3, 1e9))
@settings(deadline=None, derandomize=True)
def test_noise_in_quadrature_gains_at_most_the_root_of_two(signal_e: float) -> None:
    charge, none = np.array(signal_e), np.array(0.0)
    gain = NOISE_IN_QUADRATURE(printed_model()).merit(charge, none, 28.2) / printed_model().merit(charge, none, 28.2)
    assert 1 <= gain <= np.sqrt(2) * (1 + 1e-12)


@pytest.mark.parametrize(("cone_deg", "printed", "right"), [(16.0, 40_247, 785.9), (8.0, 159_443, 3139.8)])
def test_intensity(cone_deg: float, printed: float, right: float) -> None:
    model = printed_model(PrintedModel(light_cone_deg=cone_deg))
    assert model.intensity_w_sr == pytest.approx(printed, rel=2e-5)
    assert corrected(model, CORRECTIONS).intensity_w_sr == pytest.approx(right, rel=2e-5)


def test_corrected_beam_holds_the_light_of_the_leds_whatever_its_width() -> None:
    for cone_deg in (4.0, 8.0, 16.0, 24.0, 40.0):
        model = corrected(printed_model(PrintedModel(light_cone_deg=cone_deg)), CORRECTIONS)
        assert beam_power_w(model.intensity_w_sr, cone_deg) == pytest.approx(beam_power_w(350.0, 24.0), rel=1e-12)


def test_printed_intensity_breaks_conservation_of_energy_and_is_refused() -> None:
    printed = printed_model().intensity_w_sr
    assert beam_power_w(printed, 16.0) / 210 == pytest.approx(11.7, abs=0.05)
    with pytest.raises(ValidationError, match=r"16\.8 times too much"):
        LedRing(intensity_w_sr=printed / 100, half_angle_deg=8.0)
