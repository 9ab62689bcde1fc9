"""The results that requirements are verified from: tables of the other studies, and a timing of the detector."""

from __future__ import annotations

import csv
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detector.detect import detect
from detector.pattern.pattern import Pattern, homography, kernel_sigma_px
from detector.sensor.noise import NoiseModel
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from radiometry.optics import Camera, camera_at

#: The command that makes each table.
MAKERS = {
    "fov-cone.csv": "mantis fov",
    "layout-counts.csv": "mantis layout",
    "layout-pose.csv": "mantis layout",
    "power-ranges.csv": "mantis power",
    "glare.csv": "mantis glare",
    "closure-confirmation.csv": "mantis close",
    "closure-sets.csv": "mantis close",
    "montecarlo-accuracy.csv": "mantis montecarlo",
    "montecarlo-outliers.csv": "mantis montecarlo",
    "materials.csv": "mantis materials",
}


class Missing(Exception):
    """A result that is not there; the message says which, and what makes it."""


@dataclass(frozen=True)
class Evidence:
    """Results in a folder, and the scenario that the thesis's system is.

    Attributes:
        folder: with the tables.
        scenario: camera, marker, LEDs and requirement of the system that is verified.
    """

    folder: Path
    scenario: Scenario

    def rows(self, name: str) -> list[list[str]]:
        """Rows of a table without its heading.

        Raises:
            Missing: where it is not in the folder.
        """
        return self._read(name)[1:]

    def records(self, name: str) -> list[dict[str, str]]:
        """Rows of a table by heading; of two columns of one name the last."""
        heading, *rows = self._read(name)
        return [dict(zip(heading, row, strict=True)) for row in rows]

    def _read(self, name: str) -> list[list[str]]:
        path = self.folder / name
        if not path.is_file():
            raise Missing(f"{name} is not in {self.folder}; {MAKERS[name]} makes it")
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.reader(file))

    def detection_seconds(self, repeats: int = 5) -> float:
        """Median time of features and pose in a whole frame of the scenario's camera, on this machine [s]."""
        scenario = self.scenario
        image, camera, noise = drawn_frame(scenario)
        spent = []
        for _ in range(repeats + 1):
            start = time.perf_counter()
            detect(image, scenario.marker, camera, noise=noise)
            spent.append(time.perf_counter() - start)
        return float(np.median(spent[1:]))  # the first one compiles


def drawn_frame(scenario: Scenario, range_m: float = 4.0) -> tuple[FloatArray, Camera, NoiseModel]:
    """A frame that is drawn analytically: the ArUco and its ring, tilted, with shot noise and the sensor's read noise.

    Args:
        scenario: marker, camera, sensor and seed.
        range_m: distance of the marker.

    Returns:
        Image (height, width) in electrons, the camera focused there, and the noise of the image.
    """
    camera, marker = camera_at(scenario.camera, range_m, scenario.filter.centre_nm), scenario.marker
    side = marker.aruco_m * max(camera.focal_px) / range_m
    centre = np.array(camera.principal_point_px)
    corners = centre + side * np.array([[-0.5, -0.48], [0.5, -0.5], [0.48, 0.47], [-0.5, 0.5]])
    column, row = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    places = np.stack([column, row], -1).reshape(-1, 2).astype(float)
    near = np.abs(places - centre).max(axis=1) < side
    # The pattern is known where an ideal lens shows it.
    pixels = camera.undistort_px(places[near])
    value, _ = Pattern(marker).value_and_gradient(pixels, homography(corners), kernel_sigma_px(camera.psf_sigma_px))
    sensor = scenario.sensor
    frame = np.zeros(len(places))
    frame[near] = 0.5 * sensor.full_well_electrons * np.maximum(value, 0)  # its blurred edges undershoot by 1e-6
    rng = np.random.default_rng(scenario.seed)
    frame = rng.poisson(frame) + rng.normal(0, sensor.total_noise_electrons, frame.shape)
    noise = NoiseModel(1.0, sensor.total_noise_electrons, 0.0, sensor.full_well_electrons)
    return frame.reshape(camera.height_px, camera.width_px), camera, noise
