"""Glare with one thing changed at a time: another face, metal bars, the Earth, stray light in the lens, a sensor that blooms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from experiments.scenario import Scenario, set_key, validate
from experiments.studies.glare.geometry import Stand, at_sun, cropped, render
from experiments.studies.glare.study import VARIABLES, draw

#: What is changed, by name: keys of the scenario. Lens and sensor figures are assumptions, of poor but real ones.
CONDITIONS: dict[str, dict[str, Any]] = {
    "crinkled foil": {},
    "white paint": {"target.face_material": "white_paint", "target.facet_slope_deg": 0.0},
    "black paint": {"target.face_material": "black_coating", "target.facet_slope_deg": 0.0},
    "aluminium bars, 5 mm": {"target.edge_radius_m": 0.005},
    "Earth, 400 km below": {"earth": {}},
    "3 % veiling glare": {"camera.veiling_glare": 0.03},
    "lens without a baffle": {"camera.point_source_transmittance": ((20.0, 1e-3), (60.0, 1e-4), (180.0, 1e-5))},
    "sensor that blooms": {"sensor.blooming": 1.0},
}
RANGE_M = 5.0
PHASES_DEG = (2.0, 10.0, 45.0, 90.0, 150.0)
AZIMUTHS_DEG = (0.0, 120.0, 240.0)
MODES = ("single", "two_bands", "pair")
DIMS = ("condition", "mode", "phase_deg", "frame")


def run(
    scenario: Scenario,
    stands: tuple[Stand, ...],
    draws: int,
    pair_interval_s: float,
    phases_deg: tuple[float, ...] = PHASES_DEG,
    rays: int = 200_000,
    progress: Callable[[int, int, str], None] | None = None,
) -> xr.Dataset:
    """Detection, usable poses and false positives by condition, mode and phase; azimuths, stands and draws are the frames."""
    count = len(stands) * len(AZIMUTHS_DEG) * draws
    values = np.full((len(VARIABLES), len(CONDITIONS), len(MODES), len(phases_deg), count), np.nan)
    total = len(CONDITIONS) * len(phases_deg)
    for c, (name, changes) in enumerate(CONDITIONS.items()):
        changed = _with(scenario, changes)
        for p, phase in enumerate(phases_deg):
            suns = [(stand, azimuth) for stand in stands for azimuth in AZIMUTHS_DEG]
            for k, (stand, azimuth) in enumerate(suns):
                here = cropped(_earth_opposite(at_sun(changed, RANGE_M, phase, azimuth, stand)))
                geometry = render(here, MODES, pair_interval_s, rays)
                drawn, _ = draw(geometry, MODES, draws, (55, p, k))
                values[:, c, :, p, k * draws : (k + 1) * draws] = drawn
            if progress:
                progress(c * len(phases_deg) + p + 1, total, f"{name}, phase {phase:g}°")
    data: dict[str, tuple] = {
        name: (DIMS, v, dict(zip(("units", "long_name"), VARIABLES[name], strict=True)))
        for name, v in zip(VARIABLES, values, strict=True)
    }
    return xr.Dataset(data, {"condition": list(CONDITIONS), "mode": list(MODES), "phase_deg": list(phases_deg)})


def _earth_opposite(scenario: Scenario) -> Scenario:
    """The Earth on the side where the Sun is not, so that it is lit and does not hide the Sun."""
    if scenario.earth is None:
        return scenario
    azimuth = (scenario.sun.azimuth_deg + 360.0) % 360.0 - 180.0
    return scenario.model_copy(update={"earth": scenario.earth.model_copy(update={"azimuth_deg": azimuth})})


def _with(scenario: Scenario, changes: dict[str, Any]) -> Scenario:
    data = scenario.model_dump()
    for key, value in changes.items():
        set_key(data, key, value)
    return validate(data)


HEADINGS = (
    "condition",
    "mode",
    "found [%]",
    "usable [%]",
    "attitude p95 [°]",
    "false pos. [%]",
    "least CNR",
    "fails at",
)


def rows(dataset: xr.Dataset, scenario: Scenario) -> list[tuple[str, ...]]:
    """One row for every condition and mode: the worst phase of each figure, and the phases where a frame is not usable."""
    need = scenario.requirement
    table: list[tuple[str, ...]] = []
    good = (dataset.attitude_error_deg <= need.attitude_error_max_deg) & (dataset.range_error <= need.range_error_max)
    for condition in dataset.condition.values:
        for mode in dataset.mode.values:
            cells = dataset.sel(condition=condition, mode=mode)
            usable = good.sel(condition=condition, mode=mode).mean("frame")
            errors = [v[np.isfinite(v)] for v in cells.attitude_error_deg.values]
            worst = max((float(np.percentile(v, 95)) for v in errors if len(v)), default=np.nan)
            cnr = float(cells.cnr.min())
            failing = ", ".join(f"{p:g}°" for p in cells.phase_deg.values[usable.values < 1])
            table.append(
                (
                    str(condition),
                    str(mode),
                    f"{100 * float(cells.detected.mean('frame').min()):.0f}",
                    f"{100 * float(usable.min()):.0f}",
                    f"{worst:.2f}" if np.isfinite(worst) else "–",
                    f"{100 * float(cells.false_positive.mean('frame').max()):.0f}",
                    f"{cnr:.0f}" if np.isfinite(cnr) else "–",
                    failing or "none",
                )
            )
    return table
