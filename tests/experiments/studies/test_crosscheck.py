"""Other people's code gives the same figures: Mitsuba's own integrator and film, colour-science, prysm."""

from __future__ import annotations

import numpy as np
import pytest

from detector.sensor.sensor import Sensor, presets
from experiments.scenario import Scenario, load_scenario
from experiments.studies.validate import crosscheck


def _near(size_px: int) -> Scenario:
    scenario = load_scenario(None, (f"camera.width_px={size_px}", f"camera.height_px={size_px}", "range_m=2.5"))
    return scenario.at(
        target=scenario.target.model_dump() | {"yaw_deg": 20.0, "pitch_deg": -15.0},
        sensor=presets()["icx429al"].sensor.model_dump(),
    )


def test_stock_mitsuba_with_specfilm_gives_our_electron_rates() -> None:
    checks = crosscheck.stock_transport(_near(80), samples=32, repeats=3)
    assert len(checks) == 6
    for check in checks:
        assert abs(check.difference) < 2e-3 + 4 * check.uncertainty, check


def test_colour_science_gives_our_spectral_integrals() -> None:
    for check in crosscheck.spectral_integrals(load_scenario()):
        assert abs(check.difference) < 1e-4, check


@pytest.mark.parametrize("sensor", [Sensor(), presets()["icx429al"].sensor], ids=["default", "icx429al"])
def test_prysm_gives_our_mean_and_variance(sensor: Sensor) -> None:
    pytest.importorskip("prysm")
    checks = crosscheck.prysm_electrons(sensor, np.array([2e4, 2e5, 1e6]), 1e-2, frames=500)
    assert len(checks) == 6
    for check in checks:  # six checks, each within 4 standard deviations: all pass with 0.9996
        assert abs(check.difference) < 4 * check.uncertainty, check


def test_nothing_faces_the_bits() -> None:
    gains = crosscheck.indirect_light(_near(112))
    assert all(gain == 0 for part, gain in gains.items() if not part.startswith("frame"))
    assert 0 < gains["frame, sun"] < 0.01


def test_agreement_is_judged_with_its_uncertainty() -> None:
    assert crosscheck.Agreement("a", "b", 1.0009, 1.0).agrees
    assert not crosscheck.Agreement("a", "b", 1.002, 1.0).agrees
    assert crosscheck.Agreement("a", "b", 1.002, 1.0, 5e-4).agrees
