"""Figures that the closure page states, worked out once from a result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from experiments.reporting.formatting import listed, number
from experiments.studies.close.alternatives import Alternative
from experiments.studies.close.confirm import Confirmed
from experiments.studies.close.hardware import Change
from experiments.studies.close.search import Point
from experiments.studies.close.sensitivity import Bar, Probability
from experiments.studies.close.study import ClosureResult, ScheduledExposure


@dataclass(frozen=True)
class ScheduleFacts:
    """What the exposures of the recommended set have in common.

    Attributes:
        fewer_m: ranges at which fewer LEDs are on, for the shortest pulse would be too bright.
        brightest_phase_deg: allowed phase of the Sun in which the tape is brightest.
        sun_factor: longest pulse in eclipse over that in this Sun, of all ranges.
        new_factor: energy of a pulse at the end of life over that when new, at most.
        new_full_well: part of full well that new bits reach with the exposures of the end of life.
        pulse_factor: longest over shortest pulse.
    """

    fewer_m: tuple[float, ...]
    brightest_phase_deg: float
    sun_factor: float
    new_factor: float
    new_full_well: float
    pulse_factor: float


@dataclass(frozen=True)
class Sensitive:
    """How the margin answers to single assumptions, for one kind of exposure.

    Attributes:
        margin: smallest margin with everything as assumed.
        most: the assumption that moves it most; None where there is none.
        ends: smallest margins at the two ends of that assumption, the smaller first.
        failing: assumptions that alone take it below 1.
    """

    margin: float
    most: Bar | None
    ends: tuple[float, float]
    failing: tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """What the page says of a search in which something closes.

    Attributes:
        point: the recommended set; `seen` is what its rendered frames say, None where nothing was rendered.
        cheapest: of every tape, its name and the mean power of its cheapest closing set [W], None where none closes.
        follow, fixed: with an exposure that follows the light, and with one that was set beforehand.
        likely, likeliest: probabilities of the recommended set, and the largest of all variants.
        own, best, roomiest: the scenario's own hardware, the one with the largest margin that light decides, and the one that
            closes with the largest share of its sets.
        without: other hardware with which nothing closes.
        as_exposed, following: the thesis's hardware with its own exposures, and with an exposure that follows the light.
        frontal_reach_m: farthest range of that hardware without tilt.
    """

    point: Point
    seen: Confirmed | None
    frame_rate_hz: float
    cheapest: tuple[tuple[str, float | None], ...]
    schedule: ScheduleFacts
    follow: Sensitive
    fixed: Sensitive
    likely: Probability
    likeliest: Probability
    own: Alternative
    best: Alternative
    roomiest: Alternative
    without: tuple[str, ...]
    as_exposed: Change
    following: Change
    frontal_reach_m: float

    @property
    def tapes(self) -> str:
        """The cheapest set by tape, in words."""
        return listed([f"{name} {'none' if w is None else f'{number(1e3 * w)} mW'}" for name, w in self.cheapest])


def facts_of(result: ClosureResult) -> Facts | None:
    """The facts of a result; None where nothing closes."""
    point, limits, best = result.recommended, result.constraints, result.best
    if point is None or best is None:
        return None
    others = result.alternatives
    as_exposed, following = result.hardware[:2]
    return Facts(
        point=point,
        seen=next((c for c in result.confirmed if c.label == point.label), None),
        frame_rate_hz=limits.frame_rate_hz(result.base),
        cheapest=tuple((tape_name(t), p.power_w if p else None) for t, p in result.by_tape.items()),
        schedule=_schedule_facts(result, point),
        follow=_sensitive(result, "following"),
        fixed=_sensitive(result, "fixed"),
        likely=result.probabilities[0],
        likeliest=max(result.probabilities, key=lambda p: p.following),
        own=others[0],
        best=best,
        roomiest=max(others, key=lambda a: len(a.found.closing) / a.found.tried if a.found.tried else 0.0),
        without=tuple(a.name for a in others[1:] if a.recommended is None),
        as_exposed=as_exposed,
        following=following,
        frontal_reach_m=float(following.reach_m / np.cos(np.radians(limits.tilt_deg))),
    )


def tape_name(material: str) -> str:
    """'Type XI' of 'tape_type_xi'."""
    name = material.removeprefix("tape_").removeprefix("type_")
    return f"Type {name.upper()}" if material.startswith("tape_type_") else name.replace("_", " ")


def searched_life(result: ClosureResult) -> str:
    """State of the materials that the search was made for, 'worn' or 'new'."""
    return "worn" if any(exposure.life == "worn" for exposure in result.schedule) else "new"


def _schedule_facts(result: ClosureResult, point: Point) -> ScheduleFacts:
    at = {(e.life, e.illumination, e.range_m): e for e in result.schedule}
    ranges, worn = result.constraints.ranges_m, searched_life(result)

    def exposures(life: str, illumination: str) -> list[ScheduledExposure]:
        return [at[life, illumination, range_m] for range_m in ranges]

    pairs = zip(exposures(worn, "eclipse"), exposures("new", "eclipse"), strict=True)
    brighter = max(old.energy_j / new.energy_j for old, new in pairs)
    sun = max(
        dark.pulse_s / lit.pulse_s
        for life in ("new", worn)
        for dark, lit in zip(exposures(life, "eclipse"), exposures(life, "sunlit"), strict=True)
    )
    pulses = [e.pulse_s for e in result.schedule]
    form = result.form
    phase = int(np.argmax(form.sun_tape.sum(axis=0)[form.tapes.index(point.tape)]))
    return ScheduleFacts(
        fewer_m=tuple(r for r in ranges if any(e.leds < point.led_count for e in result.schedule if e.range_m == r)),
        brightest_phase_deg=float(form.phases_deg[phase]),
        sun_factor=sun,
        new_factor=brighter,
        new_full_well=result.base.auto_exposure.full_well_fraction * brighter,
        pulse_factor=max(pulses) / min(pulses),
    )


def _sensitive(result: ClosureResult, kind: Literal["following", "fixed"]) -> Sensitive:
    tornado = result.tornado
    assert tornado is not None
    follows = kind == "following"
    ends = [(bar.following if follows else bar.fixed, bar) for bar in tornado.bars]
    most = max(ends, key=lambda e: abs(np.log(e[0][1] / e[0][0])), default=None)
    margin = tornado.following if follows else tornado.fixed
    return Sensitive(
        margin=margin,
        most=most[1] if most else None,
        ends=(min(most[0]), max(most[0])) if most else (margin, margin),
        failing=tuple(bar.name for pair, bar in ends if min(pair) < 1),
    )
