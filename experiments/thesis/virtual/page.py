"""The virtual experiment told: verdict, what the thesis printed beside what its pipeline and this project give here, and why."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.formatting import number
from experiments.reporting.page import Page
from experiments.studies.shared.trackers import apriltag_available
from experiments.thesis.claims import claims_section
from experiments.thesis.virtual import figures
from experiments.thesis.virtual.claims import claims
from experiments.thesis.virtual.study import VirtualResult
from experiments.thesis.virtual.summary import (
    PITCH_TARGET_DEG,
    RANGE_TARGET_M,
    TERMINAL,
    failure_rows,
    find,
    missed,
    rows,
    title,
)
from experiments.thesis.virtual.targets import exposure_s

ABOUT = (
    "How well does a camera know the attitude and range of a marker that turns before it? Here are the thesis's nine tests (its "
    "table 8.1) on rendered frames: the Mantis Marker beside an ArUco of the same outer size, an AprilTag and a true protrusion, "
    "each by the thesis's pipeline and by this project's. An *outlier* is off by more than 10° or 5 % of the range; *IPPE* gives "
    "the two poses that a flat square's corners allow.",
    "*Reproduced* is the thesis's own pipeline on these frames, *right* this project's.",
    "Frame by frame: `virtual.nc`, groups `frames`, `summary` and `bounds`.",
)


def page(result: VirtualResult, command: str) -> Page:
    """The page of the study."""
    summary = result.summary
    short = missed(summary)
    tests = text_table(
        rows(summary),
        "Every test, and what is run beside them",
        key="tests",
        terminal=True,
        terminal_columns=TERMINAL,
    )
    failed = text_table(failure_rows(summary), "Frames with each failure mode of thesis section 8.3", key="failures")
    return Page(
        study="virtual",
        title="The virtual experiment: table 8.1, rendered again",
        headline=_headline(summary),
        passed=not short,
        command=command,
        sections=(
            claims_section(claims(summary, result.frames), terminal=False),
            Section("figures", "Figures", _plots(result)),
            Section("tests", "Every test", (tests,), wordy=True),
            Section("failures", "Failure modes of section 8.3", (failed,), wordy=True),
        ),
        findings=findings(result),
        about=ABOUT,
        limits=_limits(result),
        scenario=result.scenario,
        data=result.data,
        unmet={"targets": short[0]} if short else {},
        extra={"missed": short},
    )


def _plots(result: VirtualResult) -> tuple[Plots, ...]:
    drawn = {name: figures.condition(result.frames, name) for name in figures.CONDITIONS}
    drawn["overview"] = figures.overview(result.summary)
    drawn["bound"] = figures.against_bound(result.frames, result.bounds) if result.bounds else None
    drawn["misplaced"] = figures.misplaced(result.frames)
    plots = (Plot(key, plot, figures.CAPTIONS[key]) for key, plot in drawn.items() if plot is not None)
    return tuple(Plots((plot,)) for plot in plots)


def _headline(summary: xr.Dataset) -> str:
    own = summary.where(summary.method == "mantis", drop=True)
    own = own.where(own.target.isin(["mantis", "improved"]), drop=True)
    count, short = own.sizes["series"], missed(summary)
    if short:
        return f"Mantis misses a target: {'; '.join(short)}."
    frames, worst = int(own.frames.sum()), float(own.pitch_rms_deg.max())
    return (
        f"Mantis meets every target in all {count} series of {frames} frames: found in every frame, no outlier, "
        f"pitch rms at most {number(worst)}°, range rms at most {number(1e3 * float(own.range_rms_m.max()))} mm."
    )


def findings(result: VirtualResult) -> tuple[str, ...]:
    """What was found, a sentence each."""
    return (*_against_aruco(result.summary), *_against_others(result.summary), *_against_bounds(result))


def _against_aruco(summary: xr.Dataset) -> Iterator[str]:
    for test, flat in ((1, 2), (3, 4), (9, 6), (7, 8)):
        own, printed = find(summary, "mantis", test=test), find(summary, "thesis", test=test)
        flats = [find(summary, method, test=flat) for method in ("aruco_thesis", "aruco_opencv", "aruco")]
        iterative, opencv, best = flats
        if own is None or printed is None or iterative is None or opencv is None or best is None:
            continue
        yield (
            f"In {title(own)} the pitch is off by {_deg(own)} rms. The thesis's pipeline has {_deg(printed)} with "
            f"{_outliers(printed)}. An ArUco of the same outer size has {_deg(iterative)} with {_outliers(iterative)} by the "
            f"thesis's solver, {_deg(opencv)} with {int(opencv.outliers)} by both IPPE poses, and {_deg(best)} with "
            f"{int(best.outliers)} by this project's corners. Within 10° of frontal, Mantis has {_deg(own, 'frontal')} and that "
            f"best effort {_deg(best, 'frontal')}."
        )


def _against_others(summary: xr.Dataset) -> Iterator[str]:
    protrusion = find(summary, "svms", target="svms", range_m=3.3, rotation="pitch")
    own = find(summary, "mantis", test=1)
    if protrusion is not None and own is not None:
        yield (
            f"A true protrusion, ideally measured, gives {_deg(protrusion)} at 3.3 m and Mantis {_deg(own)}: on a flat marker, "
            "the virtual points do what a post of their depth does."
        )
    tag = find(summary, "apriltag", target="apriltag", range_m=3.3, rotation="pitch")
    if tag is not None:
        yield f"AprilTag 36h11 of the same outer size has {_deg(tag)} at 3.3 m with {_outliers(tag)}."
    elif not apriltag_available():
        yield "AprilTag was left out: pupil-apriltags, a development extra, is not installed."


def _against_bounds(result: VirtualResult) -> Iterator[str]:
    if not result.bounds:
        return
    for limit in (result.bounds.isel(range_m=k) for k in range(result.bounds.sizes["range_m"])):
        range_m = float(limit.range_m)
        here = find(result.summary, "mantis", target="improved", range_m=range_m, rotation="pitch")
        if here is not None:
            yield (
                f"With the improved ring at {range_m:g} m the pitch is off by {_deg(here)} rms, where the Cramér–Rao bound is "
                f"{_span(limit.pitch_bound_deg)}°, and the range by {number(1e3 * float(here.range_rms_m))} mm, where it is "
                f"{_span(1e3 * limit.range_bound_m)} mm."
            )


def _span(values: xr.DataArray) -> str:
    return f"{number(float(values.min()))}–{number(float(values.max()))}"


def _outliers(series: xr.Dataset) -> str:
    return f"{int(series.outliers)} outliers of {int(series.frames)}"


def _deg(series: xr.Dataset, which: str = "") -> str:
    return f"{number(float(series[f'pitch_{which}_rms_deg' if which else 'pitch_rms_deg']))}°"


def _limits(result: VirtualResult) -> tuple[str, ...]:
    """How it was run, and what is not as in the thesis."""
    scenario = result.scenario
    camera, total = scenario.camera, sum(len(run.angles_deg) for run in result.runs)
    across = 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.focal_px[0]))
    exposure = {run.range_m: exposure_s(scenario, run) for run in result.runs}
    times = ", ".join(f"{1e6 * t:.2g} µs at {r:g} m" for r, t in sorted(exposure.items()))
    bits = ", ".join(
        f"{scenario.marker.bit_m * camera.focal_px[0] / r:.1f} px/bit at {r:g} m" for r in sorted(exposure)
    )
    marker_mm, aruco_mm = 1e3 * scenario.marker.size_m, 1e3 * scenario.marker.aruco_m
    return (
        f"{total} frames of {camera.width_px} × {camera.height_px} px and {across:.1f}° across, each rendered by itself and "
        f"exposed once with shot noise, {scenario.sensor.read_noise_electrons:g} e⁻ read noise and {scenario.sensor.bits} bits; "
        "the thesis mentions no noise.",
        f"There is one exposure for each range, the same for all targets: {times}; bright bits then hold half the full well.",
        f"Light comes from the scenario's LED ring, {1e3 * scenario.leds.ring_radius_m:g} mm in radius; the thesis's lamp stood "
        "in the lens (--set leds.ring_radius_m=0.001).",
        f"A {marker_mm:g} mm marker has an ArUco of {aruco_mm:.1f} mm inside: {bits}. Tags 'of the same outer size' have a black "
        f"border of {marker_mm:g} mm, and their quiet zone outside of it.",
        "The thesis prints a detector of 4.512 × 4.988 mm, which is no 3 : 2; pixels here are square, 7.4° across.",
        "Combined rotations are run in the same steps as single ones; the thesis's text has steps of 1°.",
        "The space around the target is dark. The protrusion is idealised: its dots are found about their true places and never "
        "mistaken, and its post is as high as the virtual points lie deep.",
        f"Targets for Mantis: pitch rms {PITCH_TARGET_DEG[3.3]:g}° at 2.3 and 3.3 m, {PITCH_TARGET_DEG[1.3]:g}° at 1.3 m, range "
        f"rms {1e3 * RANGE_TARGET_M:g} mm, no outlier (10° in attitude or 5 % in range).",
        "The thesis's figures are not in its text: 'printed' is what its sentences say of them.",
        f"Detector code {result.frames.attrs['detector_code']}.",
    )
