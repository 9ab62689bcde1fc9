"""The study of features: accuracy beside the bounds, detection beside others, marker-free frames, and both calibrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import xarray as xr

from detector.version import code_version
from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.features import accuracy, clutter, detection
from experiments.studies.features.plan import Plan
from experiments.studies.shared import calibrations
from experiments.studies.shared.calibrations import Trial

#: The marker's yaw where pitch varies: one that faces the camera exactly is a case of its own [deg].
YAW_DEG = 3.0
#: Ranges at which elements and camera are calibrated [m].
ELEMENTS_AT_M, BOARD_AT_M = 2.5, 1.25
#: Distortion of the lens that is calibrated as well: one pixel at the frame's corner.
DISTORTION: Mapping[str, float] = {"k1": -0.2, "k2": 0.1, "p1": 0.001}


@dataclass(frozen=True)
class FeaturesResult:
    """What a run gives: datasets by part, and what the calibrations found."""

    scenario: Scenario
    plan: Plan
    accuracy: xr.Dataset
    detection: xr.Dataset
    clutter: xr.Dataset
    trials: dict[str, list[Trial]]

    @property
    def dataset(self) -> xr.Dataset:
        """All parts in one, with what made them."""
        merged = xr.merge([self.accuracy, self.detection, self.clutter], combine_attrs="drop_conflicts")
        history = f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis features"
        made = chain.provenance(self.scenario) | {"detector_code": code_version(), "history": history}
        return merged.assign_attrs(made)


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None) -> FeaturesResult:
    """Every part of the study; `workers` processes search the frames that this one renders."""
    workers = plan.processes if workers is None else workers
    tilted = scenario.at(target={**scenario.target.model_dump(), "yaw_deg": YAW_DEG})
    by_range = accuracy.run(tilted, plan, workers, progress)
    found = detection.run(scenario, plan, workers, progress)
    free = [
        clutter.run(scenario, frames, plan.free_renders, cut=cut, workers=workers, progress=progress)
        for frames, cut in ((plan.free_quarters, clutter.QUARTER), (plan.free_whole, clutter.WHOLE))
    ]
    return FeaturesResult(
        scenario=scenario,
        plan=plan,
        accuracy=by_range,
        detection=found,
        clutter=xr.concat(free, "size_px"),
        trials=_calibrations(scenario) if plan.calibrations else {},
    )


def _calibrations(scenario: Scenario) -> dict[str, list[Trial]]:
    near, board = scenario.at(range_m=ELEMENTS_AT_M), scenario.at(range_m=BOARD_AT_M)
    bent = board.at(camera={**board.camera.model_dump(), **DISTORTION})
    return {
        "elements": calibrations.element_trials(near),
        "camera": calibrations.camera_trials(board, calibrations.board_for(board), distorted=False),
        "distorted camera": calibrations.camera_trials(bent, calibrations.board_for(board), distorted=True),
    }
