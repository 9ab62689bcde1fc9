"""The runs of the arm: every station rendered once, exposed on the way out and back in eclipse and under the lamp, and judged.

Transport is linear, so one rendering of a station serves both runs, both ways and every level of the lamp.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import chain as joined

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter

from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.physical import arm
from experiments.thesis.physical.camera import Calibrated, calibrate, cropped, scaling, solved
from experiments.thesis.physical.methods import METHODS
from experiments.thesis.physical.plan import Plan
from experiments.thesis.physical.station import (
    COMPARED,
    ILLUMINATIONS,
    KEPT,
    SCALES,
    WAYS,
    CameraModel,
    StationRates,
    blobs_found,
    judge_station,
)
from radiometry.geometry import FloatArray
from scenes.render.transport import Quality, render_cases
from scenes.view import View

DIMS = ("illumination", "scale", "by", "passing", "way", "step")
#: Stations between those where every level of the lamp is tried.
_LEVEL_EVERY = 4
#: Rays of a station's marker, and the renderer's variance over shot noise's at full well.
_RAYS, _VARIANCE = 500_000, 1.0
_WAITING = 6
#: The lamp counts as beside the camera up to this phase angle [deg]: half of what lies between it and the marker's normal.
NEAR_PHASE_DEG = 22.5


@dataclass(frozen=True)
class PhysicalResult:
    """One run of the laboratory.

    Attributes:
        scenario: with the whole camera and without the laboratory's own lights.
        data: groups 'frames' (`KEPT` over `DIMS`), 'levels' (mean number of blobs found over level, by and near: with the lamp
            beside the camera, or not) and 'sharpness' (blobs found of four over the lens's point spread).
        camera: the calibration.
        passes: stations of every pass.
        pictures: images of some stations, 8 bits, by name.
    """

    scenario: Scenario
    data: xr.DataTree
    camera: Calibrated
    passes: list[list[arm.Station]]
    pictures: dict[str, np.ndarray]

    @property
    def frames(self) -> xr.Dataset:
        """Every frame by every method."""
        return self.data["frames"].to_dataset()

    @property
    def levels(self) -> xr.Dataset:
        """Blobs over the lamp's level."""
        return self.data["levels"].to_dataset()

    @property
    def sharpness(self) -> xr.Dataset:
        """Blobs over the lens's point spread."""
        return self.data["sharpness"].to_dataset()


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None) -> PhysicalResult:
    """Calibrate the camera, drive the arm, and find the marker in every frame.

    Raises:
        ValueError: when the camera cannot be calibrated, or shows no marker.
    """
    lab = arm.equipped(scenario)
    if progress is not None:
        progress(0, 1, "chessboards")
    calibrated = calibrate(scenario, plan)
    passes = arm.stations(plan)
    every = list(joined.from_iterable(passes))
    reference = chain.view(arm.at(lab, arm.nearest()))
    views = list(arm.views(lab, passes))
    rendered = rates(lab, [reference, *views])
    led, sun = next(rendered)
    known = cropped(solved(scenario.camera, calibrated.found), reference.camera)
    camera = CameraModel(lab, known, scaling(scenario), exposures_s(lab, reference, led, sun))
    levels = {float(level): _exposure(lab, reference, led + level * sun) for level in arm.table()["lamp"]["levels"]}
    shape = (len(KEPT), len(ILLUMINATIONS), len(SCALES), len(METHODS), len(passes), len(WAYS), len(passes[0]))
    values = np.full(shape, np.nan, np.float32)
    tried: list[tuple[bool, FloatArray]] = []
    waiting: deque[tuple[arm.Station, Future]] = deque()
    pictures: dict[str, np.ndarray] = {}

    def collect() -> None:
        station, future = waiting.popleft()
        values[..., station.passing, :, station.step], found = future.result()
        if len(found):
            tried.append((arm.lamp_phase_deg(station) <= NEAR_PHASE_DEG, found))

    shown = _shown(every)
    with pool(judge_station, workers) as submit:
        for k, (station, view, (led, sun)) in enumerate(zip(every, views, rendered, strict=True)):
            key = (scenario.seed, station.passing, station.step)
            here = levels if station.step % _LEVEL_EVERY == 0 else {}
            waiting.append((station, submit(camera, StationRates(view, led, sun, key, here))))
            for name, illumination in shown.get(k, ()):
                rate = led + sun if illumination == "sunlit" else led
                pictures |= _pictures(camera, view, rate, illumination, name)
            while len(waiting) > _WAITING:
                collect()
            if progress is not None:
                progress(k + 1, len(every), f"pass {station.passing + 1}")
        while waiting:
            collect()
    groups = {
        "frames": _dataset(scenario, lab, passes, values, camera.exposures_s),
        "levels": _levels(levels, tried),
        "sharpness": sharpness(camera, plan),
    }
    tree = xr.DataTree.from_dict(groups)
    tree.attrs |= chain.provenance(scenario)
    return PhysicalResult(scenario, tree, calibrated, passes, pictures)


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


def exposures_s(lab: Scenario, view: View, led: FloatArray, sun: FloatArray) -> dict[str, float]:
    """One exposure for each illumination's run [s]: the white bits at the table's part of the well, at the view given."""
    return {"eclipse": _exposure(lab, view, led), "sunlit": _exposure(lab, view, led + sun)}


def _exposure(lab: Scenario, view: View, rate: FloatArray) -> float:
    pixels = chain.bit_pixels(view, lab.marker.white_bit_centres_m())
    white = np.concatenate([rate[at] for at in pixels])
    return float(arm.table()["exposure"]["full_well_fraction"] * chain.usable_well_electrons(lab.sensor) / white.mean())


def sharpness(camera: CameraModel, plan: Plan) -> xr.Dataset:
    """Blobs found of four at the first pass's middle, in eclipse, over the lens's point spread, all in focus."""
    scenario, spreads = camera.scenario, plan.sharpness_px
    view = chain.view(arm.at(scenario, arm.nearest()))
    views = [
        replace(view, camera=view.camera.model_copy(update={"psf_sigma_px": spread, "focus_m": None}))
        for spread in spreads
    ]
    counts = np.zeros((2, len(spreads)))
    for k, (led, _) in enumerate(rates(scenario, views)):
        known = camera.known.model_copy(update={"psf_sigma_px": spreads[k]})
        rng = np.random.default_rng((scenario.seed, 77, k))
        dn = camera.expose(led, camera.exposures_s["eclipse"], rng)
        counts[:, k] = blobs_found(replace(camera, known=known), dn, views[k])
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
    """Stations of which pictures are kept, by index: (name, illumination)."""
    first = [k for k, s in enumerate(every) if s.passing == 0]
    middle, last = first[len(first) // 2], first[-1 - len(first) // 10]
    return {
        middle: [("eclipse", "eclipse"), ("lamp aside", "sunlit")],
        last: [("lamp beside the camera", "sunlit")],
    }


def _pictures(camera: CameraModel, view: View, rate: FloatArray, illumination: str, name: str) -> dict[str, np.ndarray]:
    """A frame as the thesis's pipeline gets it, full; the one in eclipse also scaled."""
    rng = np.random.default_rng((camera.scenario.seed, 55))
    dn = camera.expose(rate, camera.exposures_s[illumination], rng)
    full, small = (frame.eight_bits for frame, _ in camera.frames(dn, view))
    return {name: full, **({"scaled": small} if illumination == "eclipse" else {})}


def _dataset(
    scenario: Scenario,
    lab: Scenario,
    passes: list[list[arm.Station]],
    values: FloatArray,
    exposures: dict[str, float],
) -> xr.Dataset:
    data = {
        name: (DIMS, v, {"units": unit, "long_name": label})
        for (name, (unit, label)), v in zip(KEPT.items(), values, strict=True)
    }
    every = list(joined.from_iterable(passes))
    shape = (len(passes), len(passes[0]))
    steps = np.arange(shape[1])
    ways = (steps, steps[::-1])
    number = np.array([[(2 * p + w) * shape[1] + order for w, order in enumerate(ways)] for p in range(shape[0])])
    coordinates = {
        "illumination": list(ILLUMINATIONS),
        "scale": list(SCALES),
        "by": list(METHODS),
        "way": list(WAYS),
        "passing": np.arange(1, len(passes) + 1),
        "frame_number": (("passing", "way", "step"), number, {"long_name": "number of the frame in its run"}),
        "height_m": ("passing", [p[0].place_m[1] for p in passes], {"units": "m"}),
        "exposure_s": ("illumination", [exposures[name] for name in ILLUMINATIONS], {"units": "s"}),
    }
    geometry = {
        "true_yaw_deg": ([s.attitude_deg[1] for s in every], "degree", "true yaw"),
        "true_pitch_deg": ([s.attitude_deg[0] for s in every], "degree", "true pitch"),
        "range_m": ([s.range_m for s in every], "m", "distance of the lens from the marker"),
        "lamp_phase_deg": ([arm.lamp_phase_deg(s) for s in every], "degree", "angle lamp–marker–camera"),
    }
    for name, (column, unit, label) in geometry.items():
        coordinates[name] = (("passing", "step"), np.reshape(column, shape), {"units": unit, "long_name": label})
    attributes = {
        "title": "Physical experiment of thesis section 8.2, emulated",
        **chain.provenance(scenario),
        "lamp": lab.sun.model_dump_json(),
        "leds": lab.leds.model_dump_json(),
    }
    return xr.Dataset(data, coordinates, attributes)
