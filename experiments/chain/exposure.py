"""One exposure of a scenario's sensor."""

from __future__ import annotations

import numpy as np

from detector.sensor import sensor as device
from detector.sensor.sensor import Frame
from experiments.chain.illumination import SOURCES
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray


def frame_generator(scenario: Scenario, illumination: str, seconds: float, trial: int = 0) -> np.random.Generator:
    """Generator of one frame's noise, independent between ranges, illuminations, exposures and trials."""
    key = (
        scenario.seed,
        round(scenario.range_m * 1e6),
        list(SOURCES).index(illumination),
        round(seconds * 1e12),
        trial,
    )
    return np.random.default_rng(key)


def expose(scenario: Scenario, rate: FloatArray, illumination: str, seconds: float, trial: int = 0) -> Frame:
    """One exposure of the scenario's sensor to electron rates (height, width) [e-/s]."""
    return device.expose(scenario.sensor, rate, seconds, frame_generator(scenario, illumination, seconds, trial))
