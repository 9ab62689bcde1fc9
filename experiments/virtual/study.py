"""The virtual experiment: frames of every run rendered, exposed with noise, looked at by every method, and judged."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import xarray as xr

from detector.blobs import MAX_CUT_FRACTION
from detector.noise import NoiseModel
from detector.sensor import expose
from detector.slits import Slits
from experiments import chain
from experiments.scenario import Scenario
from experiments.virtual.targets import Design, Run, believed, cropped, design, exposure_s, views
from experiments.virtual.trackers import METHODS, Shot, Sight, methods_of
from experiments.workers import cores, pool
from radiometry.geometry import FRONTAL, FloatArray, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign
from scenes.tags import DotPlate, TagPlate
from scenes.transport import Quality, render_cases
from scenes.view import View

#: Reports progress: frames done, frames in all, what is being worked on.
Progress = Callable[[int, int, str], None]

#: A corner further off than this, over the ArUco's side, is wrong: half the diagonal of the narrow ring, so nearer to that ring's
#: outer corner than to its own.
WRONG_CORNER = 0.5 * np.sqrt(2) * 0.06
#: Corners further off than this, rms and in bits, are another thing.
MISPLACED_BITS = 1.0
#: An outlier is off by more than this in attitude [deg] or, over range, in range.
OUTLIER_DEG, OUTLIER_RANGE = 10.0, 0.05
#: Renderer's variance over shot noise's at full well, about (`scenes.density`); at half full well half of it, which adds 12 % to
#: a scatter. Flat tags have fewer edges a pixel and bear more.
VARIANCE_FRACTION = {"marker": 0.5, "plate": 2.0}
#: Frames that a worker looks at in one go, and such batches that wait at a time.
_BATCH, _WAITING = 12, 8

#: What is kept of every frame: unit and long name. Errors are measured minus true, NaN without a pose.
VARIABLES: dict[str, tuple[str, str]] = {
    "found": ("1", "target found at its place"),
    "pitch_error_deg": ("degree", "error of the pitch"),
    "yaw_error_deg": ("degree", "error of the yaw"),
    "attitude_error_deg": ("degree", "angle between true and measured attitude"),
    "range_error_m": ("m", "error of the range"),
    "pitch_sigma_deg": ("degree", "standard deviation of the pitch that the solver states"),
    "point_error_px": ("pixel", "largest error of a corner"),
    "blobs_found": ("1", "blobs found, of those that stand in their openings"),
    "blobs_there": ("1", "blobs that stand in their openings"),
    "loss_of_aruco": ("1", "no square found, or none whose bits decode (failure mode 1 of thesis section 8.3)"),
    "false_positive": ("1", "another identity, or a marker elsewhere (failure mode 2)"),
    "loss_of_elements": ("1", "square found, but no two blobs that make a virtual point (failure mode 3)"),
    "wrong_corners": ("1", "square found with a corner nearer to the ring's outer corner than to its own (failure mode 4)"),
    "no_blob": ("1", "square found, but not every blob that stands in its opening (failure mode 5)"),
}  # fmt: skip
FAILURES = ("loss_of_aruco", "false_positive", "loss_of_elements", "wrong_corners", "no_blob")


@dataclass(frozen=True)
class Truth:
    """A frame's target, attitude and camera."""

    design: Design
    view: View

    @property
    def points_px(self) -> FloatArray:
        """Feature points (n, 2), corners first [px]."""
        points = self.design.points_m if isinstance(self.design, DotPlate) else self.design.corners_m
        return self.view.to_image(points)

    def blobs(self) -> frozenset[str]:
        """Elements in whose opening the blob stands, but for as much as a detector may lose."""
        if not isinstance(self.design, MarkerDesign):
            return frozenset()
        camera_m = self.view.to_marker(np.zeros(3))
        return frozenset(
            e.name
            for e in self.design.elements
            if Slits(self.design, e, camera_m).cut_fraction(float(e.blob_offset_m(camera_m))) <= MAX_CUT_FRACTION
        )

    def judge(self, sight: Sight) -> dict[str, float]:
        """Values of `VARIABLES`; those that a target does not have are left out."""
        side_m = self.design.aruco_m
        side_px = side_m * float(np.mean(self.view.camera.focal_px)) / self.view.range_m
        error = np.inf
        elsewhere = False
        if sight.points_px is not None:
            distance = np.linalg.norm(sight.points_px - self.points_px, axis=1)
            error = float(distance.max())
            bit_px = side_px * self.design.bit_m / side_m
            elsewhere = float(np.sqrt(np.mean(distance**2))) > MISPLACED_BITS * bit_px
        found = np.isfinite(error) and not elsewhere
        values = {
            "found": float(found),
            "loss_of_aruco": float(not found),
            "false_positive": float(sight.other or elsewhere),
        }
        if found:
            values |= {"point_error_px": error, **self._pose_errors(sight)}
        if isinstance(self.design, (MarkerDesign, TagPlate)):
            values["wrong_corners"] = float(found and error > WRONG_CORNER * side_px)
        if sight.blobs is not None:
            there = self.blobs()
            values |= {
                "blobs_there": len(there), "blobs_found": len(there & sight.blobs),
                "loss_of_elements": float(found and not sight.virtual), "no_blob": float(found and not there <= sight.blobs),
            }  # fmt: skip
        return values

    def _pose_errors(self, sight: Sight) -> dict[str, float]:
        if sight.rotation is None or sight.translation_m is None:
            return {}
        off = tilt_deg(sight.rotation) - tilt_deg(self.view.rotation)
        pitch, yaw = (off + 180) % 360 - 180
        distance = float(np.linalg.norm(sight.translation_m) - np.linalg.norm(self.view.translation_m))
        return {
            "pitch_error_deg": float(pitch), "yaw_error_deg": float(yaw), "range_error_m": distance,
            "attitude_error_deg": float(np.degrees(rotation_angle(self.view.rotation, sight.rotation))),
            "pitch_sigma_deg": float(np.degrees(sight.sigma_pitch_rad)),
        }  # fmt: skip


def tilt_deg(rotation: FloatArray) -> FloatArray:
    """Pitch and yaw (2,) [deg] of an attitude (3, 3): angles of R_0 · Rz · Ry(yaw) · Rx(pitch)."""
    turned = FRONTAL.T @ rotation
    pitch = np.arctan2(turned[2, 1], turned[2, 2])
    return np.degrees([pitch, -np.arcsin(np.clip(turned[2, 0], -1.0, 1.0))])


@dataclass(frozen=True)
class Batch:
    """Some frames of a run for a worker to look at.

    Attributes:
        scenario: with the whole detector; range and marker are the run's.
        design, believed: what is in the views, and what the methods take it for.
        rates: (n, height, width) electron rates of the crop about the axis.
        key: seed, number of the run and of the first frame.
    """

    scenario: Scenario
    design: Design
    believed: Design
    views: list[View]
    rates: FloatArray
    seconds: float
    methods: tuple[str, ...]
    key: tuple[int, int, int]


def look(batch: Batch) -> FloatArray:
    """Values of `VARIABLES` (variables, methods, frames); NaN where there is none."""
    sensor, camera = batch.scenario.sensor, batch.scenario.camera
    result = np.full((len(VARIABLES), len(batch.methods), len(batch.views)), np.nan, np.float32)
    seed, run, first = batch.key
    for k, (view, rate) in enumerate(zip(batch.views, batch.rates, strict=True)):
        rng = np.random.default_rng((seed, run, first + k))
        image = expose(sensor, _whole(rate, camera), batch.seconds, rng).dn
        noise = chain.noise_model(batch.scenario, image)
        assert isinstance(noise, NoiseModel)
        truth = Truth(batch.design, view)
        shot = Shot(image, batch.believed, view.camera, noise, view.leds.ring_radius_m, truth.points_px)
        for m, name in enumerate(batch.methods):
            values = truth.judge(METHODS[name][0](shot))
            result[:, m, k] = [values.get(variable, np.nan) for variable in VARIABLES]
    return result


def _whole(rate: FloatArray, camera: Camera) -> FloatArray:
    """A crop about the axis in the middle of the whole, otherwise dark, frame."""
    frame = np.zeros((camera.height_px, camera.width_px), rate.dtype)
    top, left = ((n - m) // 2 for n, m in zip(frame.shape, rate.shape, strict=True))
    frame[top : top + rate.shape[0], left : left + rate.shape[1]] = rate
    return frame


def batches(scenario: Scenario, plan: list[Run]) -> Iterator[tuple[int, Batch]]:
    """Rendered frames of all runs in order, each batch with its run's number."""
    prepared = []
    for run in plan:
        crop = cropped(scenario, run)
        whole = crop.at(camera=scenario.camera.model_dump())
        camera = chain.view(whole).camera
        shown = views(crop, run)
        seen = [replace(view, camera=camera) for view in shown]
        prepared.append((crop, whole, shown, seen, exposure_s(scenario, run), believed(scenario, run)))
    every = [(r, k) for r, run in enumerate(plan) for k in range(len(run.angles_deg))]
    bases = render_cases((prepared[r][2][k], quality(scenario, plan[r], r, k)) for r, k in every)
    for r, run in enumerate(plan):
        crop, whole, _, seen, seconds, taken_for = prepared[r]
        for first in range(0, len(run.angles_deg), _BATCH):
            part = islice(bases, min(_BATCH, len(run.angles_deg) - first))
            rates = np.array([chain.electron_rate(crop, basis, "eclipse") for basis in part], np.float32)
            yield r, Batch(
                whole, design(scenario, run.target), taken_for, seen[first : first + len(rates)], rates, seconds,
                methods_of(run.target), (scenario.seed, r, first),
            )  # fmt: skip


def quality(scenario: Scenario, run: Run, number: int, frame: int) -> Quality:
    """Sampling of one frame: of the target alone, with a seed that no other frame shares."""
    kind = "marker" if isinstance(design(scenario, run.target), MarkerDesign) else "plate"
    seed = int(np.random.SeedSequence((scenario.seed, number, frame)).generate_state(1)[0])
    return Quality(frame_samples=0, seed=seed, variance_fraction=VARIANCE_FRACTION[kind])


def study(
    scenario: Scenario, plan: list[Run], workers: int | None = None, progress: Progress | None = None
) -> xr.Dataset:
    """Run all of a plan.

    Args:
        workers: processes that look at the frames that this one renders; default one a core.

    Returns:
        `VARIABLES` over `series` (a run and a method) and `frame`; runs of fewer frames are filled up with NaN.
    """
    results = [np.full((len(VARIABLES), len(methods_of(r.target)), len(r.angles_deg)), np.nan) for r in plan]
    total, done = sum(len(r.angles_deg) for r in plan), 0
    waiting: deque[tuple[int, int, Future]] = deque()

    def collect() -> int:
        r, first, future = waiting.popleft()
        values = future.result()
        results[r][:, :, first : first + values.shape[2]] = values
        return int(values.shape[2])

    with pool(look, cores() if workers is None else workers) as submit:
        for r, batch in batches(scenario, plan):
            waiting.append((r, batch.key[2], submit(batch)))
            while len(waiting) > _WAITING:
                done += collect()
                if progress is not None:
                    progress(done, total, plan[r].name)
        while waiting:
            done += collect()
    return _dataset(scenario, plan, results)


def _dataset(scenario: Scenario, plan: list[Run], results: list[FloatArray]) -> xr.Dataset:
    series = [(r, m, name) for r, run in enumerate(plan) for m, name in enumerate(methods_of(run.target))]
    longest = max(len(run.angles_deg) for run in plan)
    values = np.full((len(VARIABLES), len(series), longest), np.nan, np.float32)
    angles = np.full((2, len(series), longest), np.nan)
    for s, (r, m, _) in enumerate(series):
        count = len(plan[r].angles_deg)
        values[:, s, :count] = results[r][:, m]
        angles[:, s, :count] = plan[r].attitudes_deg.T
    data = {
        name: (("series", "frame"), v, {"units": unit, "long_name": label})
        for (name, (unit, label)), v in zip(VARIABLES.items(), values, strict=True)
    }
    for name, v in zip(("pitch_deg", "yaw_deg"), angles, strict=True):
        data[name] = (("series", "frame"), v, {"units": "degree", "long_name": f"true {name[:-4]}"})
    coordinates = {
        "test": ("series", [plan[r].test for r, _, _ in series], {"long_name": "number in table 8.1; 0 beside it"}),
        "target": ("series", [plan[r].target for r, _, _ in series]),
        "method": ("series", [name for _, _, name in series]),
        "rotation": ("series", [plan[r].rotation for r, _, _ in series]),
        "range_m": ("series", [plan[r].range_m for r, _, _ in series], {"units": "m"}),
    }
    attributes = {"title": "Virtual experiment of thesis table 8.1", **chain.provenance(scenario)}
    return xr.Dataset(data, coordinates, attributes)
