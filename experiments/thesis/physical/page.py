"""The physical experiment told: verdict, printed beside reproduced and right, tables, figures and what is a reconstruction."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from experiments.reporting.claims import StudyPage
from experiments.reporting.formatting import number, seconds_text
from experiments.scenario import Scenario
from experiments.thesis.physical import arm, figures
from experiments.thesis.physical.claims import statements
from experiments.thesis.physical.study import NEAR_PHASE_DEG, Outcome, Progress, run
from experiments.thesis.physical.summary import (
    beside,
    camera_rows,
    failure_rows,
    level_rows,
    mean,
    outliers,
    pass_rows,
    rms,
    series,
    sharpness_rows,
)

CAPTIONS = {
    "yaw": "Yaw over frame number, frames as taken, by the thesis's pipeline (figure 8.11): rows are lights, columns passes",
    "yaw-scaled": "The same, frames scaled as in section 7.1.5 (figure 8.12)",
    "yaw-mantis": "Yaw over frame number of the scaled frames, by this project's detector",
    "error": "Yaw error over true yaw in eclipse, all passes, frames as taken and scaled",
    "trajectories": "Lines of the arm (figure 7.5, reconstructed), marker and lamp",
    "frames": "Frames as the thesis's pipeline gets them, 8 bits (figures 8.13 and 7.6)",
    "lamp": "Blobs found over the lamp's level, and over the lens's sharpness",
}
TABLES = {
    "passes": "Every pass by every method, both lights, frames as taken and scaled",
    "failures": "Frames with each failure mode of thesis section 8.3, and what it costs",
    "camera": "The camera: true, and calibrated from rendered chessboards",
    "levels": "Blobs found of four over the lamp's level, means of the stations tried",
    "sharpness": "Blobs found of four over the lens's point spread, one frame each",
}
ABOUT = (
    "The thesis drove a camera on a robotic arm past a prototype on a mock-up (sections 7.1 and 8.2). Here arm, "
    "camera, LEDs, lamp "
    "and mock-up are rendered, the camera is calibrated from rendered chessboards, every pose is solved with that "
    "calibration, and "
    "both softwares look at the same frames.",
)


def study(
    scenario: Scenario, out: Path, command: str, quick: bool = False, workers: int | None = None,
    progress: Progress | None = None,
) -> StudyPage:  # fmt: skip
    """Run and write physical.nc, physical.md, report.html, data/physical*.csv and figures/physical-*.svg into a folder.

    Groups of physical.nc: `frames`, `levels` and `sharpness`.
    """
    outcome = run(scenario, quick, workers, progress)
    page = study_page(outcome, command, quick)
    groups = {"frames": outcome.frames, "levels": outcome.levels, "sharpness": outcome.sharpness}
    page.write(out, xr.DataTree.from_dict(groups))
    return page


def study_page(outcome: Outcome, command: str, quick: bool = False) -> StudyPage:
    """The page as data."""
    frames = outcome.frames
    plots = {
        "yaw": figures.yaw(frames, "full", "thesis"),
        "yaw-scaled": figures.yaw(frames, "scaled", "thesis"),
        "yaw-mantis": figures.yaw(frames, "scaled", "mantis"),
        "error": figures.error(frames),
        "trajectories": figures.trajectories(arm.stations(quick)),
        "frames": figures.frames_shown(outcome.pictures),
        "lamp": figures.lamp_and_lens(outcome.levels, outcome.sharpness),
    }
    tables = {
        "passes": pass_rows(frames),
        "failures": failure_rows(frames),
        "camera": camera_rows(outcome.camera, outcome.scenario),
        "levels": level_rows(outcome.levels),
        "sharpness": sharpness_rows(outcome.sharpness),
    }
    return StudyPage(
        "physical", "The physical experiment, emulated", headline(frames), _clean(frames), answers(outcome), statements(outcome),
        tables, TABLES, plots, CAPTIONS, limits(outcome), command, outcome.scenario, ABOUT,
        ("failures", "camera", "levels", "sharpness"),
    )  # fmt: skip


def _clean(frames: xr.Dataset) -> bool:
    """Whether this project's detector finds every frame in eclipse, without an outlier."""
    own = frames.sel(illumination="eclipse", by="mantis")
    return bool(float(own.found.min()) == 1 and not outliers(own).any())


def headline(frames: xr.Dataset) -> str:
    """One sentence: yaw in eclipse, and what the lamp does."""
    own, listed = (series(frames, "eclipse", "scaled", by) for by in ("mantis", "thesis"))
    lamp = series(frames, "sunlit", "full", "thesis")
    return (
        f"On the frames scaled as in the thesis, Mantis's yaw is off by {number(rms(own.yaw_error_deg))}° rms in all "
        f"{own.found.size} frames; the thesis's pipeline is off by {number(rms(listed.yaw_error_deg))}° in the "
        f"{100 * mean(listed.found):.0f} % that it finds, and under the lamp has a virtual point in "
        f"{100 * mean(lamp.virtual):.0f} % of the frames as taken."
    )


def answers(outcome: Outcome) -> list[str]:
    """What was found, a sentence each."""
    frames, lines = outcome.frames, []
    for scale, name in (("full", "Frames as taken"), ("scaled", "Scaled frames")):
        parts = []
        for by, who in (
            ("mantis", "Mantis by this project"), ("inner", "its inner ArUco"), ("thesis", "Mantis by the thesis's pipeline"),
            ("thesis_inner", "its inner ArUco"),
        ):  # fmt: skip
            here = series(frames, "eclipse", scale, by)
            parts.append(f"{who} {number(rms(here.yaw_error_deg))}° with {_outliers(here)}")
        lines.append(f"{name}, eclipse, yaw rms: {'; '.join(parts)}; {here.found.size} frames.")
    near = beside(frames)
    for by, who in (("thesis", "The thesis's pipeline"), ("mantis", "This project's detector")):
        here = series(frames, "sunlit", "full", by)
        dark = series(frames, "eclipse", "full", by)
        lines.append(
            f"{who} has a virtual point in {100 * mean(dark.virtual):.0f} % of the frames as taken in eclipse; under the lamp in "
            f"{100 * mean(here.virtual, near):.0f} % with the lamp within {NEAR_PHASE_DEG:g}° of the camera and in "
            f"{100 * mean(here.virtual, ~near):.0f} % elsewhere."
        )
    own, bare, pair = (rms_in(series(frames, "sunlit", "full", by), near) for by in ("mantis", "inner", "pair"))
    lines.append(
        f"Under the lamp Mantis's yaw is off by {own[0]}° rms with the lamp beside the camera and {own[1]}° elsewhere, its inner "
        f"ArUco's alone by {bare[0]}° and {bare[1]}°: what the lamp lights in the slits moves the blobs. Frames "
        f"with LEDs less frames without give {pair[0]}° and {pair[1]}°{_lost(frames)}."
    )
    found = outcome.camera.found
    lines.append(
        f"Calibration from {found.views} rendered chessboards: focal length {found.focal_px[0]:.1f} ± {found.sigma[0]:.1f} px "
        f"(true {outcome.scenario.camera.focal_px[0]:.1f}), principal point {found.principal_point_px[0]:.1f}, "
        f"{found.principal_point_px[1]:.1f} px (true {outcome.scenario.camera.principal_point_px[0]:.1f}), corners "
        f"{found.rms_px:.2f} px rms."
    )
    return lines


def _lost(frames: xr.Dataset) -> str:
    """How near the lamp stands to the camera where a difference does not show the marker."""
    lost = series(frames, "sunlit", "full", "pair").found < 1
    if not lost.any():
        return ""
    phase = float(frames.lamp_phase_deg.where(lost.any("way")).max())
    return f"; they lose the marker in {int(lost.sum())} frames, with the lamp within {phase:.1f}° of the camera"


def _outliers(frames: xr.Dataset) -> str:
    count = int(outliers(frames).sum())
    return f"{count or 'no'} outlier{'' if count == 1 else 's'}"


def rms_in(frames: xr.Dataset, chosen: xr.DataArray) -> tuple[str, str]:
    """Rms yaw error of the chosen frames, and of the others, as text."""
    return number(rms(frames.yaw_error_deg.where(chosen))), number(rms(frames.yaw_error_deg.where(~chosen)))


def limits(outcome: Outcome) -> list[str]:
    """Assumptions, reconstructions and what is not modelled."""
    frames, told = outcome.frames, arm.table()
    names = {"eclipse": "in eclipse", "sunlit": "under the lamp"}
    exposures = ", ".join(
        f"{seconds_text(float(frames.exposure_s.sel(illumination=illumination)))} {name}"
        for illumination, name in names.items()
    )
    return [
        "The arm's lines are reconstructed: the text has four passes at different heights, each there and back, "
        "and its figure 7.5 is "
        f"not in it. Here they are straight, {told['arm']['distance_m']:g} m from the face, "
        f"{2 * told['arm']['half_length_m']:g} m long, "
        f"{', '.join(f'{h:g}' for h in told['arm']['heights_m'])} m above the marker; the camera looks at the "
        "marker with level rows.",
        "Sensor: `mantis presets` says of each figure of the GT4096 NIR where it is from. Lens: "
        f"F/{outcome.scenario.camera.f_number:g} "
        "at 24 mm, left at infinity; barrel distortion assumed. A sharp lens shows every slit by itself, and the "
        "thesis's blob detector "
        "then finds none (table of sharpness), which its figures exclude.",
        f"LEDs: three clusters of three, {1e3 * outcome.scenario.leds.ring_radius_m:g} mm from the axis, each "
        "cluster's on a circle of "
        f"{1e3 * told['leds']['cluster_radius_m']:g} mm; number from 8.8 V and 2 A. The detector takes them for a ring.",
        f"Lamp: Planck's spectrum at {told['lamp']['temperature_k']:g} K, {told['lamp']['illuminance_lx']:,.0f} lx "
        "on a plane square to it "
        f"(the Sun has some 130,000), {told['lamp']['incidence_deg']:g}° to the marker's right; level, size and "
        "distance are assumptions, "
        "and the level is varied. It is treated as infinitely far away, and camera and arm cast no shadow.",
        f"Exposures are set once a run, on the marker's white bits squarely seen: {exposures}. The thesis prints none.",
        f"Slits: {outcome.scenario.marker.slit_count} an element; the thesis does not say. With more, blobs are "
        "smaller than the eighth of an "
        "opening that listing A.2 asks for at least.",
        "Tape: bead tape (Type III); the thesis names no make. Mock-up: a face in crinkled foil with metal bars "
        "about the marker; only "
        "the frame's middle about the marker is rendered, so that false positives elsewhere in the frame are not counted.",
        "One rendering of a station serves both ways, both lights and all levels, each with its own noise.",
        "Chessboards are rendered as the detector bins 8 × 8 pixels, in even light, and their calibration is scaled "
        "back. Lens blur is "
        "added after rendering.",
        f"Scaling: the frame, rectified by the calibration, made smaller by {1 / _factor(outcome):.2f} (means of "
        "what a pixel covers), its "
        "rim repeated to 720 × 480 px, so that the marker is as large as the virtual experiment's at 2.3 m. Frames "
        "so made have less "
        "noise than ones taken so.",
        "The thesis's figures are not in its text: 'printed' is what its sentences say of them.",
    ]  # fmt: skip


def _factor(outcome: Outcome) -> float:
    from experiments.thesis.physical.camera import scaling

    return scaling(outcome.scenario).factor
