"""Confirmation of proposed parameter sets: rendered, exposed and detected at every view, range and light."""

from __future__ import annotations

import csv
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments import chain
from experiments.chain import trials
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.chain.trials import Trials
from experiments.reporting.formatting import ILLUMINATION_NAMES, listed
from experiments.scenario import Scenario
from experiments.studies.close.constraints import ConfirmView, Constraints
from experiments.studies.close.search import Point
from experiments.studies.close.sensitivity import interval
from radiometry import closure
from scenes.files.cache import TransportCache, default_folder

#: Criteria that frames are held to in a confirmation; sampling and smear need none.
_JUDGED = {
    "saturation": "full_well_fraction",
    "cnr": "cnr_rendered",
    "detection": "detected_fraction",
    "attitude": "attitude_error_p95_deg",
    "range": "range_error_p95",
}
#: What is kept of every case.
_KEPT = (
    "exposure_s",
    "full_well_fraction",
    "cnr_analytic",
    "cnr_rendered",
    "smear_px",
    "saturated_fraction",
    "detected_fraction",
    "attitude_error_p95_deg",
    "range_error_p95",
)
#: Columns of a record that hold text; all others are numbers.
_TEXT_COLUMNS = ("set", "illumination", "fails")


def confirm(
    chosen: tuple[tuple[Point, Scenario], ...],
    constraints: Constraints,
    progress: Progress | None = None,
    workers: int | None = None,
) -> list[dict[str, Any]]:
    """Render, expose and detect every set of its scenario at every view, range and light; the exposure follows the light.

    Returns:
        One record a case: what was set, what was measured, whether it `closes` and what `fails`.
    """
    store = TransportCache(default_folder())
    cases: list[tuple[dict[str, Any], Future[list[Trials]], dict[str, list[float]]]] = []
    steps = [
        (point, base, view, range_m)
        for point, base in chosen
        for view in constraints.confirm.views
        for range_m in view.ranges_m or constraints.ranges_m
    ]
    with pool(trials.draw, workers) as submit:
        for done, (point, base, view, range_m) in enumerate(steps, 1):
            here = _case_scenario(
                point.scenario(base, constraints, constraints.end_of_life), view, range_m, constraints
            )
            for illumination in chain.SOURCES:
                lit, budget, seconds = exposed(here, illumination, constraints)
                quality = chain.quality(lit)
                basis = store.basis(chain.view(lit), quality)
                rate = chain.electron_rate(lit, basis, illumination)
                case = chain.Case(lit, illumination)
                known = trials.known_values(case, budget, rate, [seconds])
                record = {
                    "set": point.label,
                    "pitch_deg": view.pitch_deg,
                    "yaw_deg": view.yaw_deg,
                    "phase_deg": view.phase_deg,
                    "range_m": range_m,
                    "illumination": illumination,
                    "leds": lit.leds.count,
                    "px_per_bit": budget.px_per_bit,
                }
                cases.append((record, submit(case, rate, [seconds]), known))
            if progress:
                progress(done, len(steps), f"rendered {range_m:g} m")
        return [
            _judged(record, future.result()[0], known, chosen[0][1], constraints) for record, future, known in cases
        ]


def _case_scenario(scenario: Scenario, view: ConfirmView, range_m: float, constraints: Constraints) -> Scenario:
    tilt = {"pitch_deg": view.pitch_deg, "yaw_deg": view.yaw_deg}
    return scenario.at(
        range_m=range_m,
        target={**scenario.target.model_dump(), **tilt},
        sun={**scenario.sun.model_dump(), "phase_deg": view.phase_deg},
        render={**scenario.render.model_dump(), "frame_samples": 1},
        budget={**scenario.budget.model_dump(), "trials": constraints.confirm.trials},
    )


def exposed(
    scenario: Scenario, illumination: str, constraints: Constraints
) -> tuple[Scenario, chain.LinkBudget, float]:
    """The scenario with as many of its LEDs on as the shortest pulse allows, its closed form, and its exposure [s]."""
    auto, budget = scenario.auto_exposure, chain.link_budget(scenario, illumination)
    wanted = auto.full_well_fraction * chain.usable_well_electrons(scenario.sensor) / auto.shortest_s
    if budget.signal_rate > wanted and scenario.leds.count > 1:
        sun = (
            budget.signal_rate - chain.link_budget(scenario, "eclipse").signal_rate if illumination == "sunlit" else 0.0
        )
        most = max(1, int((wanted - sun) / ((budget.signal_rate - sun) / scenario.leds.count)))
        scenario = scenario.at(leds={**scenario.leds.model_dump(), "count": most})
        budget = chain.link_budget(scenario, illumination)
    seconds = chain.solve_exposure(scenario, budget, "auto")
    return scenario, budget, min(seconds, 1 / constraints.frame_rate_hz(scenario))


def _judged(
    record: dict[str, Any], drawn: Trials, known: dict[str, list[float]], base: Scenario, constraints: Constraints
) -> dict[str, Any]:
    values = {name: value[0] for name, value in known.items()} | drawn.values
    verdicts = closure.judge(base.requirement, {name: values[column] for name, column in _JUDGED.items()})
    failing = [v.name for v in verdicts if not v.passed]
    return {
        **record,
        **{name: float(values[name]) for name in _KEPT},
        "signal_rendered_over_analytic": float(values["signal_expected"] / values["signal_analytic"]),
        "trials": constraints.confirm.trials,
        "closes": not failing,
        "fails": " ".join(failing),
    }


@dataclass(frozen=True)
class Confirmed:
    """What the rendered frames say of one set.

    Attributes:
        cases, closing: cases rendered, and those that meet every criterion.
        frames, found: frames exposed, and those in which the marker was found; `found_low` bounds the share at 95 % (one-sided).
        attitude_deg, range_error: largest 95th percentile of a case.
        cnr: smallest of a case, and `signal_difference` the largest of rendered against closed form.
        fails: criteria that fail somewhere, with the cases that do.
        failing: each failing case in words.
    """

    label: str
    cases: int
    closing: int
    frames: int
    found: int
    found_low: float
    attitude_deg: float
    range_error: float
    cnr: float
    signal_difference: float
    fails: dict[str, int]
    failing: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """True where every case closes."""
        return self.closing == self.cases


def summarise(records: list[dict[str, Any]]) -> list[Confirmed]:
    """One line for every set, in the order of the records."""
    result = []
    for label in dict.fromkeys(r["set"] for r in records):
        mine = [r for r in records if r["set"] == label]
        frames = sum(int(r["trials"]) for r in mine)
        found = sum(round(r["detected_fraction"] * r["trials"]) for r in mine)
        fails: dict[str, int] = {}
        for name in (n for r in mine for n in r["fails"].split()):
            fails[name] = fails.get(name, 0) + 1
        low = 0.05 ** (1 / frames) if found == frames else interval(found / frames, frames)[0]
        result.append(
            Confirmed(
                label=label,
                cases=len(mine),
                closing=sum(bool(r["closes"]) for r in mine),
                frames=frames,
                found=found,
                found_low=low,
                attitude_deg=_worst(mine, "attitude_error_p95_deg", np.nanmax),
                range_error=_worst(mine, "range_error_p95", np.nanmax),
                cnr=_worst(mine, "cnr_rendered", np.nanmin),
                signal_difference=float(max(abs(r["signal_rendered_over_analytic"] - 1) for r in mine)),
                fails=fails,
                failing=tuple(_case_text(r) for r in mine if not r["closes"]),
            )
        )
    return result


def _case_text(record: dict[str, Any]) -> str:
    """'attitude and range at 2 m in sunlight, pitch 20°, yaw 0°, Sun at 10°'."""
    where = f"pitch {record['pitch_deg']:g}°, yaw {record['yaw_deg']:g}°, Sun at {record['phase_deg']:g}°"
    light = ILLUMINATION_NAMES[record["illumination"]]
    return f"{listed(record['fails'].split())} at {record['range_m']:g} m in {light}, {where}"


def _worst(records: list[dict[str, Any]], key: str, of: Any) -> float:
    values = np.array([r[key] for r in records], float)
    return float(of(values)) if np.isfinite(values).any() else float("nan")


def read_records(path: Path) -> list[dict[str, Any]]:
    """Records of a confirmation from the table that the page writes.

    Raises:
        OSError: when the file cannot be read.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        {k: v == "True" if k == "closes" else v if k in _TEXT_COLUMNS else float(v) for k, v in row.items()}
        for row in rows
    ]
