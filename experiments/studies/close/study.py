"""Which parameter sets close the whole range in eclipse and in sunlight.

The closed form searches (`search`), says what the margin depends on (`sensitivity`), how other hardware compares
(`alternatives`) and how far the thesis's own goes (`hardware`); `confirm` renders what is proposed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import product
from typing import Any

import numpy as np

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.close.alternatives import Alternative, alternatives, best
from experiments.studies.close.confirm import Confirmed, confirm, summarise
from experiments.studies.close.constraints import Constraints, Problem
from experiments.studies.close.form import ClosedForm, closed_form
from experiments.studies.close.hardware import Change, hardware_changes
from experiments.studies.close.plan import Plan
from experiments.studies.close.search import Point, SearchResult, operate, sets_of
from experiments.studies.close.sensitivity import Probability, Tornado, probability, tornado


@dataclass(frozen=True)
class ScheduledExposure:
    """Exposure of the recommended set at one range: LEDs, pulse, and the energy of the pulse.

    Attributes:
        illumination: 'eclipse' or 'sunlit', the latter at the phase in which the tape is brightest.
        life: 'new' or 'worn'.
    """

    range_m: float
    illumination: str
    life: str
    leds: int
    pulse_s: float
    energy_j: float


@dataclass(frozen=True)
class ClosureResult:
    """What the search found, and what the rendered frames say of it.

    Attributes:
        base: the scenario as new.
        proposed: sets to confirm, the recommended one first.
        by_tape: the cheapest closing set of every tape; None where none closes.
        schedule: exposures of the recommended set.
        alternatives: the search around other hardware, the scenario's own first.
        best: of these the one with the largest margin that light decides.
        probabilities: of the recommended set, as it is first, and of those of other hardware.
        hardware: the thesis's own hardware, as it was operated and changed.
        minimal: the smallest allowed change that closes every range.
        records: every rendered case, see `confirm.confirm`; empty where nothing was rendered.
        made: what made it, see `chain.provenance`.
    """

    constraints: Constraints
    base: Scenario
    form: ClosedForm
    found: SearchResult
    proposed: tuple[Point, ...]
    by_tape: dict[str, Point | None]
    schedule: tuple[ScheduledExposure, ...]
    alternatives: tuple[Alternative, ...]
    best: Alternative | None
    tornado: Tornado | None
    probabilities: tuple[Probability, ...]
    hardware: tuple[Change, ...]
    minimal: Change | None
    records: tuple[dict[str, Any], ...] = ()
    made: dict[str, str | float] = field(default_factory=dict)

    @property
    def recommended(self) -> Point | None:
        """The recommended set."""
        return self.proposed[0] if self.proposed else None

    @property
    def scenario(self) -> Scenario:
        """The recommended set's scenario in the state that was searched for; the base scenario where nothing closes."""
        if self.recommended is None:
            return self.base
        return self.recommended.scenario(self.base, self.constraints, self.constraints.end_of_life)

    @property
    def confirmed(self) -> list[Confirmed]:
        """What the rendered frames say of each set."""
        return summarise(list(self.records))

    @property
    def to_confirm(self) -> tuple[tuple[Point, Scenario], ...]:
        """The proposed sets, that of the best hardware and the smallest change of the thesis's own, each with its scenario."""
        chosen = {p.label: (p, self.base) for p in self.proposed}
        if self.best and self.best.recommended:
            chosen.setdefault(self.best.recommended.label, (self.best.recommended, self.best.base))
        if self.minimal and self.minimal.point:
            chosen.setdefault(self.minimal.point.label, (self.minimal.point, self.base))
        return tuple(chosen.values())


def run(problem: Problem, plan: Plan, progress: Progress | None = None, workers: int | None = None) -> ClosureResult:
    """Search in closed form, then render what is proposed; `workers` processes draw the noise."""
    constraints = coarse(problem.constraints) if plan.coarse else problem.constraints
    result = search_all(constraints, problem.base, plan.draws)
    chosen = result.to_confirm
    if plan.coarse and len(chosen) > 1:
        chosen = (chosen[0], chosen[-1])
    records = confirm(chosen, constraints, progress, workers) if chosen and plan.render else []
    history = f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis close"
    return replace(result, records=tuple(records), made={**chain.provenance(result.scenario), "history": history})


def coarse(constraints: Constraints) -> Constraints:
    """The same search with a coarser confirmation: three ranges, two noise draws, the first view."""
    ranges = constraints.ranges_m
    picked = tuple(sorted({ranges[0], ranges[len(ranges) // 4], ranges[-1]}))
    first = constraints.confirm.views[0].model_copy(update={"ranges_m": picked})
    confirmation = constraints.confirm.model_copy(update={"views": (first,), "trials": 2})
    return constraints.model_copy(update={"confirm": confirmation})


def search_all(constraints: Constraints, base: Scenario, draws: int) -> ClosureResult:
    """All that the closed form says: search, other hardware, exposures, sensitivity, probability and the thesis's hardware.

    Args:
        constraints: what may be changed, and how far.
        base: the scenario as new.
        draws: worlds drawn for a probability of closure.
    """
    others = alternatives(constraints, base)
    form, found = others[0].form, others[0].found
    proposed = found.proposed()
    by_tape = {
        tape: min((p for p in found.closing if p.tape == tape), key=lambda p: p.power_w, default=None)
        for tape in constraints.tapes
    }
    hardware, minimal = hardware_changes(constraints, base)
    result = ClosureResult(
        constraints=constraints,
        base=base,
        form=form,
        found=found,
        proposed=proposed,
        by_tape=by_tape,
        schedule=(),
        alternatives=others,
        best=best(others) if any(a.recommended for a in others) else None,
        tornado=None,
        probabilities=(),
        hardware=hardware,
        minimal=minimal,
    )
    if not proposed:
        return result
    first = proposed[0]
    new = closed_form(base, constraints, False, sizes_m=(first.size_m,))
    states = {"worn" if constraints.end_of_life else "new": form, "new": new}
    return replace(
        result,
        schedule=_schedule(states, first, constraints),
        tornado=tornado(form, first, constraints),
        probabilities=_probabilities(others, constraints, base.seed, draws),
    )


def _probabilities(
    others: tuple[Alternative, ...], constraints: Constraints, seed: int, draws: int
) -> tuple[Probability, ...]:
    """Of the recommended set, of it with the fewest LEDs that close, and of that of each other hardware."""
    own, first = others[0], others[0].recommended
    assert first is not None
    counts = dict.fromkeys((first.led_count, first.fewest_leds))
    variants = [(f"{n} LEDs", own.form, replace(first, led_count=n)) for n in counts]
    variants += [(a.name, a.form, a.recommended) for a in others[1:] if a.recommended]
    return tuple(
        # The same worlds for each: what differs is the hardware alone.
        probability(form, point, constraints, draws, np.random.default_rng((seed, draws)), label)
        for label, form, point in variants
    )


def _schedule(states: dict[str, ClosedForm], point: Point, constraints: Constraints) -> tuple[ScheduledExposure, ...]:
    """Exposures of a set in eclipse and in the brightest Sun at every range, by the state of the materials."""
    result = []
    for life, form in states.items():
        operating = operate(form, sets_of(form, point), constraints)
        light_time = operating.pulse_s[0, 1:].sum(axis=1) * operating.leds[0, 1:].sum(axis=1)
        brightest = int(np.argmin(light_time)) + 1
        cases = (("eclipse", 0), ("sunlit", brightest))
        for (illumination, k), (r, range_m) in product(cases, enumerate(form.ranges_m)):
            leds, pulse, energy = (float(a[0, k, r]) for a in (operating.leds, operating.pulse_s, operating.energy_j))
            result.append(ScheduledExposure(float(range_m), illumination, life, int(leds), pulse, energy))
    return tuple(result)
