"""The page of the study of features."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from experiments.studies.features import tables
from experiments.studies.features.clutter import KINDS, QUARTER
from experiments.studies.features.detection import AT_PX_PER_BIT, PX_PER_BIT_OF_CNR, TILT_DEG, has_apriltags
from experiments.studies.features.figures import CAPTIONS

if TYPE_CHECKING:
    from experiments.studies.features.study import Result


def page(result: Result, command: str, made: Mapping[str, str | float]) -> str:
    """Verdict first, then each part's figure and table, then how it was done; `made` says with what, see `chain.provenance`."""
    found = tables.targets(result.accuracy, result.detection, result.clutter, result.trials)
    parts = [
        "# Features, their limits, and calibration",
        f"Made by `{command}`; every number of this page comes from that run, from rendered frames with sensor noise. Software: "
        f"{made['software']} ({made['versions']}); scenario {made['scenario_hash']}; detector code {made['detector_code']}.",
        "## Verdict", tables.headline(found), tables.markdown(tables.TARGET_HEADINGS, tables.target_rows(found)),
        "## Scatter beside the Cramér–Rao bound", _image("scatter"), _image("bound"), _image("bias"),
        _accuracy_words(result), tables.markdown(tables.ACCURACY_HEADINGS, tables.accuracy_rows(result.accuracy)),
        "## Detection", _image("detection"), _detection_words(result),
        "## Frames without the marker", tables.markdown(tables.CLUTTER_HEADINGS, tables.clutter_rows(result.clutter)),
        _clutter_words(result), *_calibration_parts(result),
        "## How the bounds are made", *(f"- {line}" for line in HOW),
    ]  # fmt: skip
    return "\n\n".join(parts).replace("\n\n- ", "\n- ") + "\n"


HOW = (
    "F_ij = Σ ∂_iμ ∂_jμ / σ² over the pixels, μ the rendered mean electron image, σ² its shot, dark, read and quantisation "
    "noise; the bound is F⁻¹, with the nuisance parameters in F (`detector/pose/bounds.py`).",
    "Corners: any homography of the printed pattern, eight parameters; nuisance: brightness of the pattern, background, and of "
    "each element's light its brightness and its place. Used is the whole face of the marker.",
    "Blobs: the virtual lines are moved and rendered again, the openings stay; nuisance: brightness of blob, pattern and "
    "surroundings, and the background. A blob may scatter by less than its bound where its error changes with its place among "
    "the slits: the bound holds for estimates without bias.",
    "Pose: three turns of the camera are motions of the image as a plane, exact; pitch, yaw and range are rendered on either "
    "side. Nuisance: brightness of the pattern and of each element, and the background.",
    "Frames are rendered on sub-pixels before the lens's blur, so that one rendering gives every sub-pixel position; the scatter "
    "is that of the noise draws about the mean of their own position.",
)


def _image(name: str) -> str:
    return f"![{CAPTIONS[name]}](figures/features-{name}.svg)\n\n*{CAPTIONS[name]}*"


def _accuracy_words(result: Result) -> str:
    plan = result.plan
    known = 100 / (2 * plan.shifts * (plan.draws - 1)) ** 0.5
    return (
        f"Eclipse, 'auto' exposure, {plan.shifts} sub-pixel positions × {plan.draws} noise draws of each geometry: the ratio of "
        f"one coordinate is known to some {known:.0f} %. Blobs: root mean square over those found, and the worst bias. Attitude: "
        "the root of the sum over three axes."
    )


def _detection_words(result: Result) -> str:
    plan, frames = result.plan, result.detection.frames_by_size.sel
    others = "" if has_apriltags() else " pupil-apriltags was not installed."
    at_target = (
        f" At {AT_PX_PER_BIT:g} px/bit there are {int(frames(px_per_bit=AT_PX_PER_BIT))}, of {plan.attitudes_at_target} "
        "attitudes, so that the interval tells whether 99 % is met."
        if plan.attitudes_at_target > plan.attitudes
        else ""
    )
    return (
        f"{plan.attitudes * plan.attitude_shifts * plan.attitude_draws} frames a point: {plan.attitudes} attitudes (tilts up to "
        f"{TILT_DEG:g}°, any roll), each at {plan.attitude_shifts} sub-pixel positions × {plan.attitude_draws} draws.{at_target} "
        "Brackets and bars are exact 95 % intervals. Found means the right identity within a bit of its place. Contrast is "
        f"varied at {PX_PER_BIT_OF_CNR:g} px/bit by the exposure. OpenCV's ArUco and pupil-apriltags get the same frames "
        f"stretched to 8 bits, with default settings but no decimation.{others} The time that our detector takes beside "
        "OpenCV's is measured by `python -m benchmarks detector`."
    )


def _clutter_words(result: Result) -> str:
    plan, camera = result.plan, result.scenario.camera
    return (
        f"{plan.free_whole} frames are the whole detector, {camera.width_px} × {camera.height_px} px, {plan.free_quarters} its "
        "middle quarter, which costs as much less: together the area of "
        f"{plan.free_whole + plan.free_quarters // QUARTER**2} whole frames. Half of either are rendered ({KINDS[0]}: "
        f"{plan.free_renders} faces of other crinkle, material, range, tilt and Sun, with glints, mirrored and moved), half "
        "drawn; exposures from nearly dark to nearly all saturated. 'Other identities' shows 25 markers of the same dictionary "
        "a frame: there, naming one is right."
    )


def _calibration_parts(result: Result) -> list[str]:
    if not result.trials:
        return []
    words = {
        "elements": "### Elements: one of them 1 mm off (`mantis calibrate elements`)",
        "camera": "### Camera without distortion (`mantis calibrate camera`)",
        "distorted camera": "### Camera with distortion",
    }
    parts = ["## Calibration"]
    for name, trials in result.trials.items():
        parts += [words[name], tables.markdown(tables.TRIAL_HEADINGS, tables.trial_rows(trials))]
    return parts
