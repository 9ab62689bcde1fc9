"""Scatter and bias of corners, blobs and pose over noise draws of rendered frames, beside their Cramér–Rao bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from detector.detect import detect
from detector.pose.bounds import blob_bound, corner_bound, pose_bound
from detector.sensor.sensor import expose
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.features.plan import Plan
from experiments.studies.shared.frames import Case
from experiments.studies.shared.truth import Truth
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES

#: Sub-pixel position at which the bounds are taken: they change by a few percent from one to another.
BOUND_SHIFT_PX = (0.25, 0.25)
#: A blob narrower than this is outside the target [px].
WIDE_ENOUGH_PX = 3.0

#: Unit and long name of every variable of `run`, dimensions range_m and pitch_deg, and `element` for the blobs.
VARIABLES: dict[str, tuple[str, str]] = {
    "blob_width_px": ("pixel", "width of the blobs at half their height"),
    "bit_px": ("pixel", "pixels along the shorter side of a bit"),
    "found": ("1", "share of frames in which the marker was found"),
    "corner_bound_px": ("pixel", "Cramér–Rao bound of a corner's coordinate, rms over the eight"),
    "corner_scatter_px": ("pixel", "scatter of a corner's coordinate over noise draws, rms over the eight"),
    "corner_stated_px": ("pixel", "standard deviation that the detector states, rms over the eight"),
    "corner_bias_px": ("pixel", "mean error of a corner over noise and sub-pixel positions, the worst of the four"),
    "corner_aliasing_px": ("pixel", "rms of a corner's mean error over sub-pixel positions, bias and noise taken out"),
    "blob_found": ("1", "share of frames in which the blob was found"),
    "blob_bound_px": ("pixel", "Cramér–Rao bound of the blob along its element"),
    "blob_scatter_px": ("pixel", "scatter of the blob over noise draws"),
    "blob_stated_px": ("pixel", "standard deviation that the detector states of the blob"),
    "blob_bias_px": ("pixel", "mean error of the blob along its element over noise and sub-pixel positions"),
    "blob_aliasing_px": ("pixel", "rms of the blob's mean error over sub-pixel positions, bias and noise taken out"),
    "attitude_bound_deg": ("degree", "Cramér–Rao bound of the attitude, root of the sum over three axes"),
    "attitude_scatter_deg": ("degree", "scatter of the attitude over noise draws"),
    "attitude_stated_deg": ("degree", "standard deviation of the attitude that the pose solver states"),
    "attitude_bias_deg": ("degree", "mean error of the attitude over noise and sub-pixel positions"),
    "range_bound_m": ("m", "Cramér–Rao bound of the range"),
    "range_scatter_m": ("m", "scatter of the range over noise draws"),
    "range_stated_m": ("m", "standard deviation of the range that the pose solver states"),
    "range_bias_m": ("m", "mean error of the range over noise and sub-pixel positions"),
}
#: Those with a value for each element.
PER_ELEMENT = frozenset(name for name in VARIABLES if name.startswith("blob_") and name != "blob_width_px")


@dataclass(frozen=True)
class ShiftedFrames:
    """One geometry at some sub-pixel positions, before it is exposed.

    Attributes:
        rates: electron rates (shifts, height, width) [e⁻/s].
        shifts_px: positions (shifts, 2).
        seconds: exposure.
    """

    scenario: Scenario
    truth: Truth
    rates: FloatArray
    shifts_px: FloatArray
    seconds: float

    @classmethod
    def of(cls, case: Case, shifts_px: FloatArray) -> ShiftedFrames:
        """A case at some positions (shifts, 2)."""
        rates = np.array([case.fine.image(tuple(s)) for s in shifts_px])
        return cls(case.scenario, case.truth, rates, shifts_px, case.exposure.seconds)


@dataclass(frozen=True)
class Errors:
    """Errors (shifts, draws, coordinates) of one geometry's frames, NaN where not found, and what is stated of them.

    Attributes:
        corners: of eight coordinates [px].
        blobs: of four blobs along their elements [px].
        pose: rotation vector [rad], then the translation [m], six together.
        corners_sigma, blobs_sigma, pose_sigma: standard deviations that detector and pose solver state.
    """

    corners: FloatArray
    corners_sigma: FloatArray
    blobs: FloatArray
    blobs_sigma: FloatArray
    pose: FloatArray
    pose_sigma: FloatArray


def measure(frames: ShiftedFrames, draws: int, seed: int) -> Errors:
    """Errors over noise draws: the frame at each position is exposed `draws` times and searched."""
    scenario, shape = frames.scenario, (len(frames.rates), draws)
    sizes = {"corners": 8, "corners_sigma": 8, "blobs": 4, "blobs_sigma": 4, "pose": 6, "pose_sigma": 6}
    out = {name: np.full((*shape, size), np.nan) for name, size in sizes.items()}
    rng = np.random.default_rng(seed)
    for i, j in np.ndindex(shape):
        image = expose(scenario.sensor, frames.rates[i], frames.seconds, rng).dn
        here = {name: values[i, j] for name, values in out.items()}
        _errors(scenario, frames.truth, image, tuple(frames.shifts_px[i]), here)
    return Errors(**out)


def _errors(
    scenario: Scenario, truth: Truth, frame: FloatArray, shift: tuple[float, float], out: dict[str, FloatArray]
) -> None:
    """Fill in the errors of one frame, whose image is moved by a shift."""
    ring_m = scenario.leds.ring_radius_m
    found = detect(frame, scenario.marker, truth.view.camera, sensor=scenario.sensor, led_ring_radius_m=ring_m)
    features, pose = found.features, found.pose
    if features.corners_px is None or features.joint_covariance_px2 is None:
        return
    out["corners"][:] = (features.corners_px - truth.corners_px - shift).ravel()
    out["corners_sigma"][:] = np.sqrt(np.diag(features.joint_covariance_px2))
    for k, name in enumerate(ELEMENT_NAMES):
        place = features.blobs_px[name]
        if place is not None:
            along = truth.along_px[name] / np.linalg.norm(truth.along_px[name])
            out["blobs"][k] = (place - truth.blobs_px[name] - shift) @ along
            out["blobs_sigma"][k] = features.blob_sigma_px[name]
    if pose is not None:
        rotation, translation = truth.pose(shift)
        out["pose"][:3] = Rotation.from_matrix(pose.rotation @ rotation.T).as_rotvec()
        out["pose"][3:] = pose.translation_m - translation
        out["pose_sigma"][:] = np.sqrt(np.diag(pose.covariance))


def scatter(errors: FloatArray) -> FloatArray:
    """Standard deviation over draws about the mean of their own sub-pixel position, pooled: (shifts, draws, k) -> (k,)."""
    count = np.isfinite(errors).sum(axis=1)
    return np.sqrt(
        _sum((errors - _mean(errors, 1)[:, None]) ** 2, (0, 1)) / np.maximum((count - 1).clip(0).sum(axis=0), 1)
    )


def aliasing(errors: FloatArray) -> FloatArray:
    """Standard deviation of the mean error over sub-pixel positions, less what noise leaves in it: (shifts, draws, k) -> (k,)."""
    means = _mean(errors, 1)
    noise = scatter(errors) ** 2 / np.maximum(np.isfinite(errors).sum(axis=1).mean(axis=0), 1)
    spread = _sum((means - _mean(means, 0)) ** 2, 0) / np.maximum(np.isfinite(means).sum(axis=0) - 1, 1)
    return np.sqrt(np.maximum(spread - noise, 0.0))


def _sum(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    return np.where(np.isfinite(values).any(axis=axis), np.nansum(values, axis=axis), np.nan)


def _mean(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    count = np.isfinite(values).sum(axis=axis)
    return _sum(values, axis) / np.maximum(count, 1)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def summarise(case: Case, errors: Errors, bounds: dict[str, FloatArray]) -> dict[str, FloatArray | float]:
    """Everything in `VARIABLES` of one geometry."""
    corner_bias = np.linalg.norm(_mean(errors.corners, (0, 1)).reshape(4, 2), axis=1)
    turn, range_bias = _mean(errors.pose, (0, 1))[:3], float(_mean(errors.pose, (0, 1))[5])
    spread, stated = scatter(errors.pose), np.sqrt(_mean(errors.pose_sigma**2, (0, 1)))
    return {
        "blob_width_px": case.truth.blob_width_px,
        "bit_px": case.truth.px_per_bit,
        "found": float(np.isfinite(errors.corners[..., 0]).mean()),
        "corner_bound_px": _rms(bounds["corners"]),
        "corner_scatter_px": _rms(scatter(errors.corners)),
        "corner_stated_px": float(np.sqrt(_mean(errors.corners_sigma**2, (0, 1, 2)))),
        "corner_bias_px": float(corner_bias.max()),
        "corner_aliasing_px": _rms(aliasing(errors.corners)),
        "blob_found": np.isfinite(errors.blobs).mean(axis=(0, 1)),
        "blob_bound_px": bounds["blobs"],
        "blob_scatter_px": scatter(errors.blobs),
        "blob_stated_px": np.sqrt(_mean(errors.blobs_sigma**2, (0, 1))),
        "blob_bias_px": _mean(errors.blobs, (0, 1)),
        "blob_aliasing_px": aliasing(errors.blobs),
        "attitude_bound_deg": float(np.degrees(np.linalg.norm(bounds["pose"][:3]))),
        "attitude_scatter_deg": float(np.degrees(np.linalg.norm(spread[:3]))),
        "attitude_stated_deg": float(np.degrees(np.linalg.norm(stated[:3]))),
        "attitude_bias_deg": float(np.degrees(np.linalg.norm(turn))),
        "range_bound_m": float(bounds["pose"][5]),
        "range_scatter_m": float(spread[5]),
        "range_stated_m": float(stated[5]),
        "range_bias_m": range_bias,
    }


def bounds_of(case: Case, illumination: str) -> dict[str, FloatArray]:
    """Standard deviations at the bound: corners (8,) [px], blobs (4,) along their elements [px], pose (6,) [rad, m]."""
    marker, truth, shift = case.scenario.marker, case.truth, BOUND_SHIFT_PX
    before, after, step = case.beside(illumination)
    corners = corner_bound(case.fine, marker, truth.corners_px, case.exposure, shift)
    blobs = [
        blob_bound(
            fine=case.fine,
            before=before,
            after=after,
            step_m=step,
            marker=marker,
            element=element,
            corners_px=truth.corners_px,
            exposure=case.exposure,
            shift_px=shift,
        )
        * float(np.linalg.norm(truth.along_px[element.name]))
        for element in marker.elements
    ]
    pose = pose_bound(
        fine=case.fine,
        orbit=case.orbit(illumination),
        marker=marker,
        camera=truth.view.camera,
        translation_m=truth.view.translation_m,
        corners_px=truth.corners_px,
        exposure=case.exposure,
        shift_px=shift,
    )
    return {"corners": np.sqrt(np.diag(corners)), "blobs": np.array(blobs), "pose": np.sqrt(np.diag(pose))}


def run(scenario: Scenario, plan: Plan, workers: int | None = None, progress: Progress | None = None) -> xr.Dataset:
    """Bounds, scatter and bias over range and pitch, in eclipse; each geometry at some sub-pixel positions and noise draws."""
    illumination = "eclipse"
    grid = [(r, p) for r in plan.ranges_m for p in plan.pitches_deg]
    places = np.random.default_rng(scenario.seed).uniform(-0.5, 0.5, (plan.shifts, 2))
    rows = []
    with pool(measure, workers) as submit:
        waiting = []
        for k, (range_m, pitch) in enumerate(grid):
            if progress is not None:
                progress(k, len(grid), f"{range_m:g} m, {pitch:g}°")
            target = {**scenario.target.model_dump(), "pitch_deg": pitch}
            case = Case.of(scenario.at(range_m=range_m, target=target, illumination=illumination), illumination)
            job = submit(ShiftedFrames.of(case, places), plan.draws, scenario.seed + k)
            waiting.append((case, job, bounds_of(case, illumination)))
        rows = [summarise(case, job.result(), bounds) for case, job, bounds in waiting]
    return _dataset(grid, rows)


def _dataset(grid: list[tuple[float, float]], rows: list[dict[str, FloatArray | float]]) -> xr.Dataset:
    ranges, pitches = sorted({r for r, _ in grid}), sorted({p for _, p in grid})
    places = [(ranges.index(r), pitches.index(p)) for r, p in grid]
    data = {}
    for name, (unit, label) in VARIABLES.items():
        dims = ("range_m", "pitch_deg", "element") if name in PER_ELEMENT else ("range_m", "pitch_deg")
        values = np.full((len(ranges), len(pitches), *((4,) if name in PER_ELEMENT else ())), np.nan)
        for place, row in zip(places, rows, strict=True):
            values[place] = row[name]
        data[name] = (dims, values, {"units": unit, "long_name": label})
    coordinates = {
        "range_m": ("range_m", ranges, {"units": "m"}),
        "pitch_deg": ("pitch_deg", pitches, {"units": "degree"}),
        "element": list(ELEMENT_NAMES),
    }
    return xr.Dataset(data, coordinates)
