"""One exposure of a scenario, from rendering to pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.detect import Detection
from experiments.chain.case import Case
from experiments.chain.detection import detect, pose_errors
from experiments.chain.exposure import expose
from experiments.chain.rate import electron_rate
from experiments.chain.transport import quality
from experiments.scenario import Scenario


@dataclass(frozen=True)
class Exposure:
    """One exposure of a scenario: the frame, and what the detector makes of it.

    Attributes:
        frame: (height, width) digital numbers.
        exposure_s: its exposure [s].
        detection: features and pose.
        attitude_error_rad, range_error: of the pose against the scenario's, range relative; NaN without a pose.
    """

    scenario: Scenario
    frame: NDArray[np.uint16]
    exposure_s: float
    detection: Detection
    attitude_error_rad: float
    range_error: float


def shoot(scenario: Scenario, trial: int = 0) -> Exposure:
    """Render, expose and detect, as `mantis render`, `expose` and `detect` do; rendered transport is kept in the cache.

    Args:
        scenario: its range, illumination, exposure and seed say which frame.
        trial: which noise draw of the seed.
    """
    from scenes.files.cache import TransportCache, default_folder

    case = Case.of(scenario)
    basis = TransportCache(default_folder()).basis(case.view, quality(scenario))
    rate = electron_rate(scenario, basis, scenario.illumination)
    seconds = case.exposure_s(scenario.exposure_s, rate)
    frame = expose(scenario, rate, scenario.illumination, seconds, trial).dn
    seen = detect(scenario, frame)
    return Exposure(scenario, frame, seconds, seen, *pose_errors(scenario, seen.pose))
