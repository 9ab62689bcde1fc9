"""Glare with one thing changed at a time: another face, metal bars, the Earth, stray light in the lens, a sensor that blooms."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.scenario import Scenario, set_key, validate
from experiments.studies.glare.frames import VARIABLES, draw, labelled
from experiments.studies.glare.geometry import at_sun, cropped, render
from experiments.studies.glare.plan import Plan

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
AZIMUTHS_DEG = (0.0, 120.0, 240.0)
MODES = ("single", "two_bands", "pair")
DIMS = ("condition", "mode", "phase_deg", "frame")


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> xr.Dataset:
    """`frames.VARIABLES` by condition, mode and phase; azimuths, attitudes and draws are the frames."""
    phases, draws = plan.condition_phases_deg, plan.condition_draws
    suns = [(attitude, azimuth) for attitude in plan.attitudes for azimuth in AZIMUTHS_DEG]
    values = np.full((len(VARIABLES), len(CONDITIONS), len(MODES), len(phases), len(suns) * draws), np.nan)
    total = len(CONDITIONS) * len(phases)
    for c, (name, changes) in enumerate(CONDITIONS.items()):
        changed = _with(scenario, changes)
        for p, phase in enumerate(phases):
            for k, (attitude, azimuth) in enumerate(suns):
                here = cropped(_earth_opposite(at_sun(changed, RANGE_M, phase, azimuth, attitude)))
                geometry = render(here, MODES, plan.pair_interval_s, plan.condition_rays)
                drawn, _ = draw(geometry, MODES, draws, (55, p, k))
                values[:, c, :, p, k * draws : (k + 1) * draws] = drawn
            if progress:
                progress(c * len(phases) + p + 1, total, f"{name}, phase {phase:g}°")
    coordinates = {"condition": list(CONDITIONS), "mode": list(MODES), "phase_deg": list(phases)}
    return xr.Dataset(labelled(values, DIMS), coordinates)


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
