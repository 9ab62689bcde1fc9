"""Power, junction temperature and motion between frames, against equation 6.10, an integrated pulse train and drawn attitudes."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from radiometry.optics import Camera
from radiometry.power import PowerPlan, junction_rise_k, longest_pulse_s, swing_px, turn_rate_deviation
from radiometry.sources import LedRing

ALONE = PowerPlan(driver_efficiency=1.0, camera_w=0.0, frame_rate_max=1e9, latency_s=0.0)


def test_equation_6_10_without_losses() -> None:
    """210 W for 1/50 s is 4.2 J: 5 W flash 1.19 times a second; the thesis prints 1.2."""
    assert float(ALONE.frame_rate(LedRing(), 1 / 50)) == pytest.approx(5 / 4.2)


def test_driver_camera_readout_and_processor_bind_in_turn() -> None:
    leds = LedRing(count=10)
    assert float(PowerPlan(driver_efficiency=0.5, camera_w=3.0).frame_rate_by_power(leds, 0.01)) == pytest.approx(
        1 / 0.21
    )
    assert float(PowerPlan(frame_rate_max=3.0).frame_rate(leds, 1e-6)) == 3.0
    assert float(PowerPlan(frame_rate_max=300.0, latency_s=0.02).frame_rate(leds, 1e-6)) == pytest.approx(50.0)
    assert float(ALONE.frame_rate(LedRing(duty_max=0.1, count=1), 1.0)) == pytest.approx(0.1)


def test_a_camera_that_takes_all_the_power_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"camera_w: 5 W leaves nothing of limit_w, 5 W"):
        PowerPlan(camera_w=5.0)


@pytest.mark.parametrize(("pulse", "period"), [(1e-3, 5e-3), (8e-3, 10e-3), (2e-5, 1e-2)])
def test_junction_follows_a_train_of_pulses(pulse: float, period: float) -> None:
    """The node's differential equation, C dT/dt = P − T/R, integrated over pulses until it repeats."""
    heat, resistance, capacity = 1.4, 25.0, 3e-4
    rise, highest, steps = 0.0, 0.0, 200
    for _ in range(int(8 * resistance * capacity / period) + 3):
        for power, seconds in ((heat, pulse), (0.0, period - pulse)):
            for _ in range(steps):
                middle = rise + (power - rise / resistance) / capacity * seconds / steps / 2
                rise += (power - middle / resistance) / capacity * seconds / steps
            highest = rise if power else highest
    assert float(junction_rise_k(heat, resistance, capacity, pulse, period)) == pytest.approx(highest, rel=1e-3)


def test_junction_in_the_limits_of_short_and_long_pulses() -> None:
    assert float(junction_rise_k(2.0, 10.0, 1e-3, 1e-6)) == pytest.approx(2.0 * 1e-6 / 1e-3, rel=1e-3)
    assert float(junction_rise_k(2.0, 10.0, 1e-3, 1.0)) == pytest.approx(20.0)
    assert float(junction_rise_k(2.0, 10.0, 1e-3, 1.0, 1.0)) == pytest.approx(20.0)
    with pytest.raises(ValueError, match=r"period_s: 0\.5 s, expected at least pulse_s, 1 s"):
        junction_rise_k(1.0, 1.0, 1.0, 1.0, 0.5)


def test_longest_pulse_heats_just_as_much_as_is_allowed() -> None:
    seconds = longest_pulse_s(2.0, 25.0, 3e-4, 30.0)
    assert float(junction_rise_k(2.0, 25.0, 3e-4, seconds)) == pytest.approx(30.0)
    assert longest_pulse_s(1.0, 25.0, 3e-4, 30.0) == np.inf


def test_swing_is_the_projected_chord() -> None:
    camera, lever, turn = Camera(), 0.57, np.radians(4.2)
    ends = lever * np.array([[np.sin(-turn / 2), 0, 0], [np.sin(turn / 2), 0, 0]]) + [0, 0, 8.0]
    image = camera.project(ends)
    assert float(swing_px(camera.focal_px[0], lever, 8.0, turn)) == pytest.approx(image[1, 0] - image[0, 0], rel=1e-6)


@pytest.mark.parametrize("rate", [1.19, 7.18, 30.0])
def test_turn_rate_deviation_is_that_of_fitted_slopes(rate: float) -> None:
    sigma, seconds, runs = np.radians(0.2), 4.0, 4000
    time = np.arange(int(rate * seconds) + 1) / rate
    drawn = np.random.default_rng(5).normal(0, sigma, (runs, len(time)))
    slopes = np.polyfit(time, drawn.T, 1)[0]
    expected = float(turn_rate_deviation(sigma, rate, seconds))
    # The deviation of a normal sample has a relative standard error of 1/√(2n); four of them.
    assert slopes.std() == pytest.approx(expected, rel=4 / np.sqrt(2 * runs))


def test_one_frame_tells_no_rate() -> None:
    assert float(turn_rate_deviation(0.01, 0.2, 4.0)) == np.inf
