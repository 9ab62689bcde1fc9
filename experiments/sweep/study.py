"""Sweeps: any scenario keys over a grid, a list or a quasi-random sample, into one labelled dataset.

Cases that share their transport share one rendering, kept in the cache. Finished cases are journalled one by one, so that an
interrupted sweep goes on where it stopped, and its result is the same to the last bit.
"""

from __future__ import annotations

import itertools
import os
import tomllib
from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from experiments import chain, trials
from experiments.scenario import Scenario, ScenarioError, explain, load_data, set_key, validate
from experiments.sweep.journal import Journal
from experiments.trials import VARIABLES, Progress
from scenes.cache import TransportCache, default_folder

Values = Annotated[list[Any], Field(min_length=1)]


class Sample(BaseModel):
    """Quasi-random points in a box of scenario keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["sobol", "latin_hypercube"] = Field("sobol", description="sequence of scipy.stats.qmc")
    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="points; a power of two suits Sobol")
    seed: Annotated[int, Field(ge=0)] = Field(1, description="seed of the sequence's scrambling")
    ranges: dict[str, tuple[float, float]] = Field(description="[low, high] by scenario key")


class SweepPlan(BaseModel):
    """What to sweep. Keys are scenario keys, dotted: range_m, leds.count, sun.phase_deg, …"""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    scenario: str | None = Field(None, description="file or shipped name of the base scenario; default the default one")
    trials: Annotated[int, Field(ge=2, le=100_000)] = Field(16, description="noise draws of every case")
    fixed: dict[str, Any] = Field(default_factory=dict, alias="set", description="changes to the base scenario")
    grid: dict[str, Values] = Field(default_factory=dict, description="values by key; all combinations are run")
    cases: dict[str, Values] = Field(default_factory=dict, alias="list", description="values by key, run side by side")
    sample: Sample | None = Field(None, description="quasi-random points")

    @model_validator(mode="after")
    def _something_to_sweep(self) -> SweepPlan:
        if not (self.grid or self.cases or self.sample):
            raise ValueError("a sweep needs [grid], [list] or [sample]")
        if self.cases and self.sample:
            raise ValueError("[list] and [sample] exclude each other")
        if len({len(v) for v in self.cases.values()}) > 1:
            raise ValueError("list: every key needs as many values as the others")
        keys = [*self.grid, *self.cases, *(self.sample.ranges if self.sample else {})]
        twice = {key for key in keys if keys.count(key) > 1}
        if twice:
            raise ValueError(f"{', '.join(sorted(twice))}: swept twice")
        return self

    def side_by_side(self) -> dict[str, list[Any]]:
        """Values of the keys that are not in the grid, one entry a point."""
        if self.sample is None:
            return self.cases
        from scipy.stats import qmc

        keys = list(self.sample.ranges)
        sequence = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube}[self.sample.method]
        unit = sequence(len(keys), rng=np.random.default_rng(self.sample.seed)).random(self.sample.count)
        low, high = np.array([self.sample.ranges[key] for key in keys]).T
        return {key: (low + (high - low) * unit)[:, k].tolist() for k, key in enumerate(keys)}


@dataclass(frozen=True)
class Sweep:
    """A plan with its cases: for each the values of the swept keys, in the order of the dataset's dimensions."""

    plan: SweepPlan
    shape: tuple[int, ...]
    settings: list[dict[str, Any]]
    scenarios: list[Scenario]


@dataclass(frozen=True)
class Outcome:
    """What a sweep gave: the dataset, and how many bases and cases had to be computed for it."""

    dataset: xr.Dataset
    rendered: int
    computed: int


def load_sweep(path: Path, overrides: tuple[str, ...] = ()) -> Sweep:
    """Read a sweep file and make every scenario of it.

    Raises:
        ScenarioError: one line that names the key, the value and what was expected; for a bad case, its values too.
    """
    try:
        plan = SweepPlan.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such sweep file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: not a TOML file ({error})") from None
    except ValidationError as error:
        raise ScenarioError(f"{path}: {explain(error, SweepPlan)}") from None
    base = load_data(plan.scenario, overrides)
    base.setdefault("budget", {})["trials"] = plan.trials
    for key, value in plan.fixed.items():
        set_key(base, key, value)
    beside = plan.side_by_side()
    points = len(next(iter(beside.values()))) if beside else 1
    settings = [
        {**dict(zip(plan.grid, combination, strict=True)), **{key: values[p] for key, values in beside.items()}}
        for combination in itertools.product(*plan.grid.values())
        for p in range(points)
    ]
    shape = (*(len(v) for v in plan.grid.values()), *((points,) if beside else ()))
    return Sweep(plan, shape, settings, [_scenario(base, changes) for changes in settings])


def _scenario(base: dict[str, Any], changes: dict[str, Any]) -> Scenario:
    import copy

    data = copy.deepcopy(base)
    for key, value in changes.items():
        set_key(data, key, value)
    try:
        return validate(data)
    except ScenarioError as error:
        raise ScenarioError(f"case {', '.join(f'{k}={v}' for k, v in changes.items())}: {error}") from None


def run_sweep(
    sweep: Sweep, out: Path, *, resume: bool = False, workers: int | None = None, progress: Progress | None = None
) -> Outcome:
    """Compute every case that the journal beside `out` does not hold yet, and write the dataset to `out`.

    Args:
        resume: go on with an interrupted sweep; without it an unfinished journal is refused.
        workers: processes; default one a core. The result does not depend on it.
        progress: called with the finished cases.

    Raises:
        ValueError: when there is a journal of another sweep, or of this one and `resume` is not set.
    """
    journal = Journal(out.with_name(out.name + ".journal"), digest(sweep))
    records = journal.open(resume)
    todo = [i for i in range(len(sweep.scenarios)) if i not in records]
    rendered = 0
    for index, record, count in _computed(_geometries(sweep, todo), workers):
        journal.append(index, record)
        records[index] = record
        rendered += count
        if progress:
            progress(len(records), len(sweep.scenarios), "sweeping")
    dataset = _dataset(sweep, [records[i] for i in range(len(records))])
    from experiments.files import write_netcdf

    write_netcdf(dataset, out)
    journal.remove()
    return Outcome(dataset, rendered, len(todo))


Case = tuple[int, Scenario]
#: Index of a case, its record, and how many bases were rendered for it.
Result = tuple[int, dict[str, Any], int]


def _geometries(sweep: Sweep, todo: list[int]) -> list[list[Case]]:
    """Cases grouped by what they share of transport."""
    groups: dict[str, list[Case]] = {}
    for index in todo:
        scenario = sweep.scenarios[index]
        groups.setdefault(chain.geometry_digest(scenario), []).append((index, scenario))
    return list(groups.values())


def _computed(geometries: list[list[Case]], workers: int | None) -> Iterator[Result]:
    """Results as they come, from spawned processes or, with one worker, from here.

    The first case of a geometry goes alone, for it renders; the others follow when they can read what it left.
    """
    count = workers if workers is not None else (os.cpu_count() or 1)
    if count <= 1:
        yield from (compute(case) for geometry in geometries for case in geometry)
        return
    executor = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_lone_thread)
    leaders, followers = deque(geometries), deque[Case]()
    running: dict[Future[Result], list[Case]] = {}
    try:
        while leaders or followers or running:
            while len(running) < 2 * count and (leaders or followers):
                if followers:
                    running[executor.submit(compute, followers.popleft())] = []
                else:
                    first, *others = leaders.popleft()
                    running[executor.submit(compute, first)] = others
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                followers.extend(running.pop(future))
                yield future.result()
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def _lone_thread() -> None:
    """One thread for each of renderer, OpenCV and BLAS: the processes share the cores among themselves."""
    import cv2

    cv2.setNumThreads(1)
    from scenes.llvm import activate_variant

    if activate_variant().startswith("llvm"):
        import drjit

        drjit.set_thread_count(1)


def compute(case: Case) -> Result:
    """Record of one case; where it cannot be computed, the reason."""
    index, scenario = case
    store = TransportCache(default_folder())
    try:
        record = _case(scenario, store)
    except Exception as error:  # recorded, so that one impossible case does not end ten thousand
        record = {"reason": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    return index, record, store.rendered


def _case(scenario: Scenario, store: TransportCache) -> dict[str, Any]:
    basis = store.basis(chain.view(scenario), chain.quality(scenario))
    light = scenario.light
    rate = chain.electron_rate(scenario, basis, light)
    budget = chain.link_budget_beside(scenario, light, rate)
    seconds = chain.exposure_s(scenario, budget, scenario.exposure_s)
    [drawn] = trials.draw(scenario, rate, light, [seconds])
    known = trials.known_values(scenario, light, budget, rate, [seconds])
    values = {**{name: value for name, [value] in known.items()}, **drawn.values, "px_per_bit": budget.px_per_bit}
    return {"values": {k: float(v) for k, v in values.items()}, "reason": drawn.features.reason or ""}


def digest(sweep: Sweep) -> str:
    """Hash of every scenario of a sweep, 16 hexadecimal digits."""
    import hashlib

    return hashlib.sha256("".join(s.digest() for s in sweep.scenarios).encode()).hexdigest()[:16]


def _dataset(sweep: Sweep, records: list[dict[str, Any]]) -> xr.Dataset:
    plan, beside = sweep.plan, sweep.plan.side_by_side()
    dims = (*plan.grid, *(("case",) if beside else ()))
    units = {**VARIABLES, "px_per_bit": ("pixel", "pixels along a bit's shorter side")}
    data: dict[str, Any] = {}
    for name, (unit, long_name) in units.items():
        values = [record.get("values", {}).get(name, np.nan) for record in records]
        # The exposure that was used, beside the swept key of that name, which may be 'auto'.
        name = "exposure_used_s" if name == "exposure_s" else name
        data[name] = (dims, np.array(values, float).reshape(sweep.shape), {"units": unit, "long_name": long_name})
    reasons = np.array([record["reason"] for record in records], dtype=object).reshape(sweep.shape)
    data["reason"] = (dims, reasons.astype(str), {"long_name": "what is missing and why; empty where nothing is"})
    coordinates: dict[str, Any] = {key: (key, _axis(values), _about(key)) for key, values in plan.grid.items()}
    coordinates |= {key: ("case", _axis(values), _about(key)) for key, values in beside.items()}
    attributes = {
        "Conventions": "CF-1.11",
        "title": sweep.scenarios[0].title,
        "history": "mantis sweep",
        "sweep": plan.model_dump_json(by_alias=True),
        "sweep_hash": digest(sweep),
        **{k: v for k, v in chain.provenance(sweep.scenarios[0]).items() if k in ("software", "versions", "seed")},
    }
    return xr.Dataset(data, coordinates, attributes)


def _axis(values: list[Any]) -> np.ndarray:
    """Coordinate values: numbers where all are numbers, else text."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        return np.array(values)
    return np.array([str(v) for v in values])


def _about(key: str) -> dict[str, str]:
    """Long name and unit of a scenario key, from its description."""
    from experiments.scenario import describe

    text = describe(key.split("."))
    unit = text[text.rfind("[") + 1 : text.rfind("]")] if "]" in text else ""
    return {"long_name": text.rsplit("[", 1)[0].strip() or key, **({"units": unit} if unit else {})}
