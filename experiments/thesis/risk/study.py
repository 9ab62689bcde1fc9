"""Rates of the failure modes of thesis section 8.3 from the other studies' tables, and their levels in its risk matrix."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.chain.statistics import binomial_interval
from experiments.scenario import Scenario
from experiments.studies.shared.failures import ATTITUDE, MODES, RANGE
from experiments.thesis.risk.plan import FULL, Plan
from radiometry.closure import Requirement

STAGES = ("before", "part", "after")
#: A mode costs accuracy in a major way where its frames' median error is beyond the requirement's: attitude [deg], and range over
#: range. Assumption.
MAJOR_DEG, MAJOR_RANGE = float(Requirement().attitude_error_max_deg), float(Requirement().range_error_max)
CONFIDENCE = 0.95
#: Levels of likelihood: the thesis's three, and one for what is more frequent.
LEVELS = 4


@cache
def catalogue() -> dict[str, Any]:
    """The data file: levels, modes and sources."""
    return tomllib.loads((files("experiments") / "thesis" / "risk" / "thesis.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Rate:
    """How often something happened."""

    failed: int
    frames: int

    @property
    def value(self) -> float:
        """Share of the frames."""
        return self.failed / self.frames

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper and Pearson's exact 95 % interval (Biometrika 26, 1934)."""
        low, high = binomial_interval(self.failed, self.frames, CONFIDENCE)
        return float(low), float(high)


def level(rate: float) -> int:
    """Likelihood level of table 8.3 of a rate; 4, which is not in it, from its highest bound on."""
    bounds = sorted((bound, int(name)) for name, bound in catalogue()["likelihood"].items())
    return next((name for bound, name in bounds if rate < bound), len(bounds) + 1)


@dataclass(frozen=True)
class Place:
    """A mode in the matrix: likelihood level, severity level, and the rate and error that put it there.

    Attributes:
        error_deg, range_error: median errors of the frames with the mode, attitude and range over range; NaN where there is no
            such frame, or they are not kept.
    """

    rate: Rate
    severity: int
    error_deg: float
    range_error: float

    @property
    def likelihood(self) -> int:
        """Level of the rate."""
        return level(self.rate.value)

    @property
    def proven(self) -> int:
        """Level of the upper end of the rate's interval."""
        return level(self.rate.interval[1])


#: Places by source, stage and mode; what a table cannot tell is missing.
Places = dict[tuple[str, str, str], Place]


@dataclass(frozen=True)
class RiskResult:
    """Where every failure mode lies in the matrix.

    Attributes:
        places: by source, stage and mode.
        missing: a line for every source whose table is not there.
        dataset: the same as labelled arrays.
    """

    places: Places
    missing: tuple[str, ...]
    dataset: xr.Dataset

    @property
    def sources(self) -> tuple[dict[str, Any], ...]:
        """Sources whose table is there."""
        return tuple(s for s in catalogue()["source"] if any(source == s["name"] for source, _, _ in self.places))


def run(scenario: Scenario | None = None, plan: Plan = FULL, progress: Progress | None = None) -> RiskResult:
    """Read the studies' tables and place every failure mode in the matrix.

    Args:
        scenario: not used: the tables say what was looked at.
        plan: where the tables are.
        progress: not used; the work takes a second.

    Raises:
        ValueError: when no table is there, or one cannot be read.
    """
    found, missing = places(plan.results)
    return RiskResult(found, tuple(missing), _dataset(found))


def modes() -> tuple[dict[str, Any], ...]:
    """The failure modes of the data file, in the thesis's order."""
    return tuple(catalogue()["mode"])


def find_table(folders: Sequence[Path], name: str) -> Path | None:
    """The first such table in the folders or in their folders `data`."""
    return next((p for folder in folders for p in (folder / name, folder / "data" / name) if p.is_file()), None)


def read(path: Path, needed: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a table by heading.

    Raises:
        ValueError: when it cannot be read, or lacks a needed column.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path}: not a table that can be read ({error}); expected CSV with a heading") from None
    lacking = [name for name in needed if name not in (reader.fieldnames or ())]
    if lacking:
        raise ValueError(f"{path}: no column {lacking[0]!r}; expected a table of this version's studies")
    return rows


def places(folders: Sequence[Path]) -> tuple[Places, list[str]]:
    """Every mode's place by source and stage, and a line for every source that is not there.

    Raises:
        ValueError: when no source is there, or a table or its numbers cannot be read.
    """
    found: Places = {}
    missing = []
    for source in catalogue()["source"]:
        path = find_table(folders, source["table"])
        if path is None:
            missing.append(f"{source['title']}: {source['table']} is missing; {source['command']} makes it")
            continue
        wanted = {
            key
            for stage in ("before", "window", "part", "part_window", "after", "low", "high")
            for key in source.get(stage, ())
        }
        rows = read(path, [source["count"], *MODES.values(), *wanted])
        for stage in STAGES:
            for mode in MODES:
                # Wrong corners as the thesis shows them come of a search in a window.
                window = {"before": "window", "part": "part_window"}.get(stage, "")
                chosen = source.get(window) if mode == "wrong_corners" and window in source else source.get(stage)
                place = None if chosen is None else _place(path, _matching(rows, chosen, source), source["count"], mode)
                if place is not None:
                    found[source["name"], stage, mode] = place
    if not found:
        searched = ", ".join(str(folder) for folder in folders)
        raise ValueError(
            f"--results {searched}: none of the tables is there; expected docs/data, or folders of {commands()}"
        )
    return found, missing


def commands() -> str:
    """The commands that make the tables."""
    return ", ".join(dict.fromkeys(source["command"] for source in catalogue()["source"]))


def _matching(
    rows: list[dict[str, str]], chosen: Mapping[str, Sequence[str]], source: Mapping[str, Any]
) -> list[dict[str, str]]:
    """Rows with the chosen values, whose numbers are within the source's least and largest ones."""
    return [
        row
        for row in rows
        if all(row[key] in values for key, values in chosen.items())
        and all(float(row[key]) >= least for key, least in source.get("low", {}).items())
        and all(float(row[key]) <= largest for key, largest in source.get("high", {}).items())
    ]


def _place(path: Path, rows: list[dict[str, str]], count: str, mode: str) -> Place | None:
    """A mode's place from some rows of a table, pooled; None where they do not tell."""
    rows = [row for row in rows if row[MODES[mode]] != "–"]
    if not rows:
        return None
    try:
        failed, frames = [int(row[MODES[mode]]) for row in rows], sum(int(row[count]) for row in rows)
        attitude = _error(rows, failed, ATTITUDE.get(mode, ""))
        distance = _error(rows, failed, RANGE.get(mode, "")) / 100
    except ValueError as wrong:
        raise ValueError(f"{path}: {wrong}; expected whole numbers of frames") from None
    if not 0 <= sum(failed) <= frames or frames == 0:
        raise ValueError(
            f"{path}: {sum(failed)} of {frames} frames with {MODES[mode]}; expected no more than there are"
        )
    printed = next(entry["before"][1] for entry in catalogue()["mode"] if entry["name"] == mode)
    major = attitude > MAJOR_DEG or distance > MAJOR_RANGE
    severity = printed if np.isnan(attitude) else (2 if major else 1)
    return Place(Rate(sum(failed), frames), severity, attitude, distance)


def _error(rows: list[dict[str, str]], failed: list[int], column: str) -> float:
    """Mean of the rows' median errors, by frames; NaN where none is told."""
    told = [(float(row[column]), n) for row, n in zip(rows, failed, strict=True) if row.get(column, "–") != "–"]
    weight = sum(n for _, n in told)
    return sum(e * n for e, n in told) / weight if weight else float("nan")


def _dataset(found: Places) -> xr.Dataset:
    """Frames, failures, rates with their intervals, levels, severities and errors over (source, stage, mode)."""
    told = {
        "failed": "frames with the failure",
        "frames": "frames",
        "rate": "share of the frames",
        "rate_low": "lower end of its 95 % interval",
        "rate_high": "upper end of its 95 % interval",
        "likelihood": "likelihood level of thesis table 8.3; 4 is beyond it",
        "severity": "severity level of thesis table 8.2",
        "error_deg": "median attitude error of the frames with it",
        "range_error": "median range error over range of them",
    }
    sources = [source["name"] for source in catalogue()["source"]]
    values = {name: np.full((len(sources), len(STAGES), len(MODES)), np.nan) for name in told}
    for (source, stage, mode), place in found.items():
        at = sources.index(source), STAGES.index(stage), list(MODES).index(mode)
        counted = (place.rate.failed, place.rate.frames, place.rate.value, *place.rate.interval)
        judged = (place.likelihood, place.severity, place.error_deg, place.range_error)
        for name, value in zip(told, (*counted, *judged), strict=True):
            values[name][at] = value
    data = {
        name: (
            ("source", "stage", "mode"),
            v,
            {"units": "degree" if name == "error_deg" else "1", "long_name": told[name]},
        )
        for name, v in values.items()
    }
    return xr.Dataset(data, {"source": sources, "stage": list(STAGES), "mode": list(MODES)}, {"title": "Failure modes"})
