"""Plain words for a budget: where it closes, what fails by how much, and the smallest change that mends it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from experiments.budget import exposure_label, shown_exposure
from experiments.scenario import Scenario
from radiometry.closure import CRITERIA, judge

LIGHT_NAMES = {"eclipse": "eclipse", "sun": "sunlight"}


@dataclass(frozen=True)
class Measure:
    """How a closure criterion is read from the dataset and said in words."""

    variable: str
    heading: str
    say: Callable[[float], str]


def number(value: float) -> str:
    """Three significant digits, groups of three above a thousand: '0.525', '36.9', '31 700'."""
    if not np.isfinite(value):
        return "–" if np.isnan(value) else "∞"
    digits = float(f"{value:.3g}")
    return f"{digits:,.0f}".replace(",", "\N{NO-BREAK SPACE}") if abs(digits) >= 1000 else f"{digits:.3g}"


def percent(value: float) -> str:
    """A share as a percentage."""
    return "–" if np.isnan(value) else f"{number(100 * value)} %"


#: What the closure criteria are about, in the order in which they bind.
MEASURES: dict[str, Measure] = {
    "saturation": Measure("full_well_fraction", "bright bits / full well", lambda v: f"{number(v)} of full well"),
    "cnr": Measure("cnr_analytic", "CNR", lambda v: f"CNR {number(v)}"),
    "sampling": Measure("px_per_bit", "px/bit", lambda v: f"{number(v)} px/bit"),
    "smear": Measure("smear_px", "smear [px]", lambda v: f"{number(v)} px"),
    "detection": Measure("detected_fraction", "found", lambda v: f"{percent(v)} of frames"),
    "attitude": Measure("attitude_error_p95_deg", "attitude error p95 [°]", lambda v: f"{number(v)}°"),
    "range": Measure("range_error_p95", "range error p95", percent),
}


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
    """One illumination and exposure over all ranges."""

    light: str
    exposure: str
    shown: bool
    closing_m: tuple[float, ...]
    shortfalls: tuple[Shortfall, ...]
    closes: bool
    text: str

    def failing(self, criterion: str) -> list[Shortfall]:
        """The shortfalls of one criterion, over range."""
        return [s for s in self.shortfalls if s.criterion == criterion]

    @property
    def summaries(self) -> list[str]:
        """A line for each failing criterion: at which ranges, and the worst of them."""
        return [_summary(self.failing(name)) for name in CRITERIA if self.failing(name)]


@dataclass(frozen=True)
class Summary:
    """The verdict of a budget.

    Attributes:
        closes: whether every illumination closes at every range with the shown exposure.
        headline: one sentence.
        cases: every illumination and exposure, the shown exposure first in each illumination.
        advice: what to change or to know, the binding criteria first.
    """

    closes: bool
    headline: str
    cases: tuple[CaseVerdict, ...]
    advice: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """The verdict for a terminal, a line a statement."""
        lines = [self.headline]
        for case in self.cases:
            lines.append(f"{case.text}.")
            lines += [f"  {line}" for line in case.summaries] if case.shown else []
        return lines + [f"→ {a}" for a in self.advice]


def summarise(dataset: xr.Dataset, scenario: Scenario) -> Summary:
    """The verdict on a budget's dataset and advice from its closed forms."""
    from experiments.advice import advise

    labels = [exposure_label(e) for e in scenario.budget.exposures_s]
    shown = labels[shown_exposure(scenario)]
    labels.sort(key=lambda label: label != shown)
    lights = [str(v) for v in dataset.light.values]
    cases = tuple(_case(dataset, scenario, light, label, label == shown) for light in lights for label in labels)
    closes = all(case.closes for case in cases if case.shown)
    return Summary(closes, _headline(dataset, cases), cases, advise(dataset, scenario, cases))


def ranges_text(ranges_m: Sequence[float], chosen: Sequence[float]) -> str:
    """Some of a grid of ranges in words: '1–8 and 10 m'. Neighbours on the grid are joined."""
    runs: list[list[float]] = []
    previous = False
    for r in ranges_m:
        if r in chosen:
            if previous:
                runs[-1].append(r)
            else:
                runs.append([r])
        previous = r in chosen
    if not runs:
        return "no range"
    parts = [f"{run[0]:g}" if len(run) == 1 else f"{run[0]:g}–{run[-1]:g}" for run in runs]
    return f"{_listed(parts)} m"


def factor(value: float) -> str:
    """A factor above one as '×1.05', '×1.9', '×45 000'."""
    return f"×{number(float(f'{value:.3g}' if value < 1.1 else f'{value:.2g}'))}"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _case(dataset: xr.Dataset, scenario: Scenario, light: str, label: str, shown: bool) -> CaseVerdict:
    here = dataset.sel(light=light, exposure=label)
    ranges = [float(r) for r in dataset.range_m.values]
    closing = tuple(r for r, ok in zip(ranges, here.closes.values, strict=True) if ok)
    shortfalls = []
    for i, range_m in enumerate(ranges):
        values = {name: float(here[m.variable].values[i]) for name, m in MEASURES.items()}
        for v in judge(scenario.requirement, values):
            if not v.passed:
                shortfalls.append(Shortfall(v.name, range_m, v.value, v.limit, v.margin, _shortfall_text(v.name, v.value, v.limit)))
    exposure = "auto exposure" if label == "auto" else label
    closes = len(closing) == len(ranges)
    where = "every range" if closes else ranges_text(ranges, closing)
    text = f"{LIGHT_NAMES[light].capitalize()}, {exposure}: closes at {where}"
    if not shown and shortfalls:
        text += "; " + "; ".join(_summary([s for s in shortfalls if s.criterion == n]) for n in _causes(shortfalls))
    return CaseVerdict(light, label, shown, closing, tuple(shortfalls), closes, text)


def _causes(shortfalls: list[Shortfall]) -> list[str]:
    """Failing criteria of the closed form; those of the frames only where the closed form holds."""
    names = [name for name in CRITERIA if any(s.criterion == name for s in shortfalls)]
    closed_form = [name for name in names if name not in ("detection", "attitude", "range", "sampling")]
    return closed_form or names


def _shortfall_text(name: str, value: float, limit: float) -> str:
    """'1.03 px/bit, 2 needed, short by ×1.9'."""
    if np.isnan(value):
        return "no pose to measure" if name in ("attitude", "range") else "not in the frame"
    at_least = CRITERIA[name][1]
    bound = {"detection": percent, "range": percent}.get(name, number)(limit) + ("°" if name == "attitude" else "")
    text = f"{MEASURES[name].say(value)}, {bound} {'needed' if at_least else 'allowed'}"
    if at_least and value <= 0:
        return text
    return f"{text}, {'short' if at_least else 'over'} by {factor(limit / value if at_least else value / limit)}"


def _summary(failing: list[Shortfall]) -> str:
    """Where one criterion fails, and the worst that was measured."""
    name = failing[0].criterion
    where = ranges_text([s.range_m for s in failing], [s.range_m for s in failing]) if len(failing) == 1 else None
    if where is None:
        where = f"{len(failing)} ranges from {failing[0].range_m:g} to {failing[-1].range_m:g} m"
    measured = [s for s in failing if not np.isnan(s.value)]
    if not measured:
        return f"{name} fails at {where}: {failing[0].text}"
    worst = min(measured, key=lambda s: s.margin)
    if len(failing) == 1:
        return f"{name} fails at {where}: {worst.text}"
    unseen = len(failing) - len(measured)
    more = f"; at {unseen} of them no pose to measure" if unseen and name in ("attitude", "range") else ""
    return f"{name} fails at {where}: worst {worst.text}, at {worst.range_m:g} m{more}"


def _headline(dataset: xr.Dataset, cases: tuple[CaseVerdict, ...]) -> str:
    ranges = [float(r) for r in dataset.range_m.values]
    span = f"at {ranges[0]:g} m" if len(ranges) == 1 else f"over {ranges[0]:g}–{ranges[-1]:g} m"
    shown = [case for case in cases if case.shown]
    exposure = "auto exposure" if shown[0].exposure == "auto" else f"exposures of {shown[0].exposure}"
    if all(case.closes for case in shown):
        return f"The budget closes {span} in {_listed([LIGHT_NAMES[c.light] for c in shown])}, with {exposure}."
    where = [ranges_text(ranges, case.closing_m) for case in shown]
    if len(set(where)) == 1:
        text = f"{where[0]} in {_listed([LIGHT_NAMES[c.light] for c in shown])}"
    else:
        text = _listed([f"{w} in {LIGHT_NAMES[c.light]}" for w, c in zip(where, shown, strict=True)])
    names = [name for name in CRITERIA if any(case.failing(name) for case in shown)]
    return f"The budget does not close {span}: with {exposure} it closes at {text}. What fails: {_listed(names)}."
