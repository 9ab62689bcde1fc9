"""The closed-form budget over any scenario keys as a labelled dataset: no rendering, some hundredths of a second a case."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from experiments.chain.case import Case
from experiments.chain.link_budget import LinkBudget, solve_exposure
from experiments.chain.provenance import provenance
from experiments.scenario import KeyValue, Scenario, keys
from radiometry import closure

#: Variable -> unit and long name.
VARIABLES: dict[str, tuple[str, str]] = {
    "seconds": ("s", "exposure"),
    "signal": ("electron", "signal of a bright bit"),
    "background": ("electron", "signal of a neighbouring dark cell"),
    "dark": ("electron", "dark charge"),
    "snr": ("1", "signal-to-noise ratio of a bright bit"),
    "cnr": ("1", "contrast-to-noise ratio of a bit"),
    "full_well_fraction": ("1", "signal of a bright bit over the usable well"),
    "px_per_bit": ("pixel", "pixels along a bit's shorter side"),
    "smear_px": ("pixel", "motion of the target during the exposure"),
    "margin": ("1", "smallest factor by which a criterion is met; below 1 it fails"),
}
#: Criterion of `radiometry.closure` -> variable that it judges; the others need rendered frames.
_JUDGED = {"saturation": "full_well_fraction", "cnr": "cnr", "sampling": "px_per_bit", "smear": "smear_px"}


def closed_form(scenario: Scenario, axes: Mapping[str, Iterable[KeyValue]] | None = None) -> xr.Dataset:
    """Signal, noise ratios, saturation, sampling, smear and the criterion that binds, over all combinations of some keys.

    Args:
        scenario: what the axes do not name.
        axes: values by dotted key, say ``{"range_m": range(1, 21), "leds.count": [20, 100]}``; by default the ranges and
            illuminations of the scenario's budget.

    Returns:
        Dimensions named after the keys; `VARIABLES`, and `binds`, the name of the criterion with the smallest margin. NaN where
        no bit is in the frame. Detection and pose are not judged: they need rendered frames.

    Raises:
        ScenarioError: when a key or value is not one of a scenario.
    """
    if axes is None:
        axes = {"range_m": scenario.budget.ranges_m, "illumination": scenario.budget.illuminations}
    values = {keys.find(key).dotted: list(v) for key, v in axes.items()}
    # The exposure multiplies rates that hold for all: it is walked through inside, whatever its place among the axes.
    outer = [key for key in values if key != "exposure_s"]
    exposures: list[KeyValue] = values.get("exposure_s", [scenario.exposure_s])
    inner = ["exposure_s"] if "exposure_s" in values else []
    shape = [len(values[key]) for key in (*outer, *inner)]
    cases = []
    for combination in itertools.product(*(values[key] for key in outer)):
        here = scenario.with_values(dict(zip(outer, combination, strict=True)))
        budget = Case.of(here).link_budget
        cases += [_case(here.with_values({"exposure_s": exposure}), budget) for exposure in exposures]
    data = {
        name: (
            (*outer, *inner),
            np.array([case[name] for case in cases]).reshape(shape),
            {"units": unit, "long_name": long},
        )
        for name, (unit, long) in VARIABLES.items()
    }
    binds = np.array([case["binds"] for case in cases]).reshape(shape)
    data["binds"] = ((*outer, *inner), binds, {"long_name": "criterion with the smallest margin"})
    dataset = xr.Dataset(data, {key: _coordinate(key, values[key]) for key in values}, {"title": scenario.title})
    return dataset.assign_attrs(provenance(scenario)).transpose(*values)


def _case(scenario: Scenario, budget: LinkBudget) -> dict[str, Any]:
    if np.isnan(budget.signal_rate):
        return {**dict.fromkeys(VARIABLES, np.nan), "px_per_bit": budget.px_per_bit, "binds": "frame"}
    seconds = solve_exposure(scenario, budget, scenario.exposure_s)
    found = {**budget.at(seconds), "seconds": seconds, "px_per_bit": budget.px_per_bit}
    verdicts = closure.judge(scenario.requirement, {name: found[variable] for name, variable in _JUDGED.items()})
    worst = min(verdicts, key=lambda verdict: verdict.margin)
    return {**found, "margin": worst.margin, "binds": worst.name}


def _coordinate(key: str, values: list[KeyValue]) -> tuple[str, list[Any], dict[str, str]]:
    told = keys.find(key)
    labels = [str(v) for v in values] if any(isinstance(v, (str, list, tuple)) for v in values) else values
    attributes = {"long_name": told.name.removesuffix("_m").replace("_", " ")}
    return key, labels, {**attributes, **({"units": told.unit} if told.unit else {})}
