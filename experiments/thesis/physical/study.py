"""The runs of the arm: every station rendered once, exposed on the way out and back in eclipse and under the lamp, and judged.

Transport is linear, so one rendering of a station serves both runs, both ways and every level of the lamp.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter

from detector.rectify import ideal_camera, rectified
from detector.sensor.noise import NoiseModel, noise_of
from detector.sensor.sensor import expose
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.shared.judge import VARIABLES, judge, tilt_deg
from experiments.studies.shared.trackers import TrackerResult
from experiments.studies.shared.truth import Truth
from experiments.thesis.physical import arm
from experiments.thesis.physical.camera import (
    Calibrated,
    Scaling,
    SolvedCamera,
    calibrate,
    camera_of,
    cropped,
    scaling,
    solved,
)
from experiments.thesis.physical.methods import METHODS, PAIR, LabShot, of_pair, sights
from radiometry.geometry import FloatArray
from scenes.render.transport import Quality, render_cases
from scenes.view import View

LIGHTS = ("eclipse", "sunlit")
SCALES = ("full", "scaled")
WAYS = ("out", "back")
#: The two whose elements are compared where not all methods are.
COMPARED = ("mantis", "thesis")
DIMS = ("illumination", "scale", "by", "passing", "way", "step")
#: What is kept of every frame, and of this study alone: unit and long name.
KEPT = {
    **{name: VARIABLES[name] for name in VARIABLES if name != "pitch_sigma_deg"},
    "yaw_deg": ("degree", "measured yaw"),
    "virtual": ("1", "two blobs that make a virtual point were found"),
}
#: Stations between those where every level of the lamp is tried.
_LEVEL_EVERY = 4
#: Rays of a station's marker, and the renderer's variance over shot noise's at full well.
_RAYS, _VARIANCE = 500_000, 1.0
_WAITING = 6
#: Lenses whose point spread is tried in place of the scenario's focus, sharp first [px].
SHARPNESS_PX = (0.7, 1.5, 2.0, 2.5, 3.0)


@dataclass(frozen=True)
class Eye:
    """What a worker needs to look at frames.

    Attributes:
        scenario: equipped; its camera is the crop.
        known: the crop as calibrated.
        scale: of section 7.1.5.
        exposures_s: of each light's run.
    """

    scenario: Scenario
    known: SolvedCamera
    scale: Scaling
    exposures_s: dict[str, float]

    def shots(self, dn: np.ndarray, view: View, off_dn: np.ndarray | None = None) -> Iterator[tuple[LabShot, Truth]]:
        """The frame, less one without LEDs if given, rectified by the calibration, full and scaled; truth in its pixels."""
        marker, ring = self.scenario.marker, view.leds.ring_radius_m
        noise = noise_of(self.scenario.sensor, dn)
        assert isinstance(noise, NoiseModel)
        if off_dn is not None:
            dn, noise = _difference(dn, off_dn, noise)
        ideal = ideal_camera(self.known)
        assert isinstance(ideal, SolvedCamera)
        image = rectified(dn, self.known, ideal, noise)
        true = camera_of(ideal, view.camera)
        scale = self.scale
        for shown, camera, told, real in (
            (image, ideal, noise, true),
            (scale.image(image), scale.camera(ideal), scale.noise(noise), scale.camera(true)),
        ):
            truth = Truth(marker, replace(view, camera=real))
            yield LabShot(shown, marker, camera, told, ring, truth.points_px), truth


def _difference(on: np.ndarray, off: np.ndarray, noise: NoiseModel) -> tuple[FloatArray, NoiseModel]:
    """A frame less another, on its own black level, and its noise: that of the light taken away as where it is middling."""
    taken = noise.gain_dn_per_electron * max(float(np.median(off)) - noise.offset_dn, 0.0)
    read = float(np.sqrt(2 * (noise.read_noise_dn**2 + taken)))
    return on.astype(float) - off + noise.offset_dn, replace(noise, read_noise_dn=read)


@dataclass(frozen=True)
class Work:
    """One station for a worker: its view, the electron rates (H, W) of LEDs and lamp, and the key of its noise.

    Attributes:
        levels: exposure by level of the lamp over its own, where levels are tried; empty elsewhere.
    """

    view: View
    led: FloatArray
    sun: FloatArray
    key: tuple[int, ...]
    levels: dict[float, float]


def look(eye: Eye, work: Work) -> tuple[FloatArray, FloatArray]:
    """Values of `KEPT` at one station: (variables, lights, scales, methods, ways), NaN where there is none; and how many blobs
    `COMPARED` find at each level of the lamp, (levels, 2)."""
    result = np.full((len(KEPT), len(LIGHTS), len(SCALES), len(METHODS), len(WAYS)), np.nan, np.float32)
    for i, illumination in enumerate(LIGHTS):
        rate = work.led + work.sun if illumination == "sunlit" else work.led
        for w in range(len(WAYS)):
            rng = np.random.default_rng((*work.key, i, w))
            dn = expose(eye.scenario.sensor, rate, eye.exposures_s[illumination], rng).dn
            for s, (shot, truth) in enumerate(eye.shots(dn, work.view)):
                for m, (_, sight) in enumerate(sights(shot)):
                    result[:, i, s, m, w] = _judged(truth, sight)
            if illumination == "sunlit":
                off = expose(eye.scenario.sensor, work.sun, eye.exposures_s[illumination], rng).dn
                shot, truth = next(eye.shots(dn, work.view, off))
                result[:, i, 0, list(METHODS).index(PAIR), w] = _judged(truth, of_pair(shot))
    levels = np.zeros((len(work.levels), len(COMPARED)), np.float32)
    for k, (level, seconds) in enumerate(work.levels.items()):
        rng = np.random.default_rng((*work.key, len(LIGHTS), k))
        dn = expose(eye.scenario.sensor, work.led + level * work.sun, seconds, rng).dn
        found = _found(eye, dn, work.view)
        levels[k] = [len(found[name].blobs or ()) for name in COMPARED]
    return result, levels


def _judged(truth: Truth, sight: TrackerResult) -> list[float]:
    """Values of `KEPT`; NaN where there is none."""
    values = judge(truth, sight)
    values["yaw_deg"] = float(tilt_deg(truth.view.rotation)[1]) + values.get("yaw_error_deg", np.nan)
    values["virtual"] = float(sight.virtual)
    return [values.get(name, np.nan) for name in KEPT]


def _found(eye: Eye, dn: np.ndarray, view: View) -> dict[str, TrackerResult]:
    """What `COMPARED` and those before them make of a full frame."""
    shot, _ = next(eye.shots(dn, view))
    return dict(islice(sights(shot), list(METHODS).index(COMPARED[-1]) + 1))


def rates(scenario: Scenario, views: Sequence[View]) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Electron rates (H, W) of LEDs and lamp at each view, one after the other.

    Rendered through a sharp lens, and spread afterwards to the view's own blur: Gaussians add in square. How distortion
    spreads the light is the same for all views, and worked out once.
    """
    real, sharp = scenario.camera, scenario.camera.psf_sigma_px
    ideal = scenario.model_copy(update={"camera": real.without_distortion})
    spread = real.relative_illumination() / ideal.camera.relative_illumination()
    cases = []
    for k, view in enumerate(views):
        seed = int(np.random.SeedSequence((scenario.seed, k)).generate_state(1)[0])
        camera = view.camera.model_copy(update={"psf_sigma_px": sharp})
        cases.append((replace(view, camera=camera), Quality(1, _RAYS, seed, variance_fraction=_VARIANCE)))
    for view, basis in zip(views, render_cases(cases), strict=True):
        led = chain.electron_rate(ideal, basis, "eclipse") * spread
        sun = chain.electron_rate(ideal, basis, "sunlit") * spread - led
        wider = np.sqrt(max(view.camera.psf_sigma_px**2 - sharp**2, 0.0))
        yield tuple(gaussian_filter(np.asarray(rate, np.float32), wider, mode="nearest") for rate in (led, sun))


@dataclass(frozen=True)
class Outcome:
    """One run of the laboratory.

    Attributes:
        scenario: with the whole camera and without the laboratory's own lights.
        frames: `KEPT` over `DIMS`.
        levels: mean number of blobs found over (level, by, near): with the lamp beside the camera, or not.
        sharpness: blobs that the thesis's pipeline finds of four, over the lens's point spread.
        camera: the calibration.
        pictures: images of some stations, 8 bits, by name.
    """

    scenario: Scenario
    frames: xr.Dataset
    levels: xr.Dataset
    sharpness: xr.Dataset
    camera: Calibrated
    pictures: dict[str, np.ndarray]


#: The lamp counts as beside the camera up to this phase angle [deg]: half of what lies between it and the marker's normal.
NEAR_PHASE_DEG = 22.5


def run(
    scenario: Scenario, quick: bool = False, workers: int | None = None, progress: Progress | None = None
) -> Outcome:
    """Calibrate, drive the arm, look.

    Raises:
        ValueError: when the camera cannot be calibrated, or shows no marker.
    """
    lab = arm.equipped(scenario)
    if progress is not None:
        progress(0, 1, "chessboards")
    calibrated = calibrate(scenario, quick)
    passes = arm.stations(quick)
    every = [station for passing in passes for station in passing]
    reference = chain.view(arm.at(lab, arm.nearest()))
    views = [reference, *arm.views(lab, passes)]
    known = cropped(solved(scenario.camera, calibrated.found), reference.camera)
    shape = (len(KEPT), len(LIGHTS), len(SCALES), len(METHODS), len(passes), len(WAYS), len(passes[0]))
    values = np.full(shape, np.nan, np.float32)
    tried: list[tuple[bool, FloatArray]] = []
    waiting: deque[tuple[arm.Station, Future]] = deque()
    pictures: dict[str, np.ndarray] = {}

    def collect() -> None:
        station, future = waiting.popleft()
        values[..., station.passing, :, station.step], found = future.result()
        if len(found):
            tried.append((arm.lamp_phase_deg(station) <= NEAR_PHASE_DEG, found))

    rendered = rates(lab, views)
    led, sun = next(rendered)
    exposures = exposures_s(lab, reference, led, sun)
    eye = Eye(lab, known, scaling(scenario), exposures)
    levels = {float(level): _exposure(lab, reference, led + level * sun) for level in arm.table()["lamp"]["levels"]}
    shown = _shown(every)
    with pool(look, workers) as submit:
        for k, (station, view, (led, sun)) in enumerate(zip(every, views[1:], rendered, strict=True)):
            key = (scenario.seed, station.passing, station.step)
            here = levels if station.step % _LEVEL_EVERY == 0 else {}
            waiting.append((station, submit(eye, Work(view, led, sun, key, here))))
            for name, illumination in shown.get(k, ()):
                pictures |= _pictures(eye, view, led + sun if illumination == "sunlit" else led, illumination, name)
            while len(waiting) > _WAITING:
                collect()
            if progress is not None:
                progress(k + 1, len(every), f"pass {station.passing + 1}")
        while waiting:
            collect()
    frames = _dataset(scenario, lab, every, passes, values, exposures)
    return Outcome(scenario, frames, _levels(levels, tried), sharpness(eye, quick), calibrated, pictures)


def exposures_s(lab: Scenario, view: View, led: FloatArray, sun: FloatArray) -> dict[str, float]:
    """One exposure for each light's run [s]: the white bits at the table's part of the well, at the view given."""
    return {"eclipse": _exposure(lab, view, led), "sunlit": _exposure(lab, view, led + sun)}


def _exposure(lab: Scenario, view: View, rate: FloatArray) -> float:
    pixels = chain.bit_pixels(view, lab.marker.white_bit_centres_m())
    white = np.concatenate([rate[at] for at in pixels])
    return float(arm.table()["exposure"]["full_well_fraction"] * chain.usable_well_electrons(lab.sensor) / white.mean())


def sharpness(eye: Eye, quick: bool = False) -> xr.Dataset:
    """Blobs found of four at the first pass's middle, in eclipse, over the lens's point spread, all in focus."""
    view = chain.view(arm.at(eye.scenario, arm.nearest()))
    spreads = SHARPNESS_PX[:: len(SHARPNESS_PX) - 1] if quick else SHARPNESS_PX
    seen = [
        replace(view, camera=view.camera.model_copy(update={"psf_sigma_px": spread, "focus_m": None}))
        for spread in spreads
    ]
    counts = np.zeros((2, len(spreads)))
    for k, (led, _) in enumerate(rates(eye.scenario, seen)):
        known = eye.known.model_copy(update={"psf_sigma_px": spreads[k]})
        dn = expose(
            eye.scenario.sensor, led, eye.exposures_s["eclipse"], np.random.default_rng((eye.scenario.seed, 77, k))
        ).dn
        found = _found(replace(eye, known=known), dn, seen[k])
        counts[:, k] = [len(found[name].blobs or ()) for name in COMPARED]
    return xr.Dataset(
        {"blobs": (("by", "psf_sigma_px"), counts, {"units": "1", "long_name": "blobs found of four"})},
        {"by": list(COMPARED), "psf_sigma_px": ("psf_sigma_px", list(spreads), {"units": "pixel"})},
    )


def _levels(levels: dict[float, float], tried: list[tuple[bool, FloatArray]]) -> xr.Dataset:
    found = np.array([of_levels for _, of_levels in tried])  # stations, levels, by
    near = np.array([beside for beside, _ in tried])
    blobs = np.full((len(levels), 2, 2), np.nan)
    for j, chosen in enumerate((near, ~near)):
        if chosen.any():
            blobs[:, :, j] = found[chosen].mean(axis=0)
    return xr.Dataset(
        {"blobs": (("level", "by", "near"), blobs, {"units": "1", "long_name": "mean number of blobs found of four"})},
        {"level": list(levels), "by": list(COMPARED), "near": [True, False]},
    )


def _shown(every: list[arm.Station]) -> dict[int, list[tuple[str, str]]]:
    """Stations of which pictures are kept, by index: (name, light)."""
    first = [k for k, s in enumerate(every) if s.passing == 0]
    middle, last = first[len(first) // 2], first[-1 - len(first) // 10]
    return {
        middle: [("eclipse", "eclipse"), ("lamp aside", "sunlit")],
        last: [("lamp beside the camera", "sunlit")],
    }


def _pictures(eye: Eye, view: View, rate: FloatArray, illumination: str, name: str) -> dict[str, np.ndarray]:
    """A frame as the thesis's pipeline gets it, full; the one in eclipse also scaled."""
    rng = np.random.default_rng((eye.scenario.seed, 55))
    dn = expose(eye.scenario.sensor, rate, eye.exposures_s[illumination], rng).dn
    full, small = (shot.eight_bits for shot, _ in eye.shots(dn, view))
    return {name: full, **({"scaled": small} if illumination == "eclipse" else {})}


def _dataset(
    scenario: Scenario, lab: Scenario, every: list[arm.Station], passes: list[list[arm.Station]],
    values: FloatArray, exposures: dict[str, float],
) -> xr.Dataset:  # fmt: skip
    data = {
        name: (DIMS, v, {"units": unit, "long_name": label})
        for (name, (unit, label)), v in zip(KEPT.items(), values, strict=True)
    }
    shape = (len(passes), len(passes[0]))
    steps = np.arange(shape[1])
    number = np.array(
        [[(2 * p + w) * shape[1] + (steps if w == 0 else steps[::-1]) for w in (0, 1)] for p in range(shape[0])]
    )
    geometry = {
        "true_yaw_deg": ([s.attitude_deg[1] for s in every], "degree", "true yaw"),
        "true_pitch_deg": ([s.attitude_deg[0] for s in every], "degree", "true pitch"),
        "range_m": ([s.range_m for s in every], "m", "distance of the lens from the marker"),
        "lamp_phase_deg": ([arm.lamp_phase_deg(s) for s in every], "degree", "angle lamp–marker–camera"),
    }
    coordinates = {
        "illumination": list(LIGHTS), "scale": list(SCALES), "by": list(METHODS), "way": list(WAYS),
        "passing": np.arange(1, len(passes) + 1),
        "frame_number": (("passing", "way", "step"), number, {"long_name": "number of the frame in its run"}),
        "height_m": ("passing", [p[0].place_m[1] for p in passes], {"units": "m"}),
        "exposure_s": ("illumination", [exposures[illumination] for illumination in LIGHTS], {"units": "s"}),
    }  # fmt: skip
    for name, (column, unit, label) in geometry.items():
        coordinates[name] = (("passing", "step"), np.reshape(column, shape), {"units": unit, "long_name": label})
    attributes = {
        "title": "Physical experiment of thesis section 8.2, emulated",
        **chain.provenance(scenario),
        "lamp": lab.sun.model_dump_json(),
        "leds": lab.leds.model_dump_json(),
    }
    return xr.Dataset(data, coordinates, attributes)
