"""The detector and the pose solver on a frame of a scenario, and their errors against it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.detect import Features, detect_features
from detector.pose.pose import Pose, solve_pose
from detector.rectify import ideal_camera, in_the_image, rectified, rectified_noise
from detector.sensor.pair import difference, pair_noise
from experiments.chain.exposure import noise_model
from experiments.chain.view import view
from experiments.scenario import Scenario
from radiometry.geometry import rotation_angle


@dataclass(frozen=True)
class Sighting:
    """What the detector and the pose solver make of one image."""

    features: Features
    pose: Pose | None

    def _repr_html_(self) -> str:
        from experiments.reporting.notebook import sighting_html

        return sighting_html(self)


def look(scenario: Scenario, image: NDArray[Any], off: NDArray[Any] | None = None) -> Sighting:
    """Find the scenario's marker in an image and solve its pose; a distorted lens's image is rectified first.

    Args:
        off: a frame without the LEDs, taken as the image was: it is subtracted, and the noise of both is heeded.

    Raises:
        ValueError: when the image is not two-dimensional, of another size than the camera's, or holds NaN or infinity, or `off`
            is of another size or kind of number than the image.
    """
    camera = scenario.camera
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"image is {'×'.join(map(str, image.shape[::-1]))} px, the camera {camera.width_px}×{camera.height_px} px "
            "(camera.width_px, camera.height_px)"
        )
    noise, camera = noise_model(scenario, image), view(scenario).camera
    if off is not None:
        known = noise if noise_model(scenario, off) is not None else None
        image, noise = difference(image, off, known or pair_noise(image, off))
    ideal = ideal_camera(camera) if camera.distorted else camera
    seen = rectified(image, camera, ideal, noise) if camera.distorted else image
    noise = rectified_noise(noise, camera, ideal) if camera.distorted else noise
    features = detect_features(seen, scenario.marker, ideal, noise, scenario.leds.ring_radius_m)
    pose = solve_pose(features, scenario.marker, ideal) if features.detected else None
    return Sighting(in_the_image(features, camera, ideal) if camera.distorted else features, pose)


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
