"""The conditions of `mantis budget --require`: 'closes', or an illumination and the range up to which the budget must close."""

from __future__ import annotations

from dataclasses import dataclass

from experiments.scenario import Scenario
from experiments.studies.budget.study import BudgetResult, shown_exposure


@dataclass(frozen=True)
class Condition:
    """Where a budget must close.

    Attributes:
        illuminations: those that are asked for.
        range_m: up to which range; infinity for all.
    """

    illuminations: tuple[str, ...]
    range_m: float


def parse(text: str, scenario: Scenario) -> Condition:
    """The condition that a text states: 'closes', or ILLUMINATION:RANGE in metres.

    Raises:
        ValueError: when it is neither, or the scenario's plan does not judge that illumination or range.
    """
    plan = scenario.budget
    if text == "closes":
        return Condition(plan.illuminations, float("inf"))
    illumination, _, limit = text.partition(":")
    try:
        range_m = float(limit)
    except ValueError:
        range_m = float("nan")
    if illumination not in plan.illuminations or not range_m > 0:
        raise ValueError(f"--require {text}: expected 'closes' or ILLUMINATION:RANGE in metres, say eclipse:10")
    nearest, farthest = plan.ranges_m[0], plan.ranges_m[-1]
    if not nearest <= range_m <= farthest:
        raise ValueError(f"--require {text}: budget.ranges_m judges {nearest:g} to {farthest:g} m only")
    return Condition((illumination,), range_m)


def unmet(condition: Condition, result: BudgetResult) -> str:
    """Where the budget does not close with the shown exposure although the condition asks for it; empty where it is met."""
    closes = result.dataset.closes.isel(exposure=shown_exposure(result.scenario))
    failing = [
        f"{float(range_m):g} m in {illumination}"
        for illumination in condition.illuminations
        for range_m in closes.range_m
        if range_m <= condition.range_m and not bool(closes.sel(illumination=illumination, range_m=range_m))
    ]
    return f"the budget does not close at {', '.join(failing)} (exposure {closes.exposure.item()})" if failing else ""
