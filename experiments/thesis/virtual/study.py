"""The virtual experiment: frames of every run rendered, exposed with noise, given to every method, and judged.

A frame's noise and sampling hang on its run and its number alone, so it is the same whatever else is run, and finished runs can
be kept for a command that was interrupted.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import xarray as xr

from detector.sensor.noise import sensor_noise
from detector.sensor.sensor import expose
from detector.version import code_version as detector_version
from experiments import chain
from experiments.chain.executor import cores, pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.shared.judge import VARIABLES, judge
from experiments.studies.shared.trackers import METHODS, Design, TrackerFrame, methods_of, rectify
from experiments.studies.shared.truth import Truth
from experiments.thesis.virtual.bounds import bounds
from experiments.thesis.virtual.plan import Plan
from experiments.thesis.virtual.summary import summarise
from experiments.thesis.virtual.targets import Run, believed, cropped, design, exposure_s, runs, views
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.atomic import atomic_write
from scenes.files.cache import code_version
from scenes.marker import MarkerDesign
from scenes.render.transport import Quality, render_cases
from scenes.view import View

#: Renderer's variance over shot noise's at full well, about (`scenes.render.density`); at half full well half of it, which adds
#: 12 % to a scatter. Flat tags have fewer edges a pixel and bear more.
VARIANCE_FRACTION = {"marker": 0.5, "plate": 2.0}
#: Frames in a worker's batch, and batches that wait at a time.
_BATCH, _WAITING = 12, 8


@dataclass(frozen=True)
class Batch:
    """Some frames of a run for a worker.

    Attributes:
        scenario: with the whole detector; range and marker are the run's.
        design, believed: what is in the views, and what the methods take it for.
        views: of the whole detector, (n,).
        rates: (n, height, width) electron rates of the crop about the axis.
        seconds: exposure.
        methods: that look for the target.
        first: number of the first frame.
        key: seed and number of the run.
    """

    scenario: Scenario
    design: Design
    believed: Design
    views: list[View]
    rates: FloatArray
    seconds: float
    methods: tuple[str, ...]
    first: int
    key: tuple[int, int]


def judge_batch(batch: Batch) -> FloatArray:
    """Values of `VARIABLES` (variables, methods, frames); NaN where there is none."""
    sensor, camera = batch.scenario.sensor, batch.scenario.camera
    result = np.full((len(VARIABLES), len(batch.methods), len(batch.views)), np.nan, np.float32)
    for k, (view, rate) in enumerate(zip(batch.views, batch.rates, strict=True)):
        rng = np.random.default_rng((*batch.key, batch.first + k))
        taken = expose(sensor, _whole(rate, camera), batch.seconds, rng).dn
        # Whatever the blur at the frame's range, the trackers are told the lens in focus.
        believed = view.camera.model_copy(update={"psf_sigma_px": camera.psf_sigma_px})
        image, ideal, noise = rectify(taken, believed, sensor_noise(sensor))
        truth = Truth(batch.design, replace(view, camera=ideal))
        frame = TrackerFrame(
            image=image,
            design=batch.believed,
            camera=ideal,
            noise=noise,
            light_ring_m=view.leds.ring_radius_m,
            truth_px=truth.points_px,
        )
        for m, name in enumerate(batch.methods):
            values = judge(truth, METHODS[name][0](frame))
            result[:, m, k] = [values.get(variable, np.nan) for variable in VARIABLES]
    return result


def _whole(rate: FloatArray, camera: Camera) -> FloatArray:
    """A crop about the axis in the middle of the whole, otherwise dark, frame."""
    frame = np.zeros((camera.height_px, camera.width_px), rate.dtype)
    top, left = ((n - m) // 2 for n, m in zip(frame.shape, rate.shape, strict=True))
    frame[top : top + rate.shape[0], left : left + rate.shape[1]] = rate
    return frame


def batches(scenario: Scenario, plan: Sequence[Run]) -> Iterator[tuple[int, Batch]]:
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
    bases = render_cases((prepared[r][2][k], quality(scenario, plan[r], k)) for r, k in every)
    for r, run in enumerate(plan):
        crop, whole, _, seen, seconds, taken_for = prepared[r]
        for first in range(0, len(run.angles_deg), _BATCH):
            part = islice(bases, min(_BATCH, len(run.angles_deg) - first))
            rates = np.array([chain.electron_rate(crop, basis, "eclipse") for basis in part], np.float32)
            yield (
                r,
                Batch(
                    scenario=whole,
                    design=design(scenario, run.target),
                    believed=taken_for,
                    views=seen[first : first + len(rates)],
                    rates=rates,
                    seconds=seconds,
                    methods=methods_of(run.target),
                    first=first,
                    key=(scenario.seed, run.number),
                ),
            )


def quality(scenario: Scenario, run: Run, frame: int) -> Quality:
    """Sampling of one frame: of the target alone, with a seed that no other frame shares."""
    kind = "marker" if isinstance(design(scenario, run.target), MarkerDesign) else "plate"
    seed = int(np.random.SeedSequence((scenario.seed, run.number, frame)).generate_state(1)[0])
    return Quality(frame_samples=0, seed=seed, variance_fraction=VARIANCE_FRACTION[kind])


@dataclass(frozen=True)
class VirtualResult:
    """What the experiment finds.

    Attributes:
        scenario: camera, sensor, LEDs and marker of the experiment.
        runs: that were run, in order.
        data: groups 'frames' (by series and frame), 'summary' (by series: statistics, and how many frames have each failure of
            thesis section 8.3) and 'bounds'; the last is empty where the plan asks for none.
    """

    scenario: Scenario
    runs: tuple[Run, ...]
    data: xr.DataTree

    @property
    def frames(self) -> xr.Dataset:
        """Every frame."""
        return self.data["frames"].to_dataset()

    @property
    def summary(self) -> xr.Dataset:
        """Every series."""
        return self.data["summary"].to_dataset()

    @property
    def bounds(self) -> xr.Dataset:
        """Smallest possible deviations."""
        return self.data["bounds"].to_dataset()


def run(
    scenario: Scenario,
    plan: Plan,
    progress: Progress | None = None,
    workers: int | None = None,
    kept: Path | None = None,
) -> VirtualResult:
    """Run the plan's tests on rendered frames.

    Args:
        scenario: the experiment's camera, marker and lights.
        plan: what is walked through.
        progress: called as the work goes on.
        workers: processes that look for targets in the frames that this one renders; default one a core.
        kept: folder of finished runs, which are not run again; made when needed.
    """
    planned = tuple(run for run in runs(plan) if methods_of(run.target))
    frames = judged_frames(scenario, planned, workers=workers, progress=progress, kept=kept)
    limits = bounds(scenario, progress=progress) if plan.bounds else xr.Dataset()
    groups = {"frames": frames, "summary": summarise(frames), "bounds": limits}
    return VirtualResult(scenario, planned, xr.DataTree.from_dict(groups))


def judged_frames(
    scenario: Scenario,
    planned: Sequence[Run],
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    kept: Path | None = None,
) -> xr.Dataset:
    """Every frame of some runs, by every method; arguments as `run`.

    Returns:
        `VARIABLES` over `series` (a run and a method) and `frame`; runs of fewer frames are filled up with NaN.
    """
    files = [None if kept is None else kept / f"{_key(scenario, run)}.npy" for run in planned]
    results = [
        np.load(file) if file is not None and file.is_file() else np.full(_shape(run), np.nan, np.float32)
        for file, run in zip(files, planned, strict=True)
    ]
    todo = [r for r, file in enumerate(files) if file is None or not file.is_file()]
    left = {r: len(planned[r].angles_deg) for r in todo}
    total = sum(left.values())
    waiting: deque[tuple[int, int, Future]] = deque()

    def collect() -> None:
        r, first, future = waiting.popleft()
        values = future.result()
        results[r][:, :, first : first + values.shape[2]] = values
        left[r] -= values.shape[2]
        file = files[r]
        if not left[r] and file is not None:
            with atomic_write(file) as temporary, temporary.open("wb") as stream:
                np.save(stream, results[r])
        if progress is not None:
            progress(total - sum(left.values()), total, planned[r].name)

    with pool(judge_batch, cores() if workers is None else workers) as submit:
        for position, batch in batches(scenario, [planned[r] for r in todo]):
            waiting.append((todo[position], batch.first, submit(batch)))
            while len(waiting) > _WAITING:
                collect()
        while waiting:
            collect()
    return _dataset(scenario, planned, results)


def _shape(run: Run) -> tuple[int, int, int]:
    return len(VARIABLES), len(methods_of(run.target)), len(run.angles_deg)


def _key(scenario: Scenario, run: Run) -> str:
    """Name of a finished run: its settings and methods, and the source that renders. Not the detector's: see `--resume`."""
    parts = (scenario.digest(), run, methods_of(run.target), tuple(VARIABLES), code_version())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _dataset(scenario: Scenario, plan: Sequence[Run], results: list[FloatArray]) -> xr.Dataset:
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
    made = chain.provenance(scenario) | {"detector_code": detector_version()}
    attributes = {"title": "Virtual experiment of thesis table 8.1", **made}
    return xr.Dataset(data, coordinates, attributes)
