"""One exposure of a scenario's sensor, and the noise it has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel
from detector.sensor.sensor import Frame, expose
from experiments.chain.detection import Sighting, look, pose_errors
from experiments.chain.illumination import LIGHTS_ON
from experiments.chain.link_budget import exposure_s, link_budget_beside
from experiments.chain.rate import electron_rate
from experiments.chain.transport import quality
from experiments.chain.view import view
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray


def frame_generator(scenario: Scenario, light: str, seconds: float, trial: int = 0) -> np.random.Generator:
    """Generator of one frame's noise, independent between ranges, illuminations, exposures and trials."""
    key = (scenario.seed, round(scenario.range_m * 1e6), list(LIGHTS_ON).index(light), round(seconds * 1e12), trial)
    return np.random.default_rng(key)


def take_frame(scenario: Scenario, rate: FloatArray, light: str, seconds: float, trial: int = 0) -> Frame:
    """One exposure of the scenario's sensor."""
    return expose(scenario.sensor, rate, seconds, frame_generator(scenario, light, seconds, trial))


def noise_model(scenario: Scenario, image: NDArray[Any]) -> NoiseModel | None:
    """Noise of an image where it can come from the scenario's sensor, else None: the detector then estimates it."""
    sensor = scenario.sensor
    container = np.uint8 if sensor.bits <= 8 else np.uint16
    if image.dtype != container or image.max(initial=0) > sensor.max_dn:
        return None
    gain = 1 / sensor.gain_electrons_per_dn
    return NoiseModel(gain, sensor.total_noise_electrons * gain, sensor.offset_dn, sensor.saturation_dn)


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
    sighting: Sighting
    attitude_error_rad: float
    range_error: float

    def _repr_html_(self) -> str:
        from experiments.reporting.notebook import shot_html

        return shot_html(self)


def shoot(scenario: Scenario, trial: int = 0) -> Shot:
    """Render, expose and look: the chain of `mantis render`, `expose` and `detect`, transport from the cache where it is there.

    Args:
        scenario: its range, light, exposure and seed say which frame.
        trial: which noise draw of the seed.
    """
    from scenes.files.cache import TransportCache, default_folder

    basis = TransportCache(default_folder()).basis(view(scenario), quality(scenario))
    rate = electron_rate(scenario, basis, scenario.light)
    seconds = exposure_s(scenario, link_budget_beside(scenario, scenario.light, rate), scenario.exposure_s)
    frame = take_frame(scenario, rate, scenario.light, seconds, trial).dn
    seen = look(scenario, frame)
    return Shot(scenario, frame, seconds, seen, *pose_errors(scenario, seen.pose))
