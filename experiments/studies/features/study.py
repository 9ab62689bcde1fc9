"""The study of features: accuracy beside the bounds, detection beside others, marker-free frames, and both calibrations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from detector.version import code_version
from experiments import chain
from experiments.chain.progress import Progress
from experiments.chain.statistics import binomial_interval
from experiments.reporting.blocks import csv_text
from experiments.reporting.figures import save_svg
from experiments.reporting.files import write_netcdf, write_text
from experiments.scenario import Scenario
from experiments.studies.features import accuracy, clutter, detection
from experiments.studies.features.figures import figures
from experiments.studies.features.page import page
from experiments.studies.shared import calibrations
from experiments.studies.shared.calibrations import Trial

#: The marker's yaw where pitch varies: one that faces the camera exactly is a case of its own [deg].
YAW_DEG = 3.0
#: Ranges at which elements and camera are calibrated [m].
ELEMENTS_AT_M, BOARD_AT_M = 2.5, 1.25
#: Distortion of the lens that is calibrated as well: one pixel at the frame's corner.
DISTORTION: Mapping[str, float] = {"k1": -0.2, "k2": 0.1, "p1": 0.001}


@dataclass(frozen=True)
class Plan:
    """How much of everything."""

    ranges_m: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
    pitches_deg: tuple[float, ...] = (-35.0, -20.0, 0.0, 20.0, 35.0)
    shifts: int = 8
    draws: int = 10
    attitudes: int = 10
    attitude_shifts: int = 4
    attitude_draws: int = 5
    attitudes_at_target: int = 40
    px_per_bit: tuple[float, ...] = detection.PX_PER_BIT
    cnr: tuple[float, ...] = detection.CNR
    free_quarters: int = 9_000
    free_whole: int = 1_000
    free_renders: int = 50
    calibrations: bool = True


QUICK = Plan(
    ranges_m=(4.0,), pitches_deg=(20.0,), shifts=3, draws=5, attitudes=1, attitude_shifts=2, attitude_draws=3,
    px_per_bit=(2.0, 4.0), cnr=(2.0, 5.0), attitudes_at_target=2, free_quarters=20, free_whole=10, free_renders=1,
    calibrations=False,
)  # fmt: skip


@dataclass(frozen=True)
class Result:
    """What a run gives: datasets by part, and what the calibrations found."""

    scenario: Scenario
    plan: Plan
    accuracy: xr.Dataset
    detection: xr.Dataset
    clutter: xr.Dataset
    trials: dict[str, list[Trial]]


def run(
    scenario: Scenario, quick: bool = False, workers: int | None = None, progress: Progress | None = None
) -> Result:
    """All parts; in short for a first look."""
    plan = QUICK if quick else Plan()
    if quick and workers is None:
        workers = 0  # to start others takes longer than the work
    tilted = scenario.at(target={**scenario.target.model_dump(), "yaw_deg": YAW_DEG})
    by_range = accuracy.study(tilted, plan.ranges_m, plan.pitches_deg, plan.shifts, plan.draws, workers, progress)
    found = detection.study(
        scenario, plan.attitudes, plan.attitude_shifts, plan.attitude_draws, plan.px_per_bit, plan.cnr, workers, progress,
        plan.attitudes_at_target,
    )  # fmt: skip
    free = xr.concat(
        [
            clutter.study(scenario, frames, plan.free_renders, workers, progress, cut)
            for frames, cut in ((plan.free_quarters, clutter.QUARTER), (plan.free_whole, clutter.WHOLE))
        ],
        "size_px",
    )
    trials = _calibrations(scenario) if plan.calibrations else {}
    return Result(scenario, plan, by_range, found, free, trials)


def _calibrations(scenario: Scenario) -> dict[str, list[Trial]]:
    near, board = scenario.at(range_m=ELEMENTS_AT_M), scenario.at(range_m=BOARD_AT_M)
    bent = board.at(camera={**board.camera.model_dump(), **DISTORTION})
    return {
        "elements": calibrations.element_trials(near),
        "camera": calibrations.camera_trials(board, calibrations.board_for(board), distorted=False),
        "distorted camera": calibrations.camera_trials(bent, calibrations.board_for(board), distorted=True),
    }


def write(result: Result, out: Path, command: str) -> None:
    """features.nc, csv tables, the figures and features.md; figures and tables in the folders that docs/ has."""
    (out / "data").mkdir(parents=True, exist_ok=True)
    (out / "figures").mkdir(exist_ok=True)
    merged = xr.merge([result.accuracy, result.detection, result.clutter], combine_attrs="drop_conflicts")
    made = chain.provenance(result.scenario) | {"detector_code": code_version(), "history": command}
    write_netcdf(merged.assign_attrs(made), out / "features.nc")
    per_blob = [name for name in result.accuracy if "element" in result.accuracy[name].dims]
    tables = {
        "accuracy": _columns(result.accuracy.drop_vars([*per_blob, "element"])),
        "blobs": _columns(result.accuracy[per_blob]),
        "detection": _detection_columns(result.detection),
        "clutter": _columns(result.clutter),
    }
    if result.trials:
        rows = [(part, t.what, t.unit, t.true, t.found, t.sigma) for part, ts in result.trials.items() for t in ts]
        names = ("calibration", "parameter", "unit", "true", "found", "sigma")
        tables["calibration"] = dict(zip(names, zip(*rows, strict=True), strict=True))
    for name, columns in tables.items():
        rounded = {key: [_rounded(v) for v in values] for key, values in columns.items()}
        write_text(csv_text(rounded), out / "data" / f"features-{name}.csv")
    for name, figure in figures(result.accuracy, result.detection).items():
        save_svg(figure, out / "figures" / f"features-{name}.svg")
    write_text(page(result, command, made), out / "features.md")


def _rounded(value: Any) -> Any:
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else value


def _columns(data: xr.Dataset) -> dict[str, Iterable[Any]]:
    """Coordinates and variables of a dataset as columns, one row a cell."""
    table = data.to_dataframe().reset_index()
    return {str(name): table[name].to_list() for name in table}


def _detection_columns(found: xr.Dataset) -> dict[str, Iterable[Any]]:
    """Counts with their interval, one row a family, detector and step of either axis."""
    rows = []
    for name, axis in (("size", "px_per_bit"), ("cnr", "cnr")):
        frames = found[f"frames_by_{name}"].values
        for family in found.family.values:
            for detector in found.detector.values:
                counts = found[f"found_by_{name}"].sel(family=family, detector=detector)
                low, high = binomial_interval(counts.values, frames)
                for at, n, count, a, b in zip(counts[axis].values, frames, counts.values, low, high, strict=True):
                    if np.isfinite(count):
                        rows.append((axis, float(at), str(family), str(detector), int(n), int(count), a, b))
    names = ("axis", "value", "family", "detector", "frames", "found", "low95", "high95")
    return dict(zip(names, zip(*rows, strict=True), strict=True))
