"""The system layout of section 6.1: markers in view over range and face, and the pose of the whole face by rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from detector.features import find_features
from detector.pose.joint import FoundMarker, moved_to_face, solve_face_pose
from detector.pose.pose import Pose, solve_pose
from detector.sensor.noise import noise_of
from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.layout.placement import LAYOUTS, Kind, Layout, in_view, layout, random_attitudes
from radiometry.geometry import FloatArray, rotation_angle
from scenes.face import render_face
from scenes.render.transport import Quality

#: A pose from one marker or from all.
SOLVERS = ("one marker", "all markers")


@dataclass(frozen=True)
class Plan:
    """What is counted and what is rendered.

    Attributes:
        faces_m, ranges_m, attitudes: of the counts.
        cases: kind, side of the face [m] and ranges [m] that are rendered.
        poses, draws: attitudes rendered of each case and range, and noise draws of each.
        rays: on each marker.
    """

    faces_m: tuple[float, ...]
    ranges_m: tuple[float, ...]
    attitudes: int
    cases: tuple[tuple[Kind, float, tuple[float, ...]], ...]
    poses: int
    draws: int
    rays: int


_NEAR = (1.0, 2.0, 3.0, 5.0, 8.0, 10.0, 12.0, 15.0)
FULL = Plan(
    (1.0, 2.0, 5.0, 10.0), tuple(float(r) for r in range(1, 21)), 400,
    (("wide", 1.0, _NEAR), ("narrow", 1.0, _NEAR)), 6, 4, 500_000,
)  # fmt: skip
QUICK = Plan((1.0, 10.0), (1.0, 5.0, 20.0), 20, (("wide", 1.0, (5.0,)),), 1, 1, 60_000)


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
        values = (square.whole.sum(), square.usable.sum(), turned.whole.sum(axis=1).mean(), usable.mean(), usable.min(),
                  (usable == 0).mean())  # fmt: skip
        for name, value in zip(names, values, strict=True):
            table[name][index] = value
    dims = ("layout", "face_m", "range_m")
    coordinates = {
        "layout": list(LAYOUTS),
        "face_m": ("face_m", list(plan.faces_m), {"units": "m"}),
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
    }
    return xr.Dataset({k: (dims, v, {"units": "1"}) for k, v in table.items()}, coordinates)


def posed(scenario: Scenario, lay: Layout, range_m: float, angles_rad: FloatArray) -> Scenario:
    """The scenario before a layout's face: its target's size and attitude, its largest marker for the exposure."""
    pitch, yaw, roll = np.degrees(angles_rad)
    target = {"face_m": lay.face_m, "facet_m": 0.02 * lay.face_m, "pitch_deg": pitch, "yaw_deg": yaw, "roll_deg": roll}
    return scenario.at(
        range_m=range_m,
        illumination="eclipse",
        marker=lay.placed[0].design.model_dump(),
        target={**scenario.target.model_dump(), **target},
    )


@dataclass(frozen=True)
class Sight:
    """What is found of a face in one frame: markers, the pose of the surest alone, the pose of all."""

    found: tuple[FoundMarker, ...]
    one: Pose | None
    every: Pose | None


def look_at_face(scenario: Scenario, image: NDArray[np.uint16], lay: Layout) -> Sight:
    """Find every marker of a layout in a frame and solve the face's pose.

    'One marker' is the one whose own covariance gives the smallest attitude error, which needs no truth to choose.
    """
    camera, noise = chain.view(scenario).camera, noise_of(scenario.sensor, image)
    found = tuple(
        FoundMarker(features, p.design, p.centre_m)
        for p in lay.placed
        if (features := find_features(image, p.design, camera, noise, scenario.leds.ring_radius_m)).detected
    )
    singles = [
        moved_to_face(pose, f.centre_m) for f in found if (pose := solve_pose(f.features, f.marker, camera)) is not None
    ]
    surest = min(singles, key=lambda pose: float(np.trace(pose.covariance[:3, :3])), default=None)
    return Sight(found, surest, solve_face_pose(found, camera))


def rendered(scenario: Scenario, plan: Plan, rng: np.random.Generator, progress: Progress | None = None) -> xr.Dataset:
    """Pose of the whole face from rendered frames with noise, LEDs alone; dimensions frame, solver.

    One entry a frame: kind, face_m, range_m, pitch, yaw and roll [deg], draw; usable and found markers; attitude_deg,
    range_error_m and lateral_error_m of the face's centre for 'one marker' and 'all markers', and their predicted deviations.
    """
    records: list[dict[str, object]] = []
    total = sum(len(ranges) for _, _, ranges in plan.cases) * plan.poses
    done = 0
    for kind, face_m, ranges in plan.cases:
        lay = layout(kind, face_m, "scaled", scenario.marker)
        for range_m in ranges:
            for angles in random_attitudes(plan.poses, rng):
                here = posed(scenario, lay, range_m, angles)
                usable = in_view(lay.placed, here.camera, range_m, angles[None], here.requirement.px_per_bit_min).usable
                quality = Quality(scenario.render.frame_samples, plan.rays, scenario.seed)
                view = chain.view(here)
                rate = chain.electron_rate(here, render_face(view, lay.placed, quality), "eclipse")
                seconds = exposure(here, lay)
                for draw in range(plan.draws):
                    sight = look_at_face(here, chain.expose(here, rate, "eclipse", seconds, draw).dn, lay)
                    record: dict[str, object] = {
                        "kind": kind, "face_m": face_m, "range_m": range_m, "draw": draw,
                        "usable": int(usable.sum()), "found": len(sight.found),
                    }  # fmt: skip
                    record |= dict(zip(("pitch_deg", "yaw_deg", "roll_deg"), np.degrees(angles), strict=True))
                    errors = [_errors(pose, view.rotation, range_m) for pose in (sight.one, sight.every)]
                    record["errors"] = np.array(errors)
                    records.append(record)
                done += 1
                if progress is not None:
                    progress(done, total, "faces")
    return _dataset(records)


def exposure(scenario: Scenario, lay: Layout) -> float:
    """Automatic exposure of a face [s]: that of a marker of its outer size at the centre, or of its inner size where that is
    too near to be seen whole."""
    budget = chain.link_budget(scenario, "eclipse")
    if np.isnan(budget.signal_rate):
        inner = scenario.at(marker=lay.placed[-1].design.model_dump())
        budget = chain.link_budget(inner, "eclipse")
    return chain.solve_exposure(scenario, budget, "auto")


def _errors(pose: Pose | None, rotation: FloatArray, range_m: float) -> list[float]:
    """Attitude [deg], range and lateral error of the face's centre [m]; predicted deviations of attitude [deg], range [m]."""
    if pose is None:
        return [np.nan] * 5
    away = pose.translation_m - np.array([0.0, 0.0, range_m])
    sigma = np.sqrt(np.diag(pose.covariance))
    predicted = np.degrees(np.sqrt(np.sum(sigma[:3] ** 2)))
    return [
        float(np.degrees(rotation_angle(rotation, pose.rotation))), float(abs(away[2])), float(np.hypot(*away[:2])),
        float(predicted), float(sigma[5]),
    ]  # fmt: skip


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


def run(scenario: Scenario, quick: bool = False, progress: Progress | None = None) -> xr.DataTree:
    """Counts and rendered poses, groups 'counts' and 'rendered'."""
    plan = QUICK if quick else FULL
    first, second = np.random.default_rng((scenario.seed, 61)).spawn(2)
    tree = xr.DataTree.from_dict(
        {"counts": counts(scenario, plan, first), "rendered": rendered(scenario, plan, second, progress)}
    )
    tree.attrs |= chain.provenance(scenario)
    return tree
