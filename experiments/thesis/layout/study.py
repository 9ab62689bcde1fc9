"""The system layout of section 6.1: markers in view over range and face, and the pose of the whole face by rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from detector.detect import FaceDetection, detect_face
from detector.pose.pose import Pose
from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.layout.placement import LAYOUTS, Layout, in_view, layout, random_attitudes
from experiments.thesis.layout.plan import Plan
from radiometry.geometry import FloatArray, rotation_angle
from scenes.face import render_face
from scenes.render.transport import Quality

#: A pose from one marker or from all.
SOLVERS = ("one marker", "all markers")


@dataclass(frozen=True)
class LayoutResult:
    """What the study finds.

    Attributes:
        scenario: camera, LEDs, marker and requirement of the system.
        data: groups 'counts' and 'rendered'; see `counts` and `rendered`.
        frames: shown frames (height, width) [DN] by their titles.
    """

    scenario: Scenario
    data: xr.DataTree
    frames: dict[str, NDArray[np.uint16]]

    @property
    def counts(self) -> xr.Dataset:
        """Markers in view."""
        return self.data["counts"].to_dataset()

    @property
    def rendered(self) -> xr.Dataset:
        """Poses from rendered frames."""
        return self.data["rendered"].to_dataset()


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> LayoutResult:
    """Count the markers in view, and measure the face's pose from rendered frames."""
    first, second = np.random.default_rng((scenario.seed, 61)).spawn(2)
    groups = {"counts": counts(scenario, plan, first), "rendered": rendered(scenario, plan, second, progress)}
    tree = xr.DataTree.from_dict(groups)
    tree.attrs |= chain.provenance(scenario)
    return LayoutResult(scenario, tree, shown_frames(scenario, plan))


def counts(scenario: Scenario, plan: Plan, rng: np.random.Generator) -> xr.Dataset:
    """Markers in view over layout, face_m and range_m: seen squarely, and over attitudes within ±45°, any roll.

    Variables: whole and usable (squarely), whole_mean, usable_mean and usable_least (over the attitudes), none (share of
    the attitudes without a usable marker). 'Usable' is wholly in the frame and resolved to the scenario's px_per_bit_min.
    """
    px = scenario.requirement.px_per_bit_min
    attitudes = random_attitudes(plan.attitudes, rng)
    shape = (len(LAYOUTS), len(plan.faces_m), len(plan.ranges_m))
    names = ("whole", "usable", "whole_mean", "usable_mean", "usable_least", "none")
    table = {name: np.zeros(shape) for name in names}
    for index in np.ndindex(shape):
        kind, sizing = list(LAYOUTS.values())[index[0]]
        placed = layout(kind, plan.faces_m[index[1]], sizing, scenario.marker).placed
        range_m = plan.ranges_m[index[2]]
        square = in_view(placed, scenario.camera, range_m, np.zeros((1, 3)), px)
        turned = in_view(placed, scenario.camera, range_m, attitudes, px)
        usable = turned.usable.sum(axis=1)
        table["whole"][index] = square.whole.sum()
        table["usable"][index] = square.usable.sum()
        table["whole_mean"][index] = turned.whole.sum(axis=1).mean()
        table["usable_mean"][index] = usable.mean()
        table["usable_least"][index] = usable.min()
        table["none"][index] = (usable == 0).mean()
    dims = ("layout", "face_m", "range_m")
    coordinates = {
        "layout": list(LAYOUTS),
        "face_m": ("face_m", list(plan.faces_m), {"units": "m"}),
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
    }
    return xr.Dataset({k: (dims, v, {"units": "1"}) for k, v in table.items()}, coordinates)


def before_face(scenario: Scenario, lay: Layout, range_m: float, angles_rad: FloatArray) -> Scenario:
    """The scenario before a layout's face: its target's size and attitude, its largest marker for the exposure."""
    pitch, yaw, roll = np.degrees(angles_rad)
    target = {"face_m": lay.face_m, "facet_m": 0.02 * lay.face_m, "pitch_deg": pitch, "yaw_deg": yaw, "roll_deg": roll}
    return scenario.at(
        range_m=range_m,
        illumination="eclipse",
        marker=lay.placed[0].design.model_dump(),
        target={**scenario.target.model_dump(), **target},
    )


def face_rate(scenario: Scenario, lay: Layout, rays: int) -> FloatArray:
    """Mean electron rate (height, width) of a frame of a layout's face, LEDs alone [1/s]."""
    quality = Quality(scenario.render.frame_samples, rays, scenario.seed)
    return chain.electron_rate(scenario, render_face(chain.view(scenario), lay.placed, quality), "eclipse")


def face_exposure(scenario: Scenario, lay: Layout) -> float:
    """Automatic exposure of a face [s].

    It is that of a marker of the face's outer size at its centre, or of its inner size where that is too near to be seen whole.
    """
    budget = chain.link_budget(scenario, "eclipse")
    if np.isnan(budget.signal_rate):
        inner = scenario.at(marker=lay.placed[-1].design.model_dump())
        budget = chain.link_budget(inner, "eclipse")
    return chain.solve_exposure(scenario, budget, "auto")


def detect_layout(scenario: Scenario, image: NDArray[np.uint16], lay: Layout) -> FaceDetection:
    """Every marker of a layout that is found in a frame (height, width) [DN], and the face's pose."""
    return detect_face(
        image,
        [(p.design, p.centre_m) for p in lay.placed],
        scenario.camera,
        sensor=scenario.sensor,
        led_ring_radius_m=scenario.leds.ring_radius_m,
    )


def rendered(scenario: Scenario, plan: Plan, rng: np.random.Generator, progress: Progress | None = None) -> xr.Dataset:
    """Pose of the whole face from rendered frames with noise, LEDs alone; dimensions frame, solver.

    One entry a frame: kind, face_m, range_m, pitch, yaw and roll [deg], draw; usable and found markers; attitude_deg,
    range_error_m and lateral_error_m of the face's centre for 'one marker' and 'all markers', and their predicted deviations.
    """
    records: list[dict[str, object]] = []
    total = sum(len(case.ranges_m) for case in plan.cases) * plan.poses
    done = 0
    for case in plan.cases:
        lay = layout(case.kind, case.face_m, "scaled", scenario.marker)
        for range_m in case.ranges_m:
            for angles in random_attitudes(plan.poses, rng):
                for record in _frames(before_face(scenario, lay, range_m, angles), lay, angles, plan):
                    records.append({"kind": case.kind, "face_m": case.face_m, "range_m": range_m, **record})
                done += 1
                if progress is not None:
                    progress(done, total, "faces")
    return _dataset(records)


def _frames(here: Scenario, lay: Layout, angles_rad: FloatArray, plan: Plan) -> list[dict[str, object]]:
    """What is found in each noise draw of one attitude."""
    px = here.requirement.px_per_bit_min
    usable = in_view(lay.placed, here.camera, here.range_m, angles_rad[None], px).usable
    attitude = dict(zip(("pitch_deg", "yaw_deg", "roll_deg"), np.degrees(angles_rad), strict=True))
    rate, seconds = face_rate(here, lay, plan.rays), face_exposure(here, lay)
    records = []
    for draw in range(plan.draws):
        found = detect_layout(here, chain.expose(here, rate, "eclipse", seconds, draw).dn, lay)
        errors = [_errors(pose, here) for pose in (found.surest, found.pose)]
        counted = {"draw": draw, "usable": int(usable.sum()), "found": len(found.markers)}
        records.append({**counted, **attitude, "errors": np.array(errors)})
    return records


def shown_frames(scenario: Scenario, plan: Plan) -> dict[str, NDArray[np.uint16]]:
    """The plan's frames with noise, LEDs alone, by their titles."""
    frames = {}
    for shown in plan.shown:
        lay = layout(shown.kind, shown.face_m, "scaled", scenario.marker)
        here = before_face(scenario, lay, shown.range_m, np.radians(shown.attitude_deg))
        rate = face_rate(here, lay, plan.rays)
        frame = chain.expose(here, rate, "eclipse", face_exposure(here, lay)).dn
        frames[f"{shown.kind}, {shown.face_m:g} m face, {shown.range_m:g} m"] = frame
    return frames


def _errors(pose: Pose | None, here: Scenario) -> list[float]:
    """Values of `_ERRORS` in their order; NaN without a pose."""
    if pose is None:
        return [np.nan] * len(_ERRORS)
    away = pose.translation_m - np.array([0.0, 0.0, here.range_m])
    sigma = np.sqrt(np.diag(pose.covariance))
    return [
        float(np.degrees(rotation_angle(chain.view(here).rotation, pose.rotation))),
        float(abs(away[2])),
        float(np.hypot(*away[:2])),
        float(np.degrees(np.sqrt(np.sum(sigma[:3] ** 2)))),
        float(sigma[5]),
    ]


_ERRORS = {
    "attitude_deg": ("deg", "geodesic attitude error"),
    "range_error_m": ("m", "error of the face's centre along the optical axis"),
    "lateral_error_m": ("m", "error of the face's centre across it"),
    "attitude_predicted_deg": ("deg", "attitude error by the pose's own covariance, root of its trace"),
    "range_predicted_m": ("m", "deviation of the range by the pose's own covariance"),
}


def _dataset(records: Sequence[dict[str, object]]) -> xr.Dataset:
    errors = np.stack([np.asarray(r["errors"]) for r in records])
    columns = {key: np.array([r[key] for r in records]) for key in records[0] if key != "errors"}
    data: dict[str, object] = {key: ("frame", values) for key, values in columns.items()}
    for k, (name, (unit, text)) in enumerate(_ERRORS.items()):
        data[name] = (("frame", "solver"), errors[:, :, k], {"units": unit, "long_name": text})
    return xr.Dataset(data, {"solver": list(SOLVERS)})
