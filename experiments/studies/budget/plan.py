"""How much of a scenario's own plan, its table [budget], a run walks through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.scenario import Scenario

#: Fewest rays about the marker that `Plan.thinned` leaves.
MIN_MARKER_RAYS = 10_000


@dataclass(frozen=True)
class Plan:
    """What is left of the ranges, noise draws and rays that a scenario names; illuminations and exposures stay as they are.

    Attributes:
        ranges: ranges at most, the first and the last among them and closer together near the camera; None keeps all.
        trials: noise draws at most; None keeps all.
        ray_divisor: the rays about the marker are divided by this.
    """

    ranges: int | None = None
    trials: int | None = None
    ray_divisor: int = 1

    def thinned(self, scenario: Scenario) -> Scenario:
        """The scenario with as much of its plan as this one keeps."""
        budget, render = scenario.budget, scenario.render
        ranges, trials = budget.ranges_m, budget.trials
        if self.ranges is not None:
            indices = np.linspace(0, np.sqrt(len(ranges) - 1), self.ranges) ** 2
            ranges = tuple(ranges[i] for i in sorted({round(index) for index in indices}))
        if self.trials is not None:
            trials = min(self.trials, trials)
        rays = max(MIN_MARKER_RAYS, render.marker_rays // self.ray_divisor)
        return scenario.at(
            budget=budget.model_dump() | {"ranges_m": ranges, "trials": trials},
            render=render.model_dump() | {"marker_rays": rays},
        )


FULL = Plan()
QUICK = Plan(ranges=7, trials=8, ray_divisor=4)
