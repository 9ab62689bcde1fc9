"""The command line's verbs as functions, for notebooks: ``from experiments import api as mantis``.

`load` and `closed_form` need no renderer; `shoot` and `budget` render. Everything else of the project is open as well: see
`experiments.chain` for each stage by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import chain
from experiments.closed_form import closed_form
from experiments.files import read_image
from experiments.scenario import Scenario, load_scenario

__all__ = ["Shot", "budget", "closed_form", "detect", "load", "shoot"]


@dataclass(frozen=True)
class Shot:
    """One exposure of a scenario: the frame, and what detector and pose solver make of it.

    Attributes:
        frame: (height, width) digital numbers.
        exposure_s: its exposure [s].
        sighting: features and pose.
        attitude_error_rad, range_error: of the pose against the scenario's, range relative; NaN without a pose.
    """

    scenario: Scenario
    frame: NDArray[np.uint16]
    exposure_s: float
    sighting: chain.Sighting
    attitude_error_rad: float
    range_error: float

    def _repr_html_(self) -> str:
        from experiments.notebook import shot_html

        return shot_html(self)


def load(source: str | Path | None = None, *overrides: str) -> Scenario:
    """A scenario by file or shipped name, with changes as `--set` takes them: ``load("default", "leds.count=20")``.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    return load_scenario(source, overrides)


def shoot(scenario: Scenario, trial: int = 0) -> Shot:
    """Render, expose and look: the chain of `mantis render`, `expose` and `detect`, transport from the cache where it is there.

    Args:
        scenario: its range, light, exposure and seed say which frame.
        trial: which noise draw of the seed.
    """
    from scenes.cache import TransportCache, default_folder

    basis = TransportCache(default_folder()).basis(chain.view(scenario), chain.quality(scenario))
    rate = chain.electron_rate(scenario, basis, scenario.light)
    seconds = chain.exposure_s(scenario, chain.link_budget_beside(scenario, scenario.light, rate), scenario.exposure_s)
    frame = chain.take_frame(scenario, rate, scenario.light, seconds, trial).dn
    seen = chain.look(scenario, frame)
    return Shot(scenario, frame, seconds, seen, *chain.pose_errors(scenario, seen.pose))


def detect(
    image: NDArray[Any] | str | Path, scenario: Scenario, off: NDArray[Any] | str | Path | None = None
) -> chain.Sighting:
    """Features and pose of an image, an array or a file from anywhere; the scenario says which camera and which marker.

    Args:
        off: a frame without the LEDs, which is subtracted.

    Raises:
        ValueError: when an image cannot be read or is not of the camera's size, or the two are not of one kind.
    """
    seen = read_image(image) if isinstance(image, (str, Path)) else image
    return chain.look(scenario, seen, read_image(off) if isinstance(off, (str, Path)) else off)


def budget(scenario: Scenario, quick: bool = True) -> Any:
    """`mantis budget` as an `experiments.budget.study.BudgetResult`; its `dataset` holds everything.

    Args:
        scenario: what to judge.
        quick: fewer ranges, noise draws and rays.
    """
    from experiments.budget import study

    return study.run_budget(study.quick(scenario) if quick else scenario)
