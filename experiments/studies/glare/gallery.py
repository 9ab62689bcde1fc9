"""The worst frames of the glare study, made again from their seeds, with what failed."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np
import xarray as xr

from detector.features import Features
from experiments.scenario import Scenario
from experiments.studies.glare.frames import frames
from experiments.studies.glare.geometry import at_sun, cropped, render
from experiments.studies.glare.plan import Plan
from experiments.studies.shared.truth import Truth
from radiometry.geometry import FloatArray


@dataclass(frozen=True)
class Worst:
    """One frame: image (H, W), features, the true outline (4, 2) of the ArUco square, and lines that say what is wrong."""

    mode: str
    where: str
    image: FloatArray
    features: Features
    outline_px: FloatArray
    lines: tuple[str, ...]
    failed: bool


def worst_frames(dataset: xr.Dataset, scenario: Scenario, plan: Plan) -> list[Worst]:
    """For every mode the frame that failed worst: not found furthest from phase 0, else of the largest attitude error."""
    return [_again(dataset.sel(mode=mode), scenario, plan) for mode in plan.modes]


def _again(cells: xr.Dataset, scenario: Scenario, plan: Plan) -> Worst:
    lost = (cells.detected == 0).values
    # Lost at a large phase angle is worse than at a small one; among the found, the attitude error counts.
    badness = np.where(
        lost, 1e3 + cells.phase_deg.values[None, :, None, None], np.nan_to_num(cells.attitude_error_deg.values)
    )
    r, p, a, f = (int(k) for k in np.unravel_index(int(np.argmax(badness)), badness.shape))
    s, k = divmod(f, plan.draws)
    mode = str(cells.mode.values)
    here = cropped(at_sun(scenario, plan.ranges_m[r], plan.phases_deg[p], plan.azimuths_deg[a], plan.attitudes[s]))
    geometry, truth = render(here, plan.modes, plan.pair_interval_s, plan.rays), Truth.of(here)
    frame = list(frames(geometry, truth, mode, k + 1, (s, r, p, a)))[k]
    values, features = frame.values, frame.detection.features
    need = scenario.requirement
    if not values["detected"]:
        lines = [f"not found: {features.reason}" if features.corners_px is None else "found at a wrong place"]
        failed = True
    else:
        attitude, distance = values["attitude_error_deg"], values["range_error"]
        failed = bool(attitude > need.attitude_error_max_deg or distance > need.range_error_max)
        lines = [f"attitude {attitude:.2f}° off" + (", too much" if attitude > need.attitude_error_max_deg else "")]
        lines += [f"range {100 * distance:.2f} % off"] + ([features.reason] if features.reason else [])
    lines.append(f"{100 * values['saturated_fraction']:.0f} % of bits saturated")
    where = f"{plan.ranges_m[r]:g} m, phase {plan.phases_deg[p]:g}°, az. {plan.azimuths_deg[a]:g}°"
    wrapped = tuple(piece for line in lines for piece in textwrap.wrap(line, 40))
    return Worst(
        mode=mode,
        where=where,
        image=np.asarray(frame.image.pixels, float),
        features=features,
        outline_px=truth.corners_px,
        lines=wrapped,
        failed=failed,
    )
