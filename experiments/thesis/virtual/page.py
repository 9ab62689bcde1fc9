"""The virtual experiment told: verdict, what the thesis printed beside what its pipeline and this project give here, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
import xarray as xr

from experiments.reporting.claims import StudyPage, statement_rows
from experiments.reporting.files import write_text
from experiments.reporting.formatting import number
from experiments.scenario import Scenario
from experiments.studies.shared.trackers import apriltag_available, methods_of
from experiments.thesis.virtual import figures
from experiments.thesis.virtual.bounds import bounds
from experiments.thesis.virtual.claims import statements
from experiments.thesis.virtual.study import Progress, study
from experiments.thesis.virtual.summary import (
    PITCH_TARGET_DEG,
    RANGE_TARGET_M,
    failure_rows,
    find,
    missed,
    rows,
    summarise,
    title,
)
from experiments.thesis.virtual.targets import Run, exposure_s, runs

CAPTIONS = {
    "3.3m": "Errors and detection at 3.3 m: left against ArUco as in the thesis's figures 8.2 and 8.3, right against the others",
    "2.3m": "Errors and detection at 2.3 m: left against ArUco as in figures 8.4 and 8.5, right against the others",
    "1.3m": "Errors and detection at 1.3 m, improved ring: left against ArUco as in figures 8.7 and 8.8, right the others",
    "2.3m-both": "Errors and detection at 2.3 m, pitch = yaw: left against ArUco as in figures 8.9 and 8.10, right the others",
    "overview": "Rms pitch error of every series, over all frames and near frontal; dotted: the targets for Mantis",
    "bound": "Mantis's errors, improved ring, beside twice the Cramér–Rao bound of each range",
    "misplaced": "The left element a millimetre off its place: with the design believed, and with the element calibrated",
}
TABLES = {
    "tests": "Every test, and what is run beside them",
    "failures": "Frames with each failure mode of thesis section 8.3",
}


@dataclass(frozen=True)
class Result:
    """One run: frames, their summary and the bounds; those are empty in a first look."""

    frames: xr.Dataset
    summary: xr.Dataset
    bounds: xr.Dataset

    @property
    def tree(self) -> xr.DataTree:
        """The groups of virtual.nc."""
        return xr.DataTree.from_dict({"frames": self.frames, "summary": self.summary, "bounds": self.bounds})


def run(
    scenario: Scenario, out: Path, command: str, quick: bool = False, workers: int | None = None,
    progress: Progress | None = None, step_deg: float | None = None, resume: bool = False,
) -> tuple[StudyPage, Result]:  # fmt: skip
    """Run everything and write it: report.html, virtual.md, virtual.nc, data/virtual*.csv and figures/virtual-*.svg.

    `step_deg` replaces the table's steps of tilt. Finished runs stay in the folder `runs` until all are; `resume` goes on from
    those of an interrupted command.

    Groups of virtual.nc: `frames` (by series and frame), `summary` (by series: statistics, and how many frames have each failure
    of thesis section 8.3) and `bounds`.
    """
    plan = [run for run in runs(quick, step_deg) if methods_of(run.target)]
    kept = out / "runs"
    if not resume:
        rmtree(kept, ignore_errors=True)
    frames = study(scenario, plan, workers, progress, kept)
    limits = xr.Dataset() if quick else bounds(scenario, progress=progress)
    result = Result(frames, summarise(frames), limits)
    page = study_page(scenario, plan, result, command)
    page.write(out, result.tree)
    write_text(markdown_page(page, plan, result), out / "virtual.md")
    rmtree(kept, ignore_errors=True)
    return page, result


def study_page(scenario: Scenario, plan: Sequence[Run], result: Result, command: str) -> StudyPage:
    """The page as data."""
    plots = {name: figures.condition(result.frames, name) for name in figures.CONDITIONS}
    plots |= {
        "overview": figures.overview(result.summary),
        "bound": figures.against_bound(result.frames, result.bounds) if result.bounds else None,
        "misplaced": figures.misplaced(result.frames),
    }
    tables = {"tests": rows(result.summary), "failures": failure_rows(result.summary)}
    return StudyPage(
        "virtual", "Virtual experiment of thesis table 8.1", headline(result.summary), not missed(result.summary),
        answers(result), statements(result.summary, result.frames), tables, TABLES,
        {name: plot for name, plot in plots.items() if plot is not None}, CAPTIONS, tuple(how(scenario, plan)), command, scenario,
    )  # fmt: skip


def headline(summary: xr.Dataset) -> str:
    """One sentence: whether Mantis meets its targets."""
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


def answers(result: Result) -> list[str]:
    """What was found, a sentence each."""
    summary = result.summary
    lines = []
    for test, flat in ((1, 2), (3, 4), (9, 6), (7, 8)):
        own, printed = find(summary, "mantis", test=test), find(summary, "thesis", test=test)
        flats = [find(summary, method, test=flat) for method in ("aruco_thesis", "aruco_opencv", "aruco")]
        iterative, opencv, best = flats
        if own is None or printed is None or iterative is None or opencv is None or best is None:
            continue
        lines.append(
            f"{title(own)}: pitch rms {_deg(own)}. The thesis's pipeline has {_deg(printed)} with {_outliers(printed)}; an ArUco "
            f"of the same outer size {_deg(iterative)} with {_outliers(iterative)} by the thesis's solver, {_deg(opencv)} with "
            f"{int(opencv.outliers)} by both IPPE poses, and {_deg(best)} with {int(best.outliers)} by this project's corners. "
            f"Within 10° of frontal {_deg(own, 'frontal')} stand against {_deg(best, 'frontal')} of that best effort."
        )
    protrusion = find(summary, "svms", target="svms", range_m=3.3, rotation="pitch")
    own = find(summary, "mantis", test=1)
    if protrusion is not None and own is not None:
        lines.append(
            f"A true protrusion, ideally measured, gives {_deg(protrusion)} at 3.3 m, Mantis {_deg(own)}: the virtual points do "
            "what a post of their depth does, on a flat marker."
        )
    tag = find(summary, "apriltag", target="apriltag", range_m=3.3, rotation="pitch")
    if tag is not None:
        lines.append(f"AprilTag 36h11 of the same outer size has {_deg(tag)} at 3.3 m with {_outliers(tag)}.")
    elif not apriltag_available():
        lines.append("AprilTag was left out: pupil-apriltags, a development extra, is not installed.")
    if result.bounds:
        for range_m in result.bounds.range_m.values:
            here = find(summary, "mantis", target="improved", range_m=float(range_m), rotation="pitch")
            limit = result.bounds.sel(range_m=range_m)
            if here is not None:
                lines.append(
                    f"{range_m:g} m, improved ring: pitch rms {_deg(here)} where the Cramér–Rao bound is "
                    f"{number(float(limit.pitch_bound_deg.min()))}–{number(float(limit.pitch_bound_deg.max()))}°; range rms "
                    f"{number(1e3 * float(here.range_rms_m))} mm where it is {number(1e3 * float(limit.range_bound_m.min()))}–"
                    f"{number(1e3 * float(limit.range_bound_m.max()))} mm."
                )
    return lines


def _outliers(series: xr.Dataset) -> str:
    return f"{int(series.outliers)} outliers of {int(series.frames)}"


def _deg(series: xr.Dataset, which: str = "") -> str:
    return f"{number(float(series[f'pitch_{which}_rms_deg' if which else 'pitch_rms_deg']))}°"


def how(scenario: Scenario, plan: Sequence[Run]) -> list[str]:
    """How it was run, and what is not as in the thesis."""
    camera, total = scenario.camera, sum(len(r.angles_deg) for r in plan)
    across = 2 * np.degrees(np.arctan(camera.width_px / 2 / camera.focal_px[0]))
    exposure = {r.range_m: exposure_s(scenario, r) for r in plan}
    times = ", ".join(f"{1e6 * t:.2g} µs at {r:g} m" for r, t in sorted(exposure.items()))
    bits = {r: scenario.marker.bit_m * camera.focal_px[0] / r for r in sorted(exposure)}
    return [
        f"{total} frames of {camera.width_px} × {camera.height_px} px and {across:.1f}° across, each rendered by itself and "
        f"exposed once with shot noise, {scenario.sensor.read_noise_electrons:g} e⁻ read noise and {scenario.sensor.bits} bits; "
        "the thesis mentions no noise.",
        f"One exposure a range, for all targets: {times}; bright bits then hold half the full well.",
        "Light comes from the scenario's LED ring, "
        f"{1e3 * scenario.leds.ring_radius_m:g} mm in radius; the thesis's lamp stood in the lens "
        "(--set leds.ring_radius_m=0.001).",
        "A 25 mm marker has a 13.1 mm ArUco inside: "
        + ", ".join(f"{b:.1f} px/bit at {r:g} m" for r, b in bits.items())
        + ". Tags 'of the same outer size' have a black border of 25 mm, and their quiet zone outside of it.",
        "The thesis prints a detector of 4.512 × 4.988 mm, which is no 3 : 2; pixels here are square, 7.4° across.",
        "Combined rotation is walked through in the same steps as single ones; the thesis's text has steps of 1°.",
        "The space around the target is dark. The protrusion is idealised: its dots are found about their true places and never "
        "mistaken, and its post is as high as the virtual points lie deep.",
        f"Targets for Mantis: pitch rms {PITCH_TARGET_DEG[3.3]:g}° at 2.3 and 3.3 m, {PITCH_TARGET_DEG[1.3]:g}° at 1.3 m, range "
        f"rms {1e3 * RANGE_TARGET_M:g} mm, no outlier (10° in attitude or 5 % in range).",
        "The thesis's figures are not in its text: 'printed' is what its sentences say of them.",
    ]  # fmt: skip


def markdown_page(page: StudyPage, plan: Sequence[Run], result: Result) -> str:
    """The study as Markdown, for a folder with `figures` and `data` beside it."""
    pictures = [f"![{CAPTIONS[k]}](figures/virtual-{k}.svg)\n\n*{CAPTIONS[k]}.*" for k in page.plots]
    parts = [
        "# The virtual experiment: table 8.1, rendered again",
        "How well does a camera know the attitude and range of a marker that turns before it? The thesis's nine tests (its table "
        "8.1) on rendered frames: the Mantis Marker beside an ArUco of the same outer size, an AprilTag and a true protrusion, "
        "each by the thesis's pipeline and by this project's. An *outlier* is off by more than 10° or 5 % of the range; *IPPE* "
        "gives the two poses that a flat square's corners allow.",
        f"**{page.headline}**",
        f"Made by `{page.command}`; every number on this page comes from that run. {made_with(result.frames.attrs)}",
        "## Found", *(f"- {line}" for line in page.answers),
        "## Printed, reproduced, right",
        "*Reproduced* is the thesis's own pipeline on these frames, *right* this project's.",
        _table(statement_rows(page.statements)),
        "## Figures", *pictures,
        "## Every test", TABLES["tests"] + ":", _table(page.tables["tests"]),
        "## Failure modes of section 8.3", TABLES["failures"] + ":", _table(page.tables["failures"]),
        "## How it was run", *(f"- {line}" for line in page.limits),
        "## To make it again", f"```sh\n{page.command}\n```",
        "Frame by frame: `virtual.nc`, groups `frames`, `summary` and `bounds`.",
    ]  # fmt: skip
    return "\n\n".join(parts).replace("\n\n- ", "\n- ") + "\n"


def made_with(attributes: Mapping[str, Any]) -> str:
    """One sentence: versions and hashes of what made a dataset, from its attributes."""
    return (
        f"Software: {attributes['software']} ({attributes['versions']}); scenario {attributes['scenario_hash']}; "
        f"detector code {attributes['detector_code']}."
    )


def _table(lines: Sequence[Sequence[Any]]) -> str:
    head, *body = [[str(cell).replace("|", "\\|") for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *body))
