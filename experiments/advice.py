"""Advice from the closed forms: the smallest single change that mends each failing criterion, and what frames show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from scipy.optimize import brentq

from experiments.budget import exposure_label
from experiments.scenario import Scenario
from radiometry import link
from radiometry.closure import CRITERIA
from radiometry.geometry import FloatArray

if TYPE_CHECKING:
    from experiments.verdict import CaseVerdict

#: SYS-REQ-6 of the thesis (section 3.6): planar dimensions of a marker over those of the target's face, at most.
MARKER_OVER_FACE_MAX = 0.10


def advise(dataset: xr.Dataset, scenario: Scenario, cases: tuple[CaseVerdict, ...]) -> tuple[str, ...]:
    """One statement for each thing to change or to know, in the order in which the criteria bind."""
    from experiments.verdict import CaseVerdict  # noqa: F401

    shown = [case for case in cases if case.shown]
    failing = {name: [s for case in shown for s in case.failing(name)] for name in CRITERIA}
    advice = []
    if failing["sampling"]:
        advice.append(sampling_advice(dataset, scenario))
    return tuple(advice)
