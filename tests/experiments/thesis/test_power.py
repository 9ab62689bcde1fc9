"""The power study: its statements, tables and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.scenario import load_scenario
from experiments.thesis.power.emitters import BOARD_C, emitters
from experiments.thesis.power.plan import QUICK
from experiments.thesis.power.study import PowerResult, run
from experiments.thesis.power.tables import claims
from radiometry.power import PowerPlan


@pytest.fixture(scope="module")
def result() -> PowerResult:
    return run(load_scenario(), QUICK)


@pytest.fixture(scope="module")
def dataset(result: PowerResult) -> xr.Dataset:
    return result.dataset


def test_a_frames_energy_does_not_depend_on_how_many_leds_share_it(dataset: xr.Dataset) -> None:
    """Half the LEDs shine twice as long; only where the pulse meets its limits does the energy change."""
    free = (dataset.exposure_s > 1.01e-7) & (dataset.exposure_s < 0.033)
    eclipse = dataset.energy_j.where(free).sel(illumination="eclipse")
    ratio = eclipse.sel(leds=10) / eclipse.sel(leds=100)
    assert ratio.count() >= 3
    assert ratio.values[np.isfinite(ratio.values)] == pytest.approx(1, rel=0.02)


def test_rates_are_ordered_and_power_is_kept(dataset: xr.Dataset) -> None:
    assert (dataset.rate <= dataset.rate_power * (1 + 1e-9)).all()
    assert (dataset.rate_power <= dataset.rate_light).all()
    assert (dataset.rate_power < dataset.rate_light).sel(leds=100).all()
    assert (dataset.power_w <= PowerPlan().limit_w * (1 + 1e-9)).all()
    assert dataset.turn_deg.values == pytest.approx(5.0 / dataset.rate.values)


def test_the_thesiss_rate_is_reproduced_and_superseded(result: PowerResult) -> None:
    said = claims(result)
    first, needed = said[0], said[1]
    assert first.agrees
    assert first.reproduced == pytest.approx(1.190, abs=5e-4)
    assert not needed.agrees
    assert needed.right > 1000


def test_a_tight_limit_binds_before_the_readout() -> None:
    plan = replace(QUICK, limit_w=2.5001, camera_w=2.5, frame_rate_max=1e6, latency_s=0.0)
    rates = run(load_scenario(), plan).dataset
    assert rates.rate.values == pytest.approx(rates.rate_power.values)
    assert rates.power_w.values == pytest.approx(plan.limit_w)


def test_emitters_say_where_they_come_from_and_stay_below_their_limits_when_pulsed() -> None:
    for emitter in emitters():
        assert emitter.source
        assert 0 < emitter.light_w < emitter.electrical_w
        assert BOARD_C + float(emitter.rise_k(np.array(20e-6), np.array(0.1))) < emitter.junction_max_c
        pulse = 20e-6 * emitter.overdrive(20e-6)
        assert pulse > 0


def test_run_writes_everything_and_says_bad_input_in_a_line(
    tmp_path: Path, mantis: Callable[..., tuple[int, str, str]]
) -> None:
    status, out, err = mantis("power", "--quick", "--out", tmp_path)
    assert (status, err) == (0, "")
    assert "power does not bind" in out.lower()
    for name in ("power.nc", "report.html", "data/power.csv", "data/power-ranges.csv", "figures/power-rate.svg"):
        assert (tmp_path / name).stat().st_size > 0
    status, _, err = mantis("power", "--quick", "--camera-w", "9", "--out", tmp_path)
    assert status == 2
    assert "camera_w: 9 W leaves nothing of limit_w" in err
