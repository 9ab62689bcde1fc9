"""How the margin of a closing set answers to each assumption, and the probability that it closes under all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.chain.statistics import binomial_interval
from experiments.studies.close.constraints import Constraints
from experiments.studies.close.form import ClosedForm
from experiments.studies.close.search import ExposureSchedule, Point, margins, operate, sets_of
from radiometry.geometry import FloatArray

#: Criteria that an exposure which follows the light leaves to the light: it holds saturation where it was.
FOLLOWING = ("cnr", "smear", "sun", "glint", "energy", "power")
#: Criteria that decide a pulse that was set beforehand.
FIXED = ("saturation", "cnr")


@dataclass(frozen=True)
class Bar:
    """One assumption of a tornado: smallest margins of `FOLLOWING` and of `FIXED` at the low and the high end."""

    name: str
    low: float
    high: float
    following: tuple[float, float]
    fixed: tuple[float, float]


@dataclass(frozen=True)
class Tornado:
    """Margins as assumed, and by assumption, the most telling first."""

    following: float
    fixed: float
    bars: tuple[Bar, ...]


@dataclass(frozen=True)
class Probability:
    """Share of drawn worlds in which a set closes, with an exposure that follows the light and with a fixed schedule.

    Attributes:
        label: what differs from the other probabilities.
        draws: worlds drawn.
        following, fixed: share that closes at every range and light; `*_ci95` the ends of its Clopper–Pearson interval.
        by_range: share that closes at each range, (following and fixed, ranges).
        failing: share of worlds in which a criterion fails, following and fixed.
    """

    label: str
    draws: int
    following: float
    following_ci95: tuple[float, float]
    fixed: float
    fixed_ci95: tuple[float, float]
    by_range: FloatArray
    failing: dict[str, tuple[float, float]]


def scheduled(form: ClosedForm, point: Point, constraints: Constraints) -> ExposureSchedule:
    """LEDs and pulses of a set under the assumptions as they are, (lights, ranges)."""
    operating = operate(form, sets_of(form, point), constraints)
    return ExposureSchedule(operating.leds[0], operating.pulse_s[0])


def tornado(form: ClosedForm, point: Point, constraints: Constraints) -> Tornado:
    """Margins with one assumption at a time at either end, the others as assumed."""
    fixed = scheduled(form, point, constraints)

    def least(factors: dict[str, FloatArray]) -> tuple[float, float]:
        sets = sets_of(form, point, factors)
        found = [
            margins(form, sets, constraints, operate(form, sets, constraints, schedule)) for schedule in (None, fixed)
        ]
        return min(float(found[0][n].min()) for n in FOLLOWING), min(float(found[1][n].min()) for n in FIXED)

    bars = []
    for u in constraints.uncertainties:
        low, high = (least({u.key: np.array([value])}) for value in (u.low, u.high))
        bars.append(Bar(u.name, u.low, u.high, (low[0], high[0]), (low[1], high[1])))
    nominal = least({})

    def swing(bar: Bar) -> float:
        ends = np.log([bar.following, bar.fixed])
        return float(np.abs(ends[:, 1] - ends[:, 0]).max())

    return Tornado(*nominal, tuple(sorted(bars, key=swing, reverse=True)))


def probability(
    form: ClosedForm, point: Point, constraints: Constraints, draws: int, rng: np.random.Generator, label: str
) -> Probability:
    """Draw every assumption log-uniformly between its ends and count the worlds in which the set closes."""
    worlds = {
        u.key: np.exp(rng.uniform(np.log(u.low), np.log(u.high), draws)) if u.high > u.low else np.ones(draws)
        for u in constraints.uncertainties
    }
    fixed = scheduled(form, point, constraints)
    closed: list[list[NDArray[np.bool_]]] = [[], []]
    failing: dict[str, list[list[NDArray[np.bool_]]]] = {}
    for part in np.array_split(np.arange(draws), max(1, draws // 500)):
        sets = sets_of(form, point, {k: v[part] for k, v in worlds.items()}).take(np.zeros(len(part), int))
        for how, schedule in enumerate((None, fixed)):
            found = margins(form, sets, constraints, operate(form, sets, constraints, schedule))
            ok = np.ones((len(part), len(form.ranges_m)), bool)
            for name, margin in found.items():
                passed = np.all(np.broadcast_to(margin, (len(part), *margin.shape[1:])) >= 1, axis=1)
                failing.setdefault(name, [[], []])[how].append(~np.all(passed, axis=1))
                ok &= passed
            closed[how].append(ok)
    by_range = [np.concatenate(parts) for parts in closed]
    shares = [float(ok.all(axis=1).mean()) for ok in by_range]
    return Probability(
        label=label,
        draws=draws,
        following=shares[0],
        following_ci95=interval(shares[0], draws),
        fixed=shares[1],
        fixed_ci95=interval(shares[1], draws),
        by_range=np.array([ok.mean(axis=0) for ok in by_range]),
        failing={
            n: (float(np.concatenate(f[0]).mean()), float(np.concatenate(f[1]).mean())) for n, f in failing.items()
        },
    )


def interval(share: float, draws: int) -> tuple[float, float]:
    """Exact 95 % interval of a share of draws."""
    low, high = binomial_interval(round(share * draws), draws)
    return float(low), float(high)
