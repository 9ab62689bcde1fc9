"""The command line's verbs as functions, for notebooks: ``from experiments import api as mantis``.

`load` and `closed_form` need no renderer; `shoot` and `budget` render. Everything else of the project is open as well: see
`experiments.chain` for each stage by itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from experiments import chain
from experiments.chain.closed_form import closed_form
from experiments.chain.shoot import Exposure, shoot
from experiments.reporting.files import read_image
from experiments.scenario import Scenario, load_scenario

__all__ = ["Exposure", "budget", "closed_form", "detect", "load", "shoot"]


def load(source: str | Path | None = None, *overrides: str) -> Scenario:
    """A scenario by file or shipped name, with changes as `--set` takes them: ``load("default", "leds.count=20")``.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    return load_scenario(source, overrides)


def detect(
    image: NDArray[Any] | str | Path, scenario: Scenario, off: NDArray[Any] | str | Path | None = None
) -> chain.Detection:
    """Features and pose of an image, an array or a file from anywhere; the scenario says which camera and which marker.

    Args:
        off: a frame without the LEDs, which is subtracted.

    Raises:
        ValueError: when an image cannot be read or is not of the camera's size, or the two are not of one kind.
    """
    seen = read_image(image) if isinstance(image, (str, Path)) else image
    return chain.detect(scenario, seen, read_image(off) if isinstance(off, (str, Path)) else off)


def budget(scenario: Scenario, quick: bool = True) -> Any:
    """`mantis budget` as an `experiments.studies.budget.study.BudgetResult`; its `dataset` holds everything.

    Args:
        scenario: what to judge.
        quick: fewer ranges, noise draws and rays.
    """
    from experiments.studies.budget import plan, study

    return study.run(scenario, plan.QUICK if quick else plan.FULL)
