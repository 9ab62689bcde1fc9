"""The physical experiment told: verdict, printed beside reproduced and right, tables, figures and what is a reconstruction."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from experiments.reporting.blocks import Plot, Plots, Section, Table, text_table
from experiments.reporting.formatting import listed, number, seconds_text
from experiments.reporting.page import Page
from experiments.thesis.claims import claims_section
from experiments.thesis.physical import arm, figures
from experiments.thesis.physical.camera import scaling
from experiments.thesis.physical.claims import claims
from experiments.thesis.physical.study import NEAR_PHASE_DEG, PhysicalResult
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

ABOUT = (
    "The thesis drove a camera on a robotic arm past a prototype on a mock-up (sections 7.1 and 8.2). Here arm, camera, LEDs, "
    "lamp and mock-up are rendered, the camera is calibrated from rendered chessboards, every pose is solved with that "
    "calibration, and both the thesis's software and this project's get the same frames.",
)


def page(result: PhysicalResult, command: str) -> Page:
    """The page of the study."""
    clean, headline = _clean(result.frames), _headline(result.frames)
    return Page(
        study="physical",
        title="The physical experiment, emulated",
        headline=headline,
        passed=clean,
        command=command,
        sections=(
            claims_section(claims(result), terminal=False),
            Section("figures", "Figures", _plots(result)),
            Section("tables", "Tables", _tables(result), wordy=True),
        ),
        findings=findings(result),
        about=ABOUT,
        limits=_limits(result),
        scenario=result.scenario,
        data=result.data,
        unmet={} if clean else {"found": headline},
    )


def _plots(result: PhysicalResult) -> tuple[Plots, ...]:
    frames = result.frames
    drawn = {
        "yaw": figures.yaw(frames, "full", "thesis"),
        "yaw-scaled": figures.yaw(frames, "scaled", "thesis"),
        "yaw-mantis": figures.yaw(frames, "scaled", "mantis"),
        "error": figures.error(frames),
        "trajectories": figures.trajectories(result.passes),
        "frames": figures.frames_shown(result.pictures),
        "lamp": figures.lamp_and_lens(result.levels, result.sharpness),
    }
    return tuple(Plots((Plot(key, plot, figures.CAPTIONS[key]),)) for key, plot in drawn.items())


def _tables(result: PhysicalResult) -> tuple[Table, ...]:
    return (
        text_table(
            pass_rows(result.frames),
            "Every pass by every method, both illuminations, frames as taken and scaled",
            key="passes",
            inline=False,
        ),
        text_table(
            failure_rows(result.frames),
            "Frames with each failure mode of thesis section 8.3, and what it costs",
            key="failures",
        ),
        text_table(
            camera_rows(result.camera, result.scenario),
            "The camera: true, and calibrated from rendered chessboards",
            key="camera",
            terminal=True,
        ),
        text_table(
            level_rows(result.levels),
            "Blobs found of four over the lamp's level, means of the stations tried",
            key="levels",
        ),
        text_table(
            sharpness_rows(result.sharpness),
            "Blobs found of four over the lens's point spread, one frame each",
            key="sharpness",
        ),
    )


def _clean(frames: xr.Dataset) -> bool:
    """Whether this project's detector finds every frame in eclipse, without an outlier."""
    own = frames.sel(illumination="eclipse", by="mantis")
    return bool(float(own.found.min()) == 1 and not outliers(own).any())


def _headline(frames: xr.Dataset) -> str:
    own, listed = (series(frames, "eclipse", "scaled", by) for by in ("mantis", "thesis"))
    lamp = series(frames, "sunlit", "full", "thesis")
    return (
        f"On the frames scaled as in the thesis, Mantis's yaw is off by {number(rms(own.yaw_error_deg))}° rms in all "
        f"{own.found.size} frames; the thesis's pipeline is off by {number(rms(listed.yaw_error_deg))}° in the "
        f"{100 * mean(listed.found):.0f} % that it finds, and under the lamp has a virtual point in "
        f"{100 * mean(lamp.virtual):.0f} % of the frames as taken."
    )


def findings(result: PhysicalResult) -> tuple[str, ...]:
    """What was found, a sentence each."""
    return (*_in_eclipse(result.frames), *_under_the_lamp(result.frames), _calibration(result))


def _in_eclipse(frames: xr.Dataset) -> Iterator[str]:
    for scale, name in (("full", "Frames as taken"), ("scaled", "Scaled frames")):
        parts = []
        for by, who in (
            ("mantis", "Mantis by this project"),
            ("inner", "its inner ArUco"),
            ("thesis", "Mantis by the thesis's pipeline"),
            ("thesis_inner", "its inner ArUco"),
        ):
            here = series(frames, "eclipse", scale, by)
            parts.append(f"{who} {number(rms(here.yaw_error_deg))}° with {_outliers(here)}")
        yield f"{name} in eclipse, rms error of the yaw over {here.found.size} frames: {'; '.join(parts)}."


def _under_the_lamp(frames: xr.Dataset) -> Iterator[str]:
    near = beside(frames)
    for by, who in (("thesis", "The thesis's pipeline"), ("mantis", "This project's detector")):
        here = series(frames, "sunlit", "full", by)
        dark = series(frames, "eclipse", "full", by)
        yield (
            f"{who} has a virtual point in {100 * mean(dark.virtual):.0f} % of the frames as taken in eclipse. Under the lamp it "
            f"has one in {100 * mean(here.virtual, near):.0f} % where the lamp is within {NEAR_PHASE_DEG:g}° of the camera, and "
            f"in {100 * mean(here.virtual, ~near):.0f} % elsewhere."
        )
    own, bare, pair = (_rms_in(series(frames, "sunlit", "full", by), near) for by in ("mantis", "inner", "pair"))
    yield (
        f"Under the lamp Mantis's yaw is off by {own[0]}° rms where the lamp is beside the camera and by {own[1]}° elsewhere, "
        f"its inner ArUco's alone by {bare[0]}° and {bare[1]}°: what the lamp lights in the slits moves the blobs. Differences "
        f"of frames with and without the LEDs give {pair[0]}° and {pair[1]}°{_lost(frames)}."
    )


def _calibration(result: PhysicalResult) -> str:
    found, real = result.camera.found, result.scenario.camera
    return (
        f"Calibration from {found.views} rendered chessboards: focal length {found.focal_px[0]:.1f} ± {found.sigma[0]:.1f} px "
        f"(true {real.focal_px[0]:.1f}), principal point {found.principal_point_px[0]:.1f}, "
        f"{found.principal_point_px[1]:.1f} px (true {real.principal_point_px[0]:.1f}), corners "
        f"{found.rms_px:.2f} px rms."
    )


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


def _rms_in(frames: xr.Dataset, chosen: xr.DataArray) -> tuple[str, str]:
    """Rms yaw error of the chosen frames, and of the others, as text."""
    return number(rms(frames.yaw_error_deg.where(chosen))), number(rms(frames.yaw_error_deg.where(~chosen)))


def _limits(result: PhysicalResult) -> tuple[str, ...]:
    """Assumptions, reconstructions and what is not modelled."""
    frames, told, scenario = result.frames, arm.table(), result.scenario
    names = {"eclipse": "in eclipse", "sunlit": "under the lamp"}
    exposures = ", ".join(
        f"{seconds_text(float(frames.exposure_s.sel(illumination=illumination)))} {name}"
        for illumination, name in names.items()
    )
    lines, lamp = told["arm"], told["lamp"]
    heights = listed([f"{height:g}" for height in lines["heights_m"]])
    return (
        "The arm's lines are reconstructed: the text has four passes at different heights, each there and back, and its figure "
        f"7.5 is not in it. Here they are straight, {lines['distance_m']:g} m from the face, {2 * lines['half_length_m']:g} m "
        f"long, and {heights} m above the marker. The camera looks at the marker with level rows.",
        "Sensor: `mantis presets` says of each figure of the GT4096 NIR where it is from. Lens: "
        f"F/{scenario.camera.f_number:g} at 24 mm, left at infinity; barrel distortion is assumed. A sharp lens shows every slit "
        "by itself, and the thesis's blob detector then finds none (table of sharpness), which its figures exclude.",
        f"LEDs: three clusters of three, {1e3 * scenario.leds.ring_radius_m:g} mm from the axis, each cluster's on a circle of "
        f"{1e3 * told['leds']['cluster_radius_m']:g} mm; their number follows from 8.8 V and 2 A. The detector takes them for a "
        "ring.",
        f"Lamp: Planck's spectrum at {lamp['temperature_k']:g} K, {lamp['illuminance_lx']:,.0f} lx on a plane square to it (the "
        f"Sun has some 130,000), {lamp['incidence_deg']:g}° to the marker's right. Level, size and distance are assumptions, and "
        "the level is varied. The lamp is treated as infinitely far away, and camera and arm cast no shadow.",
        f"Exposures are set once a run, on the marker's white bits squarely seen: {exposures}. The thesis prints none.",
        f"Slits: {scenario.marker.slit_count} an element; the thesis does not say. With more, blobs are smaller than the eighth "
        "of an opening that listing A.2 asks for at least.",
        "Tape: bead tape (Type III); the thesis names no make. Mock-up: a face in crinkled foil with metal bars about the "
        "marker. Only the frame's middle about the marker is rendered, so false positives elsewhere in the frame are not "
        "counted.",
        "One rendering of a station serves both ways, both illuminations and all levels, each with its own noise.",
        "Chessboards are rendered as the detector bins 8 × 8 pixels, in even light, and their calibration is scaled back. Lens "
        "blur is added after rendering.",
        f"Scaling: the frame, rectified by the calibration, is made smaller by {1 / scaling(scenario).factor:.2f} (means of what "
        "a pixel covers) and its rim repeated to 720 × 480 px, so that the marker is as large as the virtual experiment's at 2.3 "
        "m. Frames so made have less noise than ones taken so.",
        "The thesis's figures are not in its text: 'printed' is what its sentences say of them.",
    )
