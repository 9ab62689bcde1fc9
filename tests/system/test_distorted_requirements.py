"""Every study that detects, with a camera whose lens distorts: errors are those of a camera without distortion.

A study that gives a distorted image to a function below `detector.detect` is off by far more than noise, without a word.
"""

from __future__ import annotations

import numpy as np

from experiments.scenario import Scenario, load_scenario

#: Barrel distortion, strong enough that straight lines of the marker bend by pixels.
DISTORTION = "camera.k1=-0.2"


def scenarios(*overrides: str) -> tuple[Scenario, Scenario]:
    """A scenario without distortion, and the same with it."""
    return load_scenario(overrides=overrides), load_scenario(overrides=(*overrides, DISTORTION))


def test_requirements() -> None:
    """The frame that is drawn to time the detector bends with the lens; without rectification its pose is off by 0.24 mm."""
    from detector.detect import detect
    from experiments.thesis.requirements.evidence import drawn_frame
    from radiometry.geometry import rotation_angle

    poses = []
    for scenario in scenarios():
        image, camera, noise = drawn_frame(scenario, 1.0)
        pose = detect(image, scenario.marker, camera, noise=noise).pose
        assert pose is not None
        poses.append(pose)
    straight, distorted = poses
    assert np.abs(distorted.translation_m - straight.translation_m).max() < 5e-5
    assert np.degrees(rotation_angle(straight.rotation, distorted.rotation)) < 0.02
