"""How many scenes the Monte Carlo draws, and at which ranges."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """Scenes by part of the study.

    Attributes:
        ranges_m: of the performance and of the two laws of noise [m].
        per_range: scenes at each range, there and out to 100 m; the thesis's 1500 (its section 3.7).
        convergence: scenes over which means and outliers are followed.
        tried: scenes of each layout and range for the table of every solver that was tried.
        single: scenes of a single marker in each case.
    """

    ranges_m: tuple[float, ...]
    per_range: int
    convergence: int
    tried: int
    single: int


FULL = Plan(ranges_m=tuple(float(r) for r in range(1, 21)), per_range=1500, convergence=2500, tried=200, single=1000)
#: A fiftieth of the scenes, at four ranges.
QUICK = Plan(ranges_m=(1.0, 5.0, 10.0, 20.0), per_range=30, convergence=100, tried=1, single=30)
