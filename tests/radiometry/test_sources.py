"""The Sun's band integrals and the LED ring's energy, held to published figures and to integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.integrate import quad

from radiometry.link import frames_per_second
from radiometry.sources import Earth, LedRing, Sun, am0_spectrum
from radiometry.spectrum import constant


@pytest.mark.parametrize(
    ("low_nm", "high_nm", "printed", "half_a_digit"),
    [(800, 900, 101.3, 0.05), (825, 875, 50.26, 0.005), (715, 900, 208, 0.5), (715, 1000, 290, 0.5)],
)
def test_am0_band_integrals(low_nm: float, high_nm: float, printed: float, half_a_digit: float) -> None:
    """Integrals of ASTM G173's extraterrestrial column, to the digits that were printed elsewhere."""
    assert (am0_spectrum() * constant(1.0, low_nm, high_nm)).integral() == pytest.approx(printed, abs=half_a_digit)


def test_sunlight_falls_with_the_square_of_the_distance_and_the_disc_with_the_distance() -> None:
    near, far = Sun(), Sun(distance_au=2.0)
    assert far.irradiance().integral() == pytest.approx(near.irradiance().integral() / 4, rel=1e-14)
    assert far.angular_radius_rad == pytest.approx(near.angular_radius_rad / 2, rel=1e-14)
    assert np.degrees(near.angular_radius_rad) == pytest.approx(0.2665, abs=0.00005)


@pytest.mark.parametrize("field", ["phase_deg", "azimuth_deg", "distance_au"])
def test_a_sun_that_is_nowhere_is_refused(field: str) -> None:
    for value in (np.nan, np.inf, -np.inf, -400.0):
        with pytest.raises(ValidationError, match=field):
            Sun(**{field: value})


@settings(deadline=None, derandomize=True)
@given(st.floats(1, 80), st.floats(0.01, 3))
def test_the_pattern_integrates_to_the_optical_power(half_angle_deg: float, intensity: float) -> None:
    led = LedRing(intensity_w_sr=intensity, half_angle_deg=half_angle_deg, electrical_power_w=100)
    # Beyond the seventh half angle less than 2^-49 of the axis's intensity is left.
    edge = min(np.radians(7 * half_angle_deg), np.pi / 2)
    power, error = quad(
        lambda t: 2 * np.pi * np.sin(t) * intensity * float(led.pattern(np.cos(t))), 0, edge, epsrel=1e-10
    )
    assert led.optical_power_w == pytest.approx(power, abs=error + 1e-12)
    assert led.pattern(np.cos(np.radians(half_angle_deg))) == pytest.approx(0.5, rel=1e-9)


def test_nothing_is_radiated_backwards() -> None:
    assert not np.any(LedRing().pattern([-1.0, -0.5, -1e-9]))


def test_the_thesiss_array_of_40_kw_per_sr_from_210_w_is_refused_with_the_arithmetic() -> None:
    """One lamp of the whole array's intensity and power; a full cone of 16° is a half angle of 8°."""
    with pytest.raises(ValidationError) as refusal:
        LedRing(count=1, intensity_w_sr=40_247, half_angle_deg=8, electrical_power_w=210)
    exponent = np.log(0.5) / np.log(np.cos(np.radians(8)))
    power = 2 * np.pi * 40_247 / (exponent + 1)
    message = str(refusal.value)
    for figure in (
        "40247 W/sr",
        "half angle of 8 deg",
        "2π·I₀/(n+1)",
        f"{power:.3g} W of light",
        f"n = {exponent:.1f}",
        "210 W × 1 = 210 W",
        f"{power / 210:.1f} times too much",
    ):
        assert figure in message
    # The same figure spread over its hundred LEDs is refused for each of them.
    with pytest.raises(ValidationError, match=r"from one LED that is given 2\.1 W"):
        LedRing(count=100, intensity_w_sr=402.47, half_angle_deg=8, electrical_power_w=2.1)


def test_the_leds_as_bought_conserve_energy() -> None:
    """3.5 W/sr within ±12° is 0.68 W of light, 32 % of 2.1 W (audit of the thesis, 1.2, row 22)."""
    led = LedRing()
    assert led.optical_power_w == pytest.approx(0.68, abs=0.005)
    assert led.optical_power_w / led.electrical_power_w == pytest.approx(0.32, abs=0.005)


def test_the_wall_plug_limit_tightens_the_refusal() -> None:
    efficiency = LedRing().optical_power_w / LedRing().electrical_power_w
    LedRing(wall_plug_limit=efficiency * 1.001)
    with pytest.raises(ValidationError, match="times too much"):
        LedRing(wall_plug_limit=efficiency * 0.999)


@pytest.mark.parametrize("count", [1, 2, 3, 24, 100])
def test_leds_stand_evenly_on_a_ring_in_the_plane_of_the_lens(count: int) -> None:
    ring = LedRing(count=count, ring_radius_m=0.04)
    place = ring.positions_m()
    assert place.shape == (count, 3)
    np.testing.assert_allclose(place[0], [0.04, 0, 0], atol=1e-16)
    np.testing.assert_allclose(np.hypot(place[:, 0], place[:, 1]), 0.04, rtol=1e-14)
    assert not np.any(place[:, 2])
    gaps = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1)
    np.testing.assert_allclose(gaps, 2 * 0.04 * np.sin(np.pi / count), atol=1e-16)


def test_ring_intensity_and_energy_count_every_led() -> None:
    ring = LedRing(count=7)
    assert ring.spectral_intensity().integral() == pytest.approx(7 * ring.intensity_w_sr, rel=1e-13)
    # Thesis section 6.4: 210 W for 1/50 s is 4.2 J.
    assert LedRing().energy_per_frame_j(1 / 50) == pytest.approx(4.2, rel=1e-14)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("count", 0),
        ("half_angle_deg", 0),
        ("half_angle_deg", 90),
        ("intensity_w_sr", np.nan),
        ("ring_radius_m", 0),
        ("fwhm_nm", 0),
        ("centroid_nm", 0.85),
        ("wall_plug_limit", 1.1),
    ],
)
def test_a_ring_that_cannot_be_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        LedRing(**{field: value})


def test_pulses_are_bounded_in_length_and_duty() -> None:
    ring = LedRing(longest_pulse_s=1e-3, duty_max=0.1)
    assert ring.pulse_allowed(1e-3)
    assert not ring.pulse_allowed(1.01e-3)
    np.testing.assert_array_equal(ring.pulse_allowed(1e-3, [10.0, 100.0, 101.0]), [True, True, False])
    assert ring.pulse_allowed(5e-4, frames_per_second(np.inf, 1.0, 5e-4, ring.duty_max))
    assert LedRing().pulse_allowed(100.0, 0.01)  # no limit unless one is given


def test_the_earth_is_as_bright_as_a_sunlit_lambert_surface() -> None:
    radiance = Earth(albedo=0.3).radiance(Sun(distance_au=2.0))
    assert float(radiance(850.0)) == pytest.approx(0.3 / np.pi * float(am0_spectrum()(850.0)) / 4)
