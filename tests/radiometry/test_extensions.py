"""What is added to the thesis's link model: every step against the factor that its formula gives."""

from __future__ import annotations

import numpy as np
import pytest

from radiometry import link
from radiometry.corrections import CORRECTIONS, LED, SUN, LinkModel, Step, corrected, printed_model, waterfall
from radiometry.extensions import BEAM_OPTICS_EFFICIENCY, Surroundings, extensions
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from radiometry.sources import LedRing

RANGES = np.array([2.0, 8.0, 20.0])
PHASE = np.radians(40.0)
RING = LedRing(ring_radius_m=0.05, half_angle_deg=8.0, intensity_w_sr=1.0)
TAPE_SR, ABSORBER_SR, FILL, DARK_FILL = 0.3, 0.02, 0.7, 0.1


def flat(value: float) -> link.Brdf:
    """A reflectance that depends on nothing."""

    def brdf(normal: FloatArray, to_source: FloatArray, to_viewer: FloatArray, wavelength: FloatArray) -> FloatArray:
        return np.full(np.shape(to_source)[:-1], value)

    return brdf


SURROUNDINGS = Surroundings(
    ring=RING,
    camera=Camera(),
    tape=flat(TAPE_SR),
    absorber=flat(ABSORBER_SR),
    sun_phase_rad=float(PHASE),
    bright_fill=lambda r: np.full_like(r, FILL),
    dark_fill=lambda r: np.full_like(r, DARK_FILL),
)


def steps(source: str) -> dict[str, Step]:
    start = corrected(printed_model(), CORRECTIONS)
    made = waterfall(start, extensions(SURROUNDINGS), RANGES, 1e-3, (source,))
    return {step.correction.name: step for step in made}


def full_model() -> LinkModel:
    return corrected(corrected(printed_model(), CORRECTIONS), extensions(SURROUNDINGS))


def test_beam_optics_take_their_loss_from_the_leds_alone() -> None:
    np.testing.assert_allclose(steps(LED)["beam optics"].signal_factor, BEAM_OPTICS_EFFICIENCY)
    np.testing.assert_allclose(steps(SUN)["beam optics"].signal_factor, 1.0)


def test_the_ring_stands_beside_the_lens() -> None:
    """E = I cosⁿα cosα / (R² + b²), which is I cosⁿ⁺³α / R²."""
    cosine = np.cos(np.arctan(RING.ring_radius_m / RANGES))
    np.testing.assert_allclose(steps(LED)["ring of LEDs"].signal_factor, cosine ** (RING.exponent + 3), rtol=1e-12)


def test_the_lobe_replaces_the_flat_tape() -> None:
    np.testing.assert_allclose(steps(LED)["lobe of the tape"].signal_factor, TAPE_SR / 200.0)


def test_a_slanting_sun_lights_by_its_cosine() -> None:
    np.testing.assert_allclose(steps(SUN)["slanting Sun"].signal_factor, np.cos(PHASE))
    np.testing.assert_allclose(steps(LED)["slanting Sun"].signal_factor, 1.0)


def test_oblong_pixels_share_the_bits_light_by_their_area() -> None:
    """Where a bit covers more than a pixel, the light of one goes with its area."""
    near = steps(SUN)["oblong pixels"].signal_factor[0]
    assert near == pytest.approx(8.3 / 8.6, rel=1e-12)


def test_the_background_turns_snr_into_cnr() -> None:
    model = full_model()
    signal, background = (f(RANGES, 1e-3, (LED, SUN)) for f in (model.signal_e, model.background_e))
    mixed = [fill * TAPE_SR + (1 - fill) * ABSORBER_SR for fill in (FILL, DARK_FILL)]
    np.testing.assert_allclose(signal / background, mixed[0] / mixed[1], rtol=1e-12)
    expected = link.cnr(signal, background, 0.0, model.settings.dark_noise_e)
    np.testing.assert_allclose(model.snr(RANGES, 1e-3, (LED, SUN)), expected, rtol=1e-12)
