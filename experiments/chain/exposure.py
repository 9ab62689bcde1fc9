"""One exposure of a scenario's sensor."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from detector.sensor import sensor as device
from detector.sensor.sensor import FixedPattern, Frame, Sensor
from experiments.chain.illumination import SOURCES
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray

#: Keeps the stream of a camera's fixed pattern apart from those of its frames.
_PATTERN_STREAM = 1288


def frame_generator(scenario: Scenario, illumination: str, seconds: float, trial: int = 0) -> np.random.Generator:
    """Generator of one frame's noise, independent between ranges, illuminations, exposures and trials."""
    where = round(scenario.range_m * 1e6), list(SOURCES).index(illumination)
    return np.random.default_rng((scenario.seed, *where, round(seconds * 1e12), trial))


def camera_pattern(scenario: Scenario) -> FixedPattern | None:
    """The fixed pattern of the scenario's camera: one for all its frames, by the seed; None where all pixels are alike."""
    if not device.has_fixed_pattern(scenario.sensor):
        return None
    return _pattern(scenario.sensor, (scenario.camera.height_px, scenario.camera.width_px), scenario.seed)


@lru_cache(maxsize=4)
def _pattern(sensor: Sensor, shape: tuple[int, int], seed: int) -> FixedPattern:
    return device.fixed_pattern(sensor, shape, np.random.default_rng((seed, _PATTERN_STREAM)))


def expose(scenario: Scenario, rate: FloatArray, illumination: str, seconds: float, trial: int = 0) -> Frame:
    """One exposure of the scenario's sensor, fixed pattern included, to electron rates (height, width) [e-/s]."""
    rng = frame_generator(scenario, illumination, seconds, trial)
    return device.expose(scenario.sensor, rate, seconds, rng, camera_pattern(scenario))
