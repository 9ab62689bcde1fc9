"""The main job: SNR, CNR, saturation, detection and pose over range, in eclipse and sunlight, and whether the budget closes."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from detector.features import Features
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.chain.trials import VARIABLES, Trials, draw, known_values
from experiments.reporting.files import write_png
from experiments.scenario import Scenario
from experiments.studies.budget.criteria import MEASURES
from experiments.studies.budget.plan import FULL, Plan
from radiometry import closure
from scenes.files import exr


@dataclass(frozen=True)
class Snapshot:
    """What the camera saw at one range in one illumination, first noise draw of the shown exposure."""

    range_m: float
    illumination: str
    exposure_s: float
    frame: NDArray[np.uint16]
    features: Features


@dataclass(frozen=True)
class BudgetResult:
    """The dataset of a budget, the scenario with the plan that was walked through, and the frames that its page shows."""

    scenario: Scenario
    dataset: xr.Dataset
    snapshots: list[Snapshot]


def run(
    scenario: Scenario,
    plan: Plan = FULL,
    progress: Progress | None = None,
    workers: int | None = None,
    out: Path | None = None,
) -> BudgetResult:
    """Render, expose, detect and judge every range, illumination and exposure of the scenario's plan.

    Args:
        scenario: what to judge.
        plan: how much of the scenario's own plan is walked through.
        progress: called after every range and illumination.
        workers: processes for the noise draws; default one a core. The result does not depend on it.
        out: folder for the EXR transport basis of each range, written when it is rendered, and the 16-bit PNG of each first
            frame; None writes nothing.

    Raises:
        OSError: when a file cannot be written.
        ValueError: for an automatic exposure where no bit is in the nearest frame.
    """
    scenario = plan.thinned(scenario)
    _check_exposure(scenario)
    walk = scenario.budget
    steps = [(r, illumination) for r in walk.ranges_m for illumination in walk.illuminations]
    pending: list[tuple[Future[list[Trials]], dict[str, list[float]]]] = []
    with pool(draw, workers) as submit:
        for range_m in walk.ranges_m:
            here = scenario.at(range_m=range_m)
            basis = chain.transport(here)
            if out is not None:
                exr.write_basis(basis, out / "transport" / f"range_{range_m:06.2f}m.exr")
            for illumination in walk.illuminations:
                rate = chain.electron_rate(here, basis, illumination)
                case = chain.Case(here, illumination)
                budget = case.link_budget_beside(rate)
                seconds = [chain.solve_exposure(here, budget, e) for e in walk.exposures_s]
                known = known_values(case, budget, rate, seconds)
                pending.append((submit(case, rate, seconds), known))
                if progress:
                    progress(sum(f.done() for f, _ in pending), len(steps), f"rendered {range_m:g} m")
        cases = []
        for done, ((range_m, _), (future, _)) in enumerate(zip(steps, pending, strict=True), 1):
            cases.append(future.result())
            if progress:
                progress(done, len(steps), f"detected {range_m:g} m")
    dataset = _dataset(scenario, cases, [known for _, known in pending])
    shown = shown_exposure(scenario)
    snapshots = [
        Snapshot(range_m, illumination, float(known["exposure_s"][shown]), case[shown].frame, case[shown].features)
        for (range_m, illumination), case, (_, known) in zip(steps, cases, pending, strict=True)
    ]
    if out is not None:
        for s in snapshots:
            write_png(s.frame, out / "frames" / f"range_{s.range_m:06.2f}m_{s.illumination}.png")
    return BudgetResult(scenario, dataset, snapshots)


def _check_exposure(scenario: Scenario) -> None:
    """Refuse an automatic exposure before anything is rendered: the bits leave the frame at the nearest range first."""
    plan = scenario.budget
    if "auto" in plan.exposures_s:
        nearest = scenario.at(range_m=plan.ranges_m[0])
        chain.solve_exposure(nearest, chain.link_budget(nearest, plan.illuminations[0]), "auto")


def shown_exposure(scenario: Scenario) -> int:
    """Index of the exposure that pictures and the range-by-range table show: the automatic one, else the last."""
    exposures = list(scenario.budget.exposures_s)
    return exposures.index("auto") if "auto" in exposures else len(exposures) - 1


def exposure_label(exposure: float | str) -> str:
    """How an exposure of the plan is called in tables: 'auto', '1/30 s', '1 ms'."""
    if isinstance(exposure, str):
        return exposure
    if exposure >= 0.01 and abs(1 / exposure - round(1 / exposure)) < 1e-6:
        return f"1/{round(1 / exposure)} s"
    scale, unit = next(((s, u) for s, u in ((1, "s"), (1e-3, "ms"), (1e-6, "µs")) if exposure >= s), (1e-9, "ns"))
    return f"{exposure / scale:.3g} {unit}"


def exposure_labels(exposures: Sequence[float | str]) -> list[str]:
    """What each of a plan's exposures is called, no two alike: those that three digits do not tell apart in full."""
    labels = [exposure_label(e) for e in exposures]
    return [f"{e} s" if labels.count(label) > 1 else label for e, label in zip(exposures, labels, strict=True)]


def _dataset(scenario: Scenario, cases: list[list[Trials]], known: list[dict[str, list[float]]]) -> xr.Dataset:
    plan = scenario.budget
    shape = (len(plan.ranges_m), len(plan.illuminations), len(plan.exposures_s))
    dims = ("range_m", "illumination", "exposure")
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name, (unit, long_name) in VARIABLES.items():
        values = [
            k[name][e] if name in k else case[e].values[name]
            for k, case in zip(known, cases, strict=True)
            for e in range(len(plan.exposures_s))
        ]
        data[name] = (dims, np.array(values, float).reshape(shape), {"units": unit, "long_name": long_name})
    for name, unit, long_name in (
        ("detected", "1", "marker found in a frame"),
        ("attitude_error_deg", "degree", "geodesic attitude error of a frame"),
        ("range_error", "1", "range error over range of a frame"),
    ):
        trials = np.array([[getattr(c, name) for c in case] for case in cases]).reshape(*shape, plan.trials)
        data[name] = ((*dims, "trial"), trials, {"units": unit, "long_name": long_name})
    px_per_bit = [chain.link_budget(scenario.at(range_m=r), "eclipse").px_per_bit for r in plan.ranges_m]
    data["px_per_bit"] = (
        ("range_m",),
        np.array(px_per_bit),
        {"units": "pixel", "long_name": "pixels along a bit's shorter side"},
    )
    dataset = xr.Dataset(
        data,
        coords={
            "range_m": ("range_m", np.array(plan.ranges_m), {"units": "m", "long_name": "range"}),
            "illumination": ("illumination", list(plan.illuminations), {"long_name": "illumination"}),
            "exposure": ("exposure", exposure_labels(plan.exposures_s), {"long_name": "exposure"}),
            "trial": ("trial", np.arange(plan.trials), {"long_name": "noise draw"}),
        },
        attrs={
            "Conventions": "CF-1.11",
            "title": scenario.title,
            "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis budget",
            **chain.provenance(scenario),
        },
    )
    return _judged(scenario, dataset)


def _judged(scenario: Scenario, dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with the margin of every criterion, and whether all are met."""
    full = {
        name: dataset[measure.variable].broadcast_like(dataset.exposure_s).transpose(*dataset.exposure_s.dims)
        for name, measure in MEASURES.items()
    }
    margins = np.empty((*dataset.exposure_s.shape, len(MEASURES)))
    for index in np.ndindex(dataset.exposure_s.shape):
        values = {name: float(array.values[index]) for name, array in full.items()}
        margins[index] = [verdict.margin for verdict in closure.judge(scenario.requirement, values)]
    dims = (*dataset.exposure_s.dims, "criterion")
    return dataset.assign_coords(criterion=("criterion", list(MEASURES), {"long_name": "closure criterion"})).assign(
        margin=(dims, margins, {"units": "1", "long_name": "factor by which the criterion is met; below 1 it fails"}),
        closes=(dims[:-1], (margins >= 1).all(axis=-1), {"units": "1", "long_name": "all criteria met"}),
    )
