"""The page of `mantis features`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from detector.version import code_version
from experiments.chain.statistics import binomial_interval
from experiments.reporting.blocks import Block, Bullets, Plot, Plots, Section, Text, csv_text, text_table
from experiments.reporting.page import Page
from experiments.studies.features import figures, tables
from experiments.studies.features.clutter import KINDS, QUARTER
from experiments.studies.features.detection import AT_PX_PER_BIT, PX_PER_BIT_OF_CNR, TILT_DEG, has_apriltags
from experiments.studies.features.study import FeaturesResult

HOW = (
    "The Fisher information is F_ij = Σ ∂_iμ ∂_jμ / σ² over the pixels, with μ the rendered mean electron image and σ² its shot, "
    "dark, read and quantisation noise. The bound is F⁻¹, with the nuisance parameters in F (detector/pose/bounds.py).",
    "Corners: any homography of the printed pattern, eight parameters. Nuisance parameters are the brightness of the pattern, "
    "the background, and brightness and place of each element's light. The whole face of the marker is used.",
    "Blobs: the virtual lines are moved and rendered again, the openings stay. Nuisance parameters are the brightness of blob, "
    "pattern and surroundings, and the background. A blob may scatter by less than its bound where its error changes with its "
    "place among the slits: the bound holds for estimates without bias.",
    "Pose: three turns of the camera move the image as a plane, which is exact; pitch, yaw and range are rendered on either "
    "side. Nuisance parameters are the brightness of the pattern and of each element, and the background.",
    "Frames are rendered on sub-pixels before the lens's blur, so that one rendering gives every sub-pixel position. The scatter "
    "is that of the noise draws about the mean of their own position.",
)
_CALIBRATED = {
    "elements": "Elements: one of them 1 mm off (mantis calibrate elements)",
    "camera": "Camera without distortion (mantis calibrate camera)",
    "distorted camera": "Camera with distortion",
}


def page(result: FeaturesResult, command: str) -> Page:
    """Targets first, then each part's figure and table, then how it was done."""
    found = tables.targets(result.accuracy, result.detection, result.clutter, result.trials)
    line = tables.headline(found)
    missed = any(target.met is False for target in found)
    return Page(
        study="features",
        title="Features, their limits, and calibration",
        headline=line,
        passed=not missed,
        command=command,
        sections=(_verdict(found), *_sections(result)),
        about=(
            "How well are corners, blobs and pose measured, how often is the marker found, and is it ever found where there is "
            "none? Every number comes from rendered frames with sensor noise.",
        ),
        scenario=result.scenario,
        data=result.dataset,
        unmet={"targets": line} if missed else {},
        extra={"targets": [vars(target) for target in found]},
        files=_files(result),
    )


def _verdict(found: list[tables.Target]) -> Section:
    rows = [tables.TARGET_HEADINGS, *tables.target_rows(found)]
    return Section("verdict", "Verdict", (text_table(rows, "Targets", terminal=True),), wordy=True)


def _sections(result: FeaturesResult) -> tuple[Section, ...]:
    accuracy: tuple[Block, ...] = (
        _plot(
            "scatter",
            figures.scatter_figure(result.accuracy),
            "Scatter over noise draws, over the Cramér–Rao bound, against range; one line for each pitch. Dashed: the target, "
            "1.5.",
        ),
        _plot(
            "bound",
            figures.bound_figure(result.accuracy),
            "Bounds (lines) and scatter (markers) against range at each pitch.",
        ),
        _plot(
            "bias",
            figures.bias_figure(result.accuracy),
            "Mean error over noise and sub-pixel positions against pitch: worst corner and worst blob. Dashed: the target.",
        ),
        Text((_accuracy_text(result),)),
        text_table([tables.ACCURACY_HEADINGS, *tables.accuracy_rows(result.accuracy)]),
    )
    detection = _plot(
        "detection",
        figures.detection_figure(result.detection),
        "Frames with the marker found, with 95 % binomial intervals: against size at 'auto' exposure (dashed: 2 px/bit) and "
        "against contrast. Every detector of a family sees the same frames.",
    )
    clutter = text_table([tables.CLUTTER_HEADINGS, *tables.clutter_rows(result.clutter)])
    how = Bullets((*HOW, f"Detector code: {code_version()}."))
    return (
        Section("accuracy", "Scatter beside the Cramér–Rao bound", accuracy),
        Section("detection", "Detection", (detection, Text((_detection_text(result),)))),
        Section("clutter", "Frames without the marker", (clutter, Text((_clutter_text(result),)))),
        *_calibration(result),
        Section("how", "How the bounds are made", (how,)),
    )


def _plot(key: str, figure: Figure, caption: str) -> Plots:
    return Plots((Plot(key, figure, caption),), caption)


def _calibration(result: FeaturesResult) -> tuple[Section, ...]:
    if not result.trials:
        return ()
    blocks = tuple(
        text_table([tables.TRIAL_HEADINGS, *tables.trial_rows(trials)], _CALIBRATED[name])
        for name, trials in result.trials.items()
    )
    return (Section("calibration", "Calibration", blocks),)


def _accuracy_text(result: FeaturesResult) -> str:
    plan = result.plan
    known = 100 / (2 * plan.shifts * (plan.draws - 1)) ** 0.5
    return (
        f"In eclipse at 'auto' exposure, {plan.shifts} sub-pixel positions × {plan.draws} noise draws of each geometry: the "
        f"ratio of one coordinate is known to some {known:.0f} %. Blobs are given as the root mean square over those found, and "
        "as the worst bias; attitude as the root of the sum over three axes."
    )


def _detection_text(result: FeaturesResult) -> str:
    plan, frames = result.plan, result.detection.frames_by_size.sel
    others = "" if has_apriltags() else " pupil-apriltags was not installed."
    at_target = (
        f" At {AT_PX_PER_BIT:g} px/bit there are {int(frames(px_per_bit=AT_PX_PER_BIT))}, of {plan.attitudes_at_target} "
        "attitudes, so that the interval tells whether 99 % is met."
        if plan.attitudes_at_target > plan.attitudes
        else ""
    )
    return (
        f"Each point is of {plan.attitudes * plan.attitude_shifts * plan.attitude_draws} frames: {plan.attitudes} attitudes "
        f"(tilts up to {TILT_DEG:g}°, any roll), each at {plan.attitude_shifts} sub-pixel positions × {plan.attitude_draws} "
        f"draws.{at_target} Brackets and bars are exact 95 % intervals. Found means the right identity within a bit of its "
        f"place. Contrast is varied at {PX_PER_BIT_OF_CNR:g} px/bit by the exposure. OpenCV's ArUco and pupil-apriltags get the "
        f"same frames stretched to 8 bits, with default settings but no decimation.{others} The time that our detector takes "
        "beside OpenCV's is measured by python -m benchmarks detector."
    )


def _clutter_text(result: FeaturesResult) -> str:
    plan, camera = result.plan, result.scenario.camera
    return (
        f"{plan.free_whole} frames are of the whole detector, {camera.width_px} × {camera.height_px} px; {plan.free_quarters} "
        "are of its middle quarter, which costs as much less. Together they have the area of "
        f"{plan.free_whole + plan.free_quarters // QUARTER**2} whole frames. Half of either are rendered ({KINDS[0]}: "
        f"{plan.free_renders} faces that differ in crinkle, material, range, tilt and Sun, with glints, mirrored and moved), "
        "half are drawn. Exposures go from nearly dark to nearly all saturated. 'Other identities' shows 25 markers of the same "
        "dictionary in a frame: there, naming one is right."
    )


def _files(result: FeaturesResult) -> dict[str, str]:
    """Every part as CSV."""
    per_blob = [name for name in result.accuracy if "element" in result.accuracy[name].dims]
    parts = {
        "accuracy": _columns(result.accuracy.drop_vars([*per_blob, "element"])),
        "blobs": _columns(result.accuracy[per_blob]),
        "detection": _detection_columns(result.detection),
        "clutter": _columns(result.clutter),
    }
    if result.trials:
        rows = [(part, t.what, t.unit, t.true, t.found, t.sigma) for part, ts in result.trials.items() for t in ts]
        names = ("calibration", "parameter", "unit", "true", "found", "sigma")
        parts["calibration"] = dict(zip(names, zip(*rows, strict=True), strict=True))
    return {
        f"data/features-{part}.csv": csv_text(
            {key: [_five_digits(v) for v in values] for key, values in columns.items()}
        )
        for part, columns in parts.items()
    }


def _five_digits(value: Any) -> Any:
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else value


def _columns(data: xr.Dataset) -> dict[str, Iterable[Any]]:
    """Coordinates and variables of a dataset as columns, one row a cell."""
    table = data.to_dataframe().reset_index()
    return {str(name): table[name].to_list() for name in table}


def _detection_columns(found: xr.Dataset) -> dict[str, Iterable[Any]]:
    """Counts with their interval, one row a family, detector and step of either axis."""
    rows = []
    for name, axis in (("size", "px_per_bit"), ("cnr", "cnr")):
        frames = found[f"frames_by_{name}"].values
        for family in found.family.values:
            for detector in found.detector.values:
                counts = found[f"found_by_{name}"].sel(family=family, detector=detector)
                low, high = binomial_interval(counts.values, frames)
                for at, n, count, a, b in zip(counts[axis].values, frames, counts.values, low, high, strict=True):
                    if np.isfinite(count):
                        rows.append((axis, float(at), str(family), str(detector), int(n), int(count), a, b))
    names = ("axis", "value", "family", "detector", "frames", "found", "low95", "high95")
    return dict(zip(names, zip(*rows, strict=True), strict=True))
