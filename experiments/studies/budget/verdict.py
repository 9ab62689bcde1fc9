"""The verdict on a budget in plain words: where it closes, what fails by how much, and what would help."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from experiments.reporting.formatting import ILLUMINATION_NAMES, factor, listed, ranges_text
from experiments.scenario import Scenario
from experiments.studies.budget.advice import advise
from experiments.studies.budget.criteria import EXPOSURE_CRITERIA, MEASURES
from experiments.studies.budget.study import shown_exposure
from radiometry.closure import CRITERIA, judge


@dataclass(frozen=True)
class Shortfall:
    """One criterion that fails at one range; `margin` is the factor by which it is met, 0 where nothing was measured."""

    criterion: str
    range_m: float
    value: float
    limit: float
    margin: float
    text: str


@dataclass(frozen=True)
class CaseVerdict:
    """One illumination and exposure over all ranges.

    Attributes:
        shown: whether this is the exposure that the verdict is about, `study.shown_exposure`.
        ranges_m, closing_m: the ranges judged, and those where every criterion is met.
        shortfalls: by range, then by criterion.
        text: where it closes, in words.
        failures: a line for each failing criterion: at which ranges, and the worst of them.
    """

    illumination: str
    exposure: str
    shown: bool
    ranges_m: tuple[float, ...]
    closing_m: tuple[float, ...]
    shortfalls: tuple[Shortfall, ...]
    text: str
    failures: tuple[str, ...]

    @property
    def closes(self) -> bool:
        """True where every criterion is met at every range."""
        return len(self.closing_m) == len(self.ranges_m)

    def failing_at(self, range_m: float) -> list[str]:
        """Names of what fails at one range, without what only could not be measured because no frame gave a pose."""
        here = [s for s in self.shortfalls if s.range_m == range_m]
        measured = [s for s in here if not np.isnan(s.value)]
        return [MEASURES[s.criterion].name for s in measured or here]


@dataclass(frozen=True)
class Summary:
    """The verdict of a budget.

    Attributes:
        closes: whether every illumination closes at every range with the shown exposure.
        headline: one sentence.
        cases: every illumination and exposure, in each illumination the shown exposure first.
        advice: what to change and what the frames show, in the order in which the criteria bind.
    """

    closes: bool
    headline: str
    cases: tuple[CaseVerdict, ...]
    advice: tuple[str, ...]

    @property
    def shown(self) -> list[CaseVerdict]:
        """The cases of the shown exposure, one an illumination."""
        return [case for case in self.cases if case.shown]


def summarise(dataset: xr.Dataset, scenario: Scenario) -> Summary:
    """The verdict on a budget's dataset, with advice from its closed forms.

    Args:
        dataset: of `study.run`.
        scenario: the one it was made from.
    """
    shown = shown_exposure(scenario)
    exposures = sorted(range(dataset.sizes["exposure"]), key=lambda i: i != shown)
    cases = tuple(
        _case(dataset.sel(illumination=illumination).isel(exposure=i), scenario, i == shown)
        for illumination in scenario.budget.illuminations
        for i in exposures
    )
    return Summary(
        all(case.closes for case in cases if case.shown),
        _headline([case for case in cases if case.shown]),
        cases,
        advise(dataset, scenario, shown, {s.criterion for case in cases if case.shown for s in case.shortfalls}),
    )


def exposure_name(label: str) -> str:
    """'auto exposure' or '1 ms'."""
    return "auto exposure" if label == "auto" else label


def _case(here: xr.Dataset, scenario: Scenario, shown: bool) -> CaseVerdict:
    illumination, label = str(here.illumination.values), str(here.exposure.values)
    ranges = tuple(float(r) for r in here.range_m.values)
    closing = tuple(r for r, ok in zip(ranges, here.closes.values, strict=True) if ok)
    shortfalls = []
    for i, range_m in enumerate(ranges):
        values = {name: float(here[m.variable].values[i]) for name, m in MEASURES.items()}
        shortfalls += [
            Shortfall(v.name, range_m, v.value, v.limit, v.margin, _shortfall_text(v.name, v.value, v.limit))
            for v in judge(scenario.requirement, values)
            if not v.passed
        ]
    failing = [name for name in CRITERIA if any(s.criterion == name for s in shortfalls)]
    if not shown and any(name in EXPOSURE_CRITERIA for name in failing):
        failing = [name for name in failing if name in EXPOSURE_CRITERIA]  # the frames follow from them
    where = "every range" if len(closing) == len(ranges) else ranges_text(ranges, closing)
    return CaseVerdict(
        illumination=illumination,
        exposure=label,
        shown=shown,
        ranges_m=ranges,
        closing_m=closing,
        shortfalls=tuple(shortfalls),
        text=f"{ILLUMINATION_NAMES[illumination].capitalize()}, {exposure_name(label)}: closes at {where}.",
        failures=tuple(_failure_text(ranges, [s for s in shortfalls if s.criterion == name]) for name in failing),
    )


def _shortfall_text(name: str, value: float, limit: float) -> str:
    """'1.03 px/bit, 2 needed, short by ×1.9'."""
    if np.isnan(value):
        return "no pose to measure" if name in ("attitude", "range") else "bits outside the frame"
    at_least = CRITERIA[name][1]
    text = f"{MEASURES[name].say(value)}, {MEASURES[name].say_limit(limit)} {'needed' if at_least else 'allowed'}"
    if at_least:
        return text if value <= 0 else f"{text}, short by {factor(limit / value)}"
    return f"{text}, over by {factor(value / limit)}"


def _failure_text(ranges_m: tuple[float, ...], failing: list[Shortfall]) -> str:
    """Where one criterion fails and the worst that was measured: 'Sampling fails at 11–20 m, worst at 20 m: 1.03 px/bit, ...'."""
    name = MEASURES[failing[0].criterion].name
    lead = f"{name[0].upper()}{name[1:]} fails at {ranges_text(ranges_m, [s.range_m for s in failing])}"
    measured = [s for s in failing if not np.isnan(s.value)]
    if not measured:
        return f"{lead}: {failing[0].text}"
    worst = min(measured, key=lambda s: s.margin)
    place = f", worst at {worst.range_m:g} m" if len(failing) > 1 else ""
    unseen = [s.range_m for s in failing if np.isnan(s.value)]
    text = f"{lead}{place}: {worst.text}"
    return f"{text}; no pose to measure at {ranges_text(ranges_m, unseen)}" if unseen else text


def _headline(shown: list[CaseVerdict]) -> str:
    ranges = shown[0].ranges_m
    span = f"at {ranges[0]:g} m" if len(ranges) == 1 else f"over {ranges[0]:g}–{ranges[-1]:g} m"
    exposure = "auto exposure" if shown[0].exposure == "auto" else f"an exposure of {shown[0].exposure}"
    everywhere = listed([ILLUMINATION_NAMES[case.illumination] for case in shown])
    if all(case.closes for case in shown):
        return f"The budget closes {span} in {everywhere}, with {exposure}."
    where = [ranges_text(ranges, case.closing_m) for case in shown]
    if len(set(where)) == 1:
        places = f"{where[0]} in {everywhere}"
    else:
        places = listed([f"{w} in {ILLUMINATION_NAMES[c.illumination]}" for w, c in zip(where, shown, strict=True)])
    names = [m.name for key, m in MEASURES.items() if any(s.criterion == key for c in shown for s in c.shortfalls)]
    return f"The budget does not close {span}. With {exposure} it closes at {places}; what fails: {listed(names)}."
