"""One station of the arm: its frames as the calibrated camera gives them, and what every method makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel, sensor_noise
from detector.sensor.pair import difference
from detector.sensor.sensor import expose
from experiments.scenario import Scenario
from experiments.studies.shared.judge import VARIABLES, judge, tilt_deg
from experiments.studies.shared.trackers import TrackerResult, rectify
from experiments.studies.shared.truth import Truth
from experiments.thesis.physical.camera import Scaling, SolvedCamera, camera_of
from experiments.thesis.physical.methods import METHODS, PAIR, LabFrame, of_pair, results
from radiometry.geometry import FloatArray
from scenes.view import View

ILLUMINATIONS = ("eclipse", "sunlit")
SCALES = ("full", "scaled")
WAYS = ("out", "back")
#: The two whose elements are compared where not all methods are.
COMPARED = ("mantis", "thesis")
#: What is kept of every frame, and of this study alone: unit and long name.
KEPT = {
    **{name: VARIABLES[name] for name in VARIABLES if name != "pitch_sigma_deg"},
    "yaw_deg": ("degree", "measured yaw"),
    "virtual": ("1", "two blobs that make a virtual point were found"),
}

Image = NDArray[Any]


@dataclass(frozen=True)
class CameraModel:
    """The laboratory's camera, and what is known of it.

    Attributes:
        scenario: equipped; its camera is the crop.
        known: the crop as calibrated.
        scale: of section 7.1.5.
        exposures_s: of each illumination's run.
    """

    scenario: Scenario
    known: SolvedCamera
    scale: Scaling
    exposures_s: dict[str, float]

    def expose(self, rate: FloatArray, seconds: float, rng: np.random.Generator) -> NDArray[np.unsignedinteger[Any]]:
        """Digital numbers (height, width) of one exposure of mean electron rates [1/s]."""
        return expose(self.scenario.sensor, rate, seconds, rng).dn

    def frames(self, dn: Image, view: View) -> tuple[tuple[LabFrame, Truth], tuple[LabFrame, Truth]]:
        """A frame rectified by the calibration, full and scaled, each with the truth in its own pixels.

        All methods get the rectified frame, although `detector.detect` would rectify for itself: the thesis's pipeline does
        not, and section 7.1.5 scales frames that are rectified.
        """
        image, camera, noise, true = self._rectified(dn, sensor_noise(self.scenario.sensor), view)
        scale = self.scale
        return (
            self._frame(image, camera, noise, replace(view, camera=true)),
            self._frame(
                scale.image(image), scale.camera(camera), scale.noise(noise), replace(view, camera=scale.camera(true))
            ),
        )

    def pair(self, on: Image, off: Image, view: View) -> tuple[LabFrame, Truth]:
        """A frame with LEDs less one without, rectified by the calibration, and the truth in its pixels."""
        less, noise = difference(on, off, sensor_noise(self.scenario.sensor))
        image, camera, noise, true = self._rectified(less, noise, view)
        return self._frame(image, camera, noise, replace(view, camera=true))

    def _rectified(
        self, image: Image, noise: NoiseModel, view: View
    ) -> tuple[Image, SolvedCamera, NoiseModel, SolvedCamera]:
        """Rectified image, its camera and noise as the calibration has them, and its true camera."""
        seen, ideal, there = rectify(image, self.known, noise)
        assert isinstance(ideal, SolvedCamera)
        return seen, ideal, there, camera_of(ideal, view.camera)

    def _frame(self, image: Image, camera: SolvedCamera, noise: NoiseModel, view: View) -> tuple[LabFrame, Truth]:
        marker = self.scenario.marker
        truth = Truth(marker, view)
        frame = LabFrame(
            image=image,
            design=marker,
            camera=camera,
            noise=noise,
            light_ring_m=view.leds.ring_radius_m,
            truth_px=truth.points_px,
        )
        return frame, truth


@dataclass(frozen=True)
class StationRates:
    """One station for a worker.

    Attributes:
        view: of the camera there.
        led, sun: mean electron rates (height, width) by LEDs and by the lamp [1/s].
        key: of its noise.
        levels: exposure by level of the lamp over its own [s], where levels are tried; empty elsewhere.
    """

    view: View
    led: FloatArray
    sun: FloatArray
    key: tuple[int, ...]
    levels: dict[float, float]


def judge_station(camera: CameraModel, station: StationRates) -> tuple[FloatArray, FloatArray]:
    """Every method on every frame of a station.

    Returns:
        Values of `KEPT`, (variables, illuminations, scales, methods, ways), NaN where there is none; and how many blobs
        `COMPARED` find at each level of the lamp, (levels, 2).
    """
    shape = (len(KEPT), len(ILLUMINATIONS), len(SCALES), len(METHODS), len(WAYS))
    values = np.full(shape, np.nan, np.float32)
    for i, illumination in enumerate(ILLUMINATIONS):
        rate = station.led + station.sun if illumination == "sunlit" else station.led
        seconds = camera.exposures_s[illumination]
        for w in range(len(WAYS)):
            rng = np.random.default_rng((*station.key, i, w))
            dn = camera.expose(rate, seconds, rng)
            for s, (frame, truth) in enumerate(camera.frames(dn, station.view)):
                for m, (_, result) in enumerate(results(frame)):
                    values[:, i, s, m, w] = _judged(truth, result)
            if illumination == "sunlit":
                off = camera.expose(station.sun, seconds, rng)
                frame, truth = camera.pair(dn, off, station.view)
                values[:, i, 0, list(METHODS).index(PAIR), w] = _judged(truth, of_pair(frame))
    levels = np.zeros((len(station.levels), len(COMPARED)), np.float32)
    for k, (level, seconds) in enumerate(station.levels.items()):
        rng = np.random.default_rng((*station.key, len(ILLUMINATIONS), k))
        levels[k] = blobs_found(camera, camera.expose(station.led + level * station.sun, seconds, rng), station.view)
    return values, levels


def _judged(truth: Truth, result: TrackerResult) -> list[float]:
    """Values of `KEPT`; NaN where there is none."""
    values = judge(truth, result)
    values["yaw_deg"] = float(tilt_deg(truth.view.rotation)[1]) + values.get("yaw_error_deg", np.nan)
    values["virtual"] = float(result.virtual)
    return [values.get(name, np.nan) for name in KEPT]


def blobs_found(camera: CameraModel, dn: Image, view: View) -> list[int]:
    """How many blobs `COMPARED` find in a full frame."""
    frame, _ = camera.frames(dn, view)[0]
    found = dict(_up_to_compared(results(frame)))
    return [len(found[name].blobs or ()) for name in COMPARED]


def _up_to_compared(every: Iterator[tuple[str, TrackerResult]]) -> Iterator[tuple[str, TrackerResult]]:
    """Results up to the last of `COMPARED`; the others need not be worked out."""
    return islice(every, list(METHODS).index(COMPARED[-1]) + 1)
