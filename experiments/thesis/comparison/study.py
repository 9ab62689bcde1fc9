"""Attitude error over tilt of several markers at equal size in pixels: rendered where they can be, by closed form where not.

The frames are those of the virtual experiment (`experiments.thesis.virtual`): its camera, its 25 mm targets and its methods. Here
every tilt is repeated, each time with its own noise and its own sampling.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.comparison.plan import Plan
from experiments.thesis.virtual.study import judged_frames
from experiments.thesis.virtual.summary import OUTLIER_DEG
from experiments.thesis.virtual.targets import Run

#: What is rendered, and the methods that are shown of each.
TARGETS = ("improved", "aruco", "apriltag", "svms")
SHOWN = ("mantis", "aruco", "aruco_opencv", "apriltag", "svms")

#: Frames of one tilt are spread evenly over so much to either side of it [deg]: at one exact attitude all edges would fall on the
#: same sub-pixels, and a solver that starts from frontal would be right at frontal by standing still.
SPREAD_DEG = 2.0

#: Statistics of the frames of one tilt: unit and long name.
_STATISTICS = {
    "median_deg": ("deg", "median attitude error"),
    "p95_deg": ("deg", "95th percentile of the attitude error"),
    "posed": ("1", "share of frames with a pose"),
    "flipped": ("1", "share of those poses that are off by more than 10 deg"),
}


@dataclass(frozen=True)
class ComparisonResult:
    """What the study finds.

    Attributes:
        scenario: of the virtual experiment.
        data: median_deg, p95_deg, posed and flipped by marker, range_m and tilt_deg.
    """

    scenario: Scenario
    data: xr.Dataset


def runs(plan: Plan) -> list[Run]:
    """Every target at every range; tilts one after the other, the frames of each spread about it."""
    about = SPREAD_DEG * (2 * (np.arange(plan.frames) + 0.5) / plan.frames - 1)
    angles = tuple(float(a) for a in np.add.outer(plan.tilts_deg, about).ravel())
    return [Run(0, target, range_m, "pitch", angles) for range_m in plan.ranges_m for target in TARGETS]


def run(
    scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None
) -> ComparisonResult:
    """Median and 95th percentile of the attitude error, share with a pose and of flips, by marker, range_m, tilt_deg."""
    frames = judged_frames(scenario, runs(plan), workers=workers, progress=progress)
    methods = [m for m in SHOWN if m in frames.method.values]
    shape = (len(methods), len(plan.ranges_m), len(plan.tilts_deg))
    table = {name: np.full(shape, np.nan) for name in _STATISTICS}
    for m, name in enumerate(methods):
        for r, range_m in enumerate(plan.ranges_m):
            rows = np.flatnonzero((frames.method.values == name) & (frames.range_m.values == range_m))
            error = frames.attitude_error_deg.values[rows[0]].reshape(len(plan.tilts_deg), plan.frames)
            for t, values in enumerate(error):
                for statistic, value in _statistics(values).items():
                    table[statistic][m, r, t] = value
    dims = ("marker", "range_m", "tilt_deg")
    focal = max(scenario.camera.focal_px)
    size = [focal * scenario.marker.size_m / r for r in plan.ranges_m]
    coordinates = {
        "marker": methods,
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
        "tilt_deg": ("tilt_deg", list(plan.tilts_deg), {"units": "deg"}),
        "size_px": ("range_m", size, {"units": "pixel", "long_name": "outer side of every marker seen squarely"}),
    }
    data: dict[str, Any] = {
        name: (dims, table[name], {"units": unit, "long_name": text}) for name, (unit, text) in _STATISTICS.items()
    }
    attributes = {**frames.attrs, "title": "Attitude error over tilt", "frames": plan.frames}
    return ComparisonResult(scenario, xr.Dataset(data, coordinates, attributes))


def _statistics(errors_deg: np.ndarray) -> dict[str, float]:
    """Values of `_STATISTICS` of the frames (n,) of one tilt, NaN without a pose."""
    good = errors_deg[np.isfinite(errors_deg)]
    if not len(good):
        return {"posed": 0.0}
    return {
        "median_deg": float(np.median(good)),
        "p95_deg": float(np.percentile(good, 95)),
        "posed": len(good) / len(errors_deg),
        "flipped": float(np.mean(good > OUTLIER_DEG)),
    }
