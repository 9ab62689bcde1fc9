"""The detector on a frame of a scenario, and the errors of a pose against the scenario's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import detector.detect as detector
from detector.detect import Detection
from detector.pose.pose import Pose
from experiments.chain.view import view
from experiments.scenario import Scenario
from radiometry.geometry import rotation_angle


@dataclass(frozen=True)
class DetectedImage(Detection):
    """A detection with the image that it was made in, so that it can be shown as a picture.

    Attributes:
        image: (height, width) as it was given to the detector.
        scenario: says which camera and which marker.
    """

    image: NDArray[Any]
    scenario: Scenario


def detect(scenario: Scenario, image: NDArray[Any], off: NDArray[Any] | None = None) -> Detection:
    """Find the scenario's marker in an image and solve its pose.

    Args:
        scenario: says which camera, sensor, LED ring and marker.
        image: (height, width) digital numbers or electrons, of any bit depth.
        off: a frame without the LEDs, taken as the image was: it is subtracted, and the noise of both counts.

    Raises:
        ValueError: as `detector.detect.detect`.
    """
    return detector.detect(
        image,
        scenario.marker,
        view(scenario).camera,
        sensor=scenario.sensor,
        led_ring_radius_m=scenario.leds.ring_radius_m,
        off=off,
    )


def pose_errors(scenario: Scenario, pose: Pose | None) -> tuple[float, float]:
    """Attitude error [rad] and range error over range; NaN without a pose."""
    if pose is None:
        return np.nan, np.nan
    truth = view(scenario)
    distance = np.linalg.norm(truth.translation_m)
    return (
        rotation_angle(truth.rotation, pose.rotation),
        float(abs(np.linalg.norm(pose.translation_m) - distance) / distance),
    )
