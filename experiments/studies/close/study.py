"""Which parameter sets close the whole range in eclipse and in sunlight: all that the closed form says.

The search (`search`), the exposure ladder, what the margin hangs on (`sensitivity`), and how far the thesis's own
hardware goes. `confirm` renders what is proposed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from experiments.scenario import Scenario
from experiments.studies.close.alternatives import Alternative, alternatives, best
from experiments.studies.close.constraints import Constraints
from experiments.studies.close.form import ClosedForm, Sets, closed_form
from experiments.studies.close.search import Found, Ladder, Point, fly, margins, points, sets_of
from experiments.studies.close.sensitivity import Probability, Tornado, probability, tornado

#: Worlds drawn for a probability of closure.
DRAWS, QUICK_DRAWS = 4000, 500
#: The thesis's exposures (section 6.2) in eclipse and in sunlight [s].
THESIS_EXPOSURE_S = (1 / 30, 1e-3)


@dataclass(frozen=True)
class Rung:
    """One range of the exposure ladder: LEDs and pulse, and the energy of the pulse.

    Attributes:
        light: 'eclipse' or 'sun', the latter at the phase in which the tape is brightest.
        life: 'new' or 'worn'.
    """

    range_m: float
    illumination: str
    life: str
    leds: int
    pulse_s: float
    energy_j: float


@dataclass(frozen=True)
class Change:
    """A piece of hardware and how far it closes.

    Attributes:
        factor: by which one parameter was changed; 1 for none.
        allowed: whether the constraints allow it.
        closing_m, ranges_m: ranges at which all criteria are met, of those judged.
        failing: criteria that fail, with the factor by which the worst range misses.
        reach_m: farthest range that the sampling criterion allows.
        point: the set, where a search's constraints can express it.
    """

    name: str
    factor: float
    allowed: bool
    closing_m: tuple[float, ...]
    ranges_m: tuple[float, ...]
    failing: dict[str, float]
    reach_m: float
    point: Point | None = None

    @property
    def closes(self) -> bool:
        """True where every range closes."""
        return len(self.closing_m) == len(self.ranges_m)


@dataclass(frozen=True)
class Study:
    """All that the closed form says.

    Attributes:
        base: the scenario as new.
        proposed: sets to confirm, the recommended one first.
        by_tape: the cheapest closing set of every tape; None where none closes.
        rungs: ladder of the recommended set.
        alternatives: the search around other hardware, the scenario's own first.
        best: of these the one with the largest margin that light decides.
        probabilities: of the recommended set, as it is first, and of those of other hardware.
        hardware: the thesis's own hardware, as flown and changed.
        minimal: the smallest allowed change that closes every range.
    """

    constraints: Constraints
    base: Scenario
    form: ClosedForm
    found: Found
    proposed: tuple[Point, ...]
    by_tape: dict[str, Point | None]
    rungs: tuple[Rung, ...]
    alternatives: tuple[Alternative, ...]
    best: Alternative | None
    tornado: Tornado | None
    probabilities: tuple[Probability, ...]
    hardware: tuple[Change, ...]
    minimal: Change | None

    @property
    def lead(self) -> Point | None:
        """The recommended set."""
        return self.proposed[0] if self.proposed else None

    @property
    def to_confirm(self) -> tuple[tuple[Point, Scenario], ...]:
        """The proposed sets, that of the best hardware and the smallest change of the thesis's own, each with its scenario."""
        chosen = {p.label: (p, self.base) for p in self.proposed}
        if self.best and self.best.lead:
            chosen.setdefault(self.best.lead.label, (self.best.lead, self.best.base))
        if self.minimal and self.minimal.point:
            chosen.setdefault(self.minimal.point.label, (self.minimal.point, self.base))
        return tuple(chosen.values())


def quick(constraints: Constraints) -> Constraints:
    """The same search with a coarser confirmation: three ranges, two noise draws, the first view."""
    ranges = constraints.ranges_m
    picked = tuple(sorted({ranges[0], ranges[len(ranges) // 4], ranges[-1]}))
    first = constraints.confirm.views[0].model_copy(update={"ranges_m": picked})
    confirm = constraints.confirm.model_copy(update={"views": (first,), "trials": 2})
    return constraints.model_copy(update={"confirm": confirm})


def study(constraints: Constraints, base: Scenario, draws: int = DRAWS) -> Study:
    """Search, other hardware, ladder, sensitivity, probability and the thesis's hardware, all in closed form."""
    end = constraints.end_of_life
    others = alternatives(constraints, base)
    own = others[0]
    form, found = own.form, own.found
    proposed = found.proposed()
    by_tape = {
        tape: min((p for p in found.closing if p.tape == tape), key=lambda p: p.power_w, default=None)
        for tape in constraints.tapes
    }
    hardware, minimal = _hardware(constraints, base)
    if not proposed:
        lead_less = best(others) if any(a.lead for a in others) else None
        return Study(constraints, base, form, found, (), by_tape, (), others, lead_less, None, (), hardware, minimal)
    lead = proposed[0]
    states = {"worn" if end else "new": form, "new": closed_form(base, constraints, False, sizes_m=(lead.size_m,))}
    return Study(
        constraints, base, form, found, proposed, by_tape, _rungs(states, lead, constraints), others, best(others),
        tornado(form, lead, constraints), _probabilities(others, constraints, base.seed, draws), hardware, minimal,
    )  # fmt: skip


def _probabilities(
    others: tuple[Alternative, ...], constraints: Constraints, seed: int, draws: int
) -> tuple[Probability, ...]:
    """Of the recommended set, of it with the fewest LEDs that close, and of that of each other hardware."""
    own, lead = others[0], others[0].lead
    assert lead is not None
    variants = [
        (f"{n} LEDs", own.form, replace(lead, led_count=n)) for n in dict.fromkeys((lead.led_count, lead.fewest_leds))
    ]
    variants += [(a.name, a.form, a.lead) for a in others[1:] if a.lead]
    return tuple(
        # The same worlds for each: what differs is the hardware alone.
        probability(form, point, constraints, draws, np.random.default_rng((seed, draws)), label)
        for label, form, point in variants
    )


def _rungs(states: dict[str, ClosedForm], lead: Point, constraints: Constraints) -> tuple[Rung, ...]:
    result = []
    for life, form in states.items():
        flown = fly(form, sets_of(form, lead), constraints)
        brightest = int(np.argmin(flown.pulse_s[0, 1:].sum(axis=1) * flown.leds[0, 1:].sum(axis=1))) + 1
        for (illumination, k), (r, range_m) in product(
            (("eclipse", 0), ("sunlit", brightest)), enumerate(form.ranges_m)
        ):
            leds, pulse, energy = (float(a[0, k, r]) for a in (flown.leds, flown.pulse_s, flown.energy_j))
            result.append(Rung(float(range_m), illumination, life, int(leds), pulse, energy))
    return tuple(result)


def _hardware(constraints: Constraints, base: Scenario) -> tuple[tuple[Change, ...], Change | None]:
    """The base scenario's own hardware as the thesis flies it and with an exposure that follows, then one change at a time."""
    tape, size, camera = base.target.tape_material, base.marker.size_m, base.camera
    form = closed_form(base, constraints, constraints.end_of_life, (tape,), (size,))
    own = Sets(
        np.array([0]), np.array([0]), np.array([camera.focal_length_m]), np.array([camera.f_number]),
        np.array([base.leds.count]),
    )  # fmt: skip
    eclipse, sun = THESIS_EXPOSURE_S
    shape = (1 + len(form.phases_deg), len(form.ranges_m))
    thesis = Ladder(
        np.full(shape, float(base.leds.count)),
        np.where(np.arange(shape[0])[:, None] == 0, eclipse, sun) + np.zeros(shape),
    )
    fixed = _change("as the thesis exposes it, 1/30 s and 1 ms", 1.0, True, form, own, constraints, thesis)
    plain = _change("exposure that follows the light", 1.0, True, form, own, constraints)
    k = float(np.ceil(100 * form.ranges_m[-1] / plain.reach_m - 1e-9) / 100)
    changes = [fixed, plain]
    if k > 1:
        longer = replace(own, focal_length_m=own.focal_length_m * k)
        stopped = replace(longer, f_number=longer.f_number * k)
        focal_mm = 1e3 * camera.focal_length_m * k
        wide, finer = (
            closed_form(base, constraints, constraints.end_of_life, (tape,), (size * k,)),
            closed_form(_finer(base, k), constraints, constraints.end_of_life, (tape,), (size,)),
        )
        allowed = size * k <= constraints.marker_over_face_max * base.target.face_m * (1 + 1e-9)
        [point] = points(form, stopped, constraints)
        pitch_um = 1e6 * camera.pixel_pitch_x_m / k
        changes += [
            _change(f"lens of {focal_mm:.1f} mm, same F-number", k, True, form, longer, constraints),
            replace(
                _change(f"lens of {focal_mm:.1f} mm, same pupil", k, True, form, stopped, constraints), point=point
            ),
            _change(f"marker of {100 * size * k:.1f} cm", k, allowed, wide, own, constraints),
            _change(f"pixels of {pitch_um:.1f} µm, same detector area and lens", k, True, finer, own, constraints),
        ]
    closing = [c for c in changes if c.closes and c.allowed]
    return tuple(changes), min(closing, key=lambda c: c.factor, default=None)


def _finer(base: Scenario, k: float) -> Scenario:
    """The base scenario with pixels k times finer on the same area; the lens's point spread stays as wide in micrometres."""
    camera = base.camera
    finer = {
        "width_px": round(camera.width_px * k), "height_px": round(camera.height_px * k),
        "pixel_pitch_x_m": camera.pixel_pitch_x_m / k, "pixel_pitch_y_m": camera.pixel_pitch_y_m / k,
        "psf_sigma_px": camera.psf_sigma_px * k,
    }  # fmt: skip
    return base.at(camera={**camera.model_dump(), **finer})


def _change(
    name: str, factor: float, allowed: bool, form: ClosedForm, sets: Sets, constraints: Constraints,
    flown: Ladder | None = None,
) -> Change:  # fmt: skip
    found = margins(form, sets, constraints, fly(form, sets, constraints, flown))
    least = {n: np.broadcast_to(m, (1, *m.shape[1:])).min(axis=(0, 1)) for n, m in found.items()}
    ok = np.min(list(np.broadcast_arrays(*least.values())), axis=0) >= 1
    ranges = tuple(float(r) for r in form.ranges_m)
    failing = {n: float(m.min()) for n, m in least.items() if m.min() < 1}
    reach = float(form.ranges_m[-1] * found["sampling"][..., -1].min())
    return Change(name, factor, allowed, tuple(r for r, c in zip(ranges, ok, strict=True) if c), ranges, failing, reach)
