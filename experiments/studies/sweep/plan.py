"""What to sweep: a file that names scenario keys and their values, and every scenario that it stands for."""

from __future__ import annotations

import copy
import hashlib
import itertools
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from experiments.scenario import (
    Scenario,
    ScenarioError,
    apply_override,
    explain,
    load_data,
    set_key,
    shipped_scenarios,
    validate,
)
from experiments.scenario import (
    json_schema as scenario_schema,
)
from experiments.studies.sweep.window import windowed

Values = Annotated[list[Any], Field(min_length=1)]


def _flat(keys: Any) -> Any:
    """Keys with their dots, also where a file has them without quotation marks, as nested tables."""
    if not isinstance(keys, dict):
        return keys
    flat: dict[str, Any] = {}
    for key, value in keys.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{inner}": v for inner, v in _flat(value).items()}
        else:
            flat[key] = value
    return flat


class Sample(BaseModel):
    """Quasi-random points in a box of scenario keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["sobol", "latin_hypercube"] = Field("sobol", description="sequence of scipy.stats.qmc")
    count: Annotated[int, Field(ge=1, le=1_000_000, strict=True)] = Field(
        description="points; a power of two suits Sobol"
    )
    seed: Annotated[int, Field(ge=0, strict=True)] = Field(1, description="seed of the sequence's scrambling")
    ranges: dict[str, tuple[float, float]] = Field(description="[low, high] by scenario key", min_length=1)

    @field_validator("ranges", mode="before")
    @classmethod
    def _dotted(cls, keys: Any) -> Any:
        return _flat(keys)

    @model_validator(mode="after")
    def _low_before_high(self) -> Sample:
        for key, (low, high) in self.ranges.items():
            if not low < high:
                raise ValueError(f"sample.ranges.{key}: [{low:g}, {high:g}], expected [low, high] with low < high")
        return self


class SweepPlan(BaseModel):
    """What to sweep. Keys are scenario keys, dotted: range_m, leds.count, sun.phase_deg and so on."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    scenario: str | None = Field(
        None,
        description="base scenario: a file, looked for beside the sweep file, or a shipped name; default the default one",
    )
    trials: Annotated[int, Field(ge=2, le=100_000, strict=True)] = Field(16, description="noise draws of every case")
    window: Annotated[float, Field(ge=1.5, le=1000, allow_inf_nan=False, strict=True)] | None = Field(
        None,
        description="expose and search only this many times the marker's extent about the optical axis, as a tracker does; "
        "absent: the whole frame",
    )
    fixed: dict[str, Any] = Field(default_factory=dict, alias="set", description="changes to the base scenario")
    grid: dict[str, Values] = Field(default_factory=dict, description="values by key; all combinations are run")
    cases: dict[str, Values] = Field(default_factory=dict, alias="list", description="values by key, run side by side")
    sample: Sample | None = Field(None, description="quasi-random points")

    @field_validator("fixed", "grid", "cases", mode="before")
    @classmethod
    def _dotted(cls, keys: Any) -> Any:
        return _flat(keys)

    @model_validator(mode="after")
    def _something_to_sweep(self) -> SweepPlan:
        if not (self.grid or self.cases or self.sample):
            raise ValueError("a sweep needs [grid], [list] or [sample]")
        if self.cases and self.sample:
            raise ValueError("[list] and [sample] exclude each other")
        if len({len(v) for v in self.cases.values()}) > 1:
            raise ValueError("list: every key needs as many values as the others")
        keys = self.swept
        twice = {key for key in keys if keys.count(key) > 1}
        if twice:
            raise ValueError(f"{', '.join(sorted(twice))}: swept twice")
        for key, values in self.grid.items():
            if len({repr(v) for v in values}) < len(values):
                raise ValueError(f"grid.{key}: a value occurs twice")
        both = sorted(set(keys) & set(self.fixed))
        if both:
            raise ValueError(f"set.{both[0]}: swept as well; expected one or the other")
        return self

    @property
    def swept(self) -> list[str]:
        """Keys that vary, in the order of the file."""
        return [*self.grid, *self.cases, *(self.sample.ranges if self.sample else {})]

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

    def digest(self) -> str:
        """Hash of every scenario, 16 hexadecimal digits."""
        return hashlib.sha256("".join(s.digest() for s in self.scenarios).encode()).hexdigest()[:16]


def json_schema() -> dict[str, Any]:
    """JSON schema of a sweep file, for an editor to complete and check: every scenario key where keys are named."""
    scenario = scenario_schema()
    schema = SweepPlan.model_json_schema(by_alias=True)
    plan, sample = schema["properties"], schema["$defs"]["Sample"]["properties"]
    pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    for place, of_value in (
        (plan["set"], lambda value: value),
        (plan["grid"], lambda value: {"type": "array", "items": value, "minItems": 1}),
        (plan["list"], lambda value: {"type": "array", "items": value, "minItems": 1}),
        (sample["ranges"], lambda value: pair),
    ):
        place.update(properties=_every_key(scenario, of_value), additionalProperties=False)
    return {
        **schema,
        "title": "Mantis sweep",
        "$schema": scenario["$schema"],
        "$defs": {**scenario["$defs"], **schema["$defs"]},
    }


def _every_key(scenario: dict[str, Any], of_value: Callable[[dict[str, Any]], dict[str, Any]]) -> dict[str, Any]:
    """Properties for every scenario key: dotted in quotation marks, or nested as TOML reads them without."""
    keys: dict[str, Any] = {}

    def described(value: dict[str, Any]) -> dict[str, Any]:
        return {**of_value(value), "description": value.get("description", "")}

    for name, value in scenario["properties"].items():
        options = (value, *value.get("anyOf", ()), *value.get("allOf", ()))
        section = next((o["$ref"].rsplit("/", 1)[1] for o in options if "$ref" in o), None)
        if section is None:
            keys[name] = described(value)
            continue
        inner = {key: described(v) for key, v in scenario["$defs"][section]["properties"].items()}
        keys[name] = {"type": "object", "properties": inner, "additionalProperties": False}
        keys |= {f"{name}.{key}": v for key, v in inner.items()}
    return keys


def load_sweep(path: Path, overrides: tuple[str, ...] = ()) -> Sweep:
    """Read a sweep file and make every scenario of it.

    Args:
        path: the TOML file.
        overrides: ``key=value`` changes to the base scenario; they win over the file's [set].

    Raises:
        ScenarioError: one line that names the key, the value and what was expected; for a bad case, its values too.
    """
    try:
        plan = SweepPlan.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such sweep file") from None
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: not a TOML file ({error})") from None
    except ValidationError as error:
        raise ScenarioError(f"{path}: {explain(error, SweepPlan)}") from None
    swept = {part.partition("=")[0].strip() for part in overrides} & set(plan.swept)
    if swept:
        raise ScenarioError(f"--set {min(swept)}: the sweep file varies it; expected a key that it does not")
    return make_sweep(plan, _base(plan, path.parent, overrides))


def make_sweep(plan: SweepPlan, base: dict[str, Any]) -> Sweep:
    """Every scenario of a plan about the plain data of a base scenario.

    Raises:
        ScenarioError: as `load_sweep`.
    """
    beside = plan.side_by_side()
    points = len(next(iter(beside.values()))) if beside else 1
    settings = [
        {**dict(zip(plan.grid, combination, strict=True)), **{key: values[p] for key, values in beside.items()}}
        for combination in itertools.product(*plan.grid.values())
        for p in range(points)
    ]
    shape = (*(len(v) for v in plan.grid.values()), *((points,) if beside else ()))
    return Sweep(plan, shape, settings, [_scenario(base, changes, plan.window) for changes in settings])


def _base(plan: SweepPlan, folder: Path, overrides: tuple[str, ...]) -> dict[str, Any]:
    """The base scenario's data: its file, the plan's trials and [set], then the command line's changes."""
    source = plan.scenario
    if source is not None and source not in shipped_scenarios():
        source = str(folder / source)
    data = load_data(source)
    data.setdefault("budget", {})["trials"] = plan.trials
    for key, value in plan.fixed.items():
        set_key(data, key, value)
    for override in overrides:
        apply_override(data, override)
    return data


def _scenario(base: dict[str, Any], changes: dict[str, Any], window: float | None) -> Scenario:
    data = copy.deepcopy(base)
    try:
        for key, value in changes.items():
            set_key(data, key, value)
        scenario = validate(data)
        return scenario if window is None else windowed(scenario, window)
    except ScenarioError as error:
        raise ScenarioError(f"case {', '.join(f'{k}={v}' for k, v in changes.items())}: {error}") from None
