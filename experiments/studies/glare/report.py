"""The report of `mantis glare`: page, Markdown, figures and data of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure as Plot

from experiments.chain.statistics import wilson_interval
from experiments.reporting import pictures
from experiments.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Cell,
    Figures,
    Picture,
    Section,
    Strip,
    Table,
    Text,
    csv_text,
)
from experiments.reporting.figures import save_svg
from experiments.reporting.files import write_netcdf, write_text
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import assumptions, footer, reproduction
from experiments.scenario import Scenario
from experiments.studies.glare import case as glare_case
from experiments.studies.glare import conditions
from experiments.studies.glare import figures as glare_figures
from experiments.studies.glare.failures import failure_rows
from experiments.studies.glare.gallery import Worst, worst_frames
from experiments.studies.glare.modes import MODES
from experiments.studies.glare.study import FULL, QUICK, Plan, Progress, false_positives, run
from experiments.studies.glare.tables import (
    HEADINGS,
    SHORTFALL_HEADINGS,
    TARGET_PHASES_DEG,
    in_target,
    markdown,
    mode_rows,
    shortfall_rows,
    summarise,
    title,
    verdicts,
    whole_rows,
    widest_interval,
)

#: The mode for which the target is stated.
TARGET_MODE = "pair"
WHOLE_HEADINGS = ("mode", "absent markers found", "other identities remarked", "searches", "found at most (95 %)")


@dataclass(frozen=True)
class GlareResult:
    """One run: frames, their summary, whole frames, dimmed LEDs and worst frames."""

    scenario: Scenario
    plan: Plan
    dataset: xr.Dataset
    summary: xr.Dataset
    whole: xr.Dataset
    case: xr.Dataset
    conditions: xr.Dataset
    worst: list[Worst]


def study(
    scenario: Scenario,
    quick: bool = False,
    draws: int | None = None,
    progress: Progress | None = None,
    workers: int | None = None,
) -> GlareResult:
    """Run every part of the study; see `glare.run`. `draws` replaces the plan's noise draws of a geometry and mode."""
    plan = QUICK if quick else FULL
    plan = replace(plan, draws=draws or plan.draws)
    dataset = run(scenario, plan, progress, workers)
    dataset.attrs["history"] = f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis glare{' --quick' if quick else ''}"
    whole = false_positives(scenario, plan, tuple(n for n in plan.modes if n in WHOLE_MODES))
    scales = glare_case.SCALES[:: 2 if quick else 1]
    case = glare_case.run(scenario, plan.stands, 4 if quick else 8, plan.pair_interval_s, scales, progress)
    phases = conditions.PHASES_DEG[1:3] if quick else conditions.PHASES_DEG
    stands, rays = (plan.stands[:1], 60_000) if quick else (plan.stands, plan.rays)
    changed = conditions.run(scenario, stands, 1 if quick else 4, plan.pair_interval_s, phases, rays, progress)
    summary = summarise(dataset, scenario)
    return GlareResult(scenario, plan, dataset, summary, whole, case, changed, worst_frames(dataset, scenario, plan))


#: Modes whose whole frames are searched; the other single frames differ from these by less than the frames among themselves.
WHOLE_MODES = ("single", "long", "pair", "thesis")


def figures(result: GlareResult) -> dict[str, Plot]:
    """Every figure by its file's name."""
    return {
        "glare-detection": glare_figures.detection_map(result.dataset),
        "glare-pose": glare_figures.pose_map(result.dataset),
        "glare-phase": glare_figures.over_phase(result.summary),
        "glare-dimmed": glare_figures.dimmed(result.case),
        "glare-gallery": glare_figures.gallery(result.worst),
    }


CAPTIONS = {
    "glare-detection": "Where the Sun may stand: share of frames in which the marker is found.",
    "glare-pose": "Where the Sun may stand: largest attitude error of the frames in which it is found.",
    "glare-phase": "All azimuths pooled: detection with its 95 % interval, attitude error, and the largest mean error of a blob.",
    "glare-dimmed": "Section 8.2 of the thesis: with weak LEDs its pipeline keeps the blobs only with the Sun behind the camera.",
    "glare-gallery": "Worst frame of each mode, and what failed; dashed: true outline. Pairs are shown as differences.",
}


def write(result: GlareResult, out: Path, command: str) -> None:
    """Write report.html, glare.md, glare.nc, data/glare*.csv and figures/glare-*.svg into a folder."""
    write_netcdf(result.dataset, out / "glare.nc")
    frame = result.summary.drop_vars("px_per_bit").to_dataframe().reset_index()
    write_text(csv_text({c: [_plain(v) for v in frame[c]] for c in frame}), out / "data" / "glare.csv")
    head, *rows = failure_rows(result.dataset, result.scenario, result.plan.stands)
    write_text(csv_text(dict(zip(head, zip(*rows, strict=True), strict=True))), out / "data" / "glare-failures.csv")
    plots = figures(result)
    for name, plot in plots.items():
        save_svg(plot, out / "figures" / f"{name}.svg")
    write_text(page(result, command), out / "glare.md")
    write_text(html(result, command, plots), out / "report.html")


def _plain(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value


def headline(result: GlareResult) -> str:
    """One sentence: whether the pair meets the requirement at every phase angle of the target."""
    met, _ = verdicts(result.summary, TARGET_MODE)
    low, high = TARGET_PHASES_DEG
    cells = in_target(result.summary).sel(mode=TARGET_MODE)
    total, good = cells.meets.size, int(cells.meets.sum())
    if met:
        return (
            f"With the on/off pair the marker is found and its pose within the requirement at every range and phase angle "
            f"walked through from {low:g}° to {high:g}°, and found in {_share(float(cells.detection.min()))} of each."
        )
    return f"The on/off pair meets the requirement in {good} of {total} cells of range and phase from {low:g}° to {high:g}°."


def _share(least: float) -> str:
    return "every frame" if least == 1 else f"at least {100 * least:.1f} % of the frames"


def findings(result: GlareResult) -> list[str]:
    """What was found, in sentences made from the figures."""
    summary, low = result.summary, TARGET_PHASES_DEG[0]
    cells = in_target(summary).sel(mode=TARGET_MODE)
    frames = cells.detection.size * summary.attrs["trials"]
    found, usable = (float(cells[name].mean()) * frames for name in ("detection", "usable"))
    lines = [
        headline(result),
        f"All of these together: found in {found:.0f} of {frames} frames, at least {100 * wilson_interval(found, frames)[0]:.2f} % "
        f"with 95 % confidence; pose within the requirement in {usable:.0f}.",
    ]
    passing = [str(m) for m in summary.mode.values if verdicts(summary, str(m))[0]]
    lines.append(f"Modes that meet it at every range and phase from {low:g}° on: {', '.join(passing) or 'none'}.")
    near = summary.sel(phase_deg=[p for p in summary.phase_deg.values if 0 < p < low])
    if near.sizes["phase_deg"]:
        for mode in ("single", "pair"):
            here = near.sel(mode=mode)
            lines.append(
                f"{mode}, Sun {', '.join(f'{p:g}°' for p in near.phase_deg.values)} from the camera: attitude p95 up to "
                f"{float(here.attitude_p95_deg.max()):.2f}°, blobs biased by up to {float(here.blob_bias_px.max()):.2f} px, "
                f"{int(here.meets.sum())} of {here.meets.size} cells meet the requirement."
            )
    return lines


def dimmed_findings(case: xr.Dataset) -> list[str]:
    """Blobs that each pipeline finds with LEDs dimmed until its blobs are lost from the side but not from behind the camera."""
    blobs = case.blobs.mean("frame")
    behind, side = (blobs.sel(phase_deg=case.phase_deg.values[k], mode="thesis").values for k in (0, -1))
    k = int(np.argmax(behind - side))
    scale, ratio = float(case.led_scale[k]), float(case.led_over_sun.isel(phase_deg=-1)[k])
    near, far = case.phase_deg.values[[0, -1]]
    lines = [
        f"LEDs dimmed to {100 * scale:.2g} % ({ratio:.2g} of the sunlight on the bits at {far:g}°): the thesis's pipeline finds "
        f"{behind[k]:.2f} of 4 blobs with the Sun at {near:g}° and {side[k]:.2f} at {far:g}°: its finding."
    ]
    at = blobs.isel(led_scale=k)
    for mode in case.mode.values[1:]:
        counts = [float(at.sel(mode=mode, phase_deg=p)) for p in (near, far)]
        lines.append(f"Same light, {mode}: {counts[0]:.2f} of 4 at {near:g}°, {counts[1]:.2f} at {far:g}°.")
    for phase in (near, far):
        weakest = [f"{mode} {_weakest(case.usable.sel(mode=mode, phase_deg=phase))}" for mode in case.mode.values]
        lines.append(
            f"Weakest LEDs with which every frame gives a usable pose, Sun at {phase:g}°: {', '.join(weakest)}."
        )
    return lines


def _weakest(usable: xr.DataArray) -> str:
    """Least scale from which up to the full one every frame is usable."""
    good = usable.all("frame").values
    count = int(np.argmin(good)) if not good.all() else len(good)
    return f"{100 * float(usable.led_scale[count - 1]):.2g} %" if count else "none"


def how(result: GlareResult) -> list[str]:
    """How it was run, and how sure the rates are."""
    plan, dataset = result.plan, result.dataset
    reached, widest = widest_interval(result.summary)
    frames, interval = result.summary.attrs["trials"], 1e3 * plan.pair_interval_s
    return [
        f"{dataset.sizes['mode']} modes, {len(plan.ranges_m)} ranges, {len(plan.phases_deg)} phase angles, "
        f"{len(plan.azimuths_deg)} azimuths, {len(plan.stands)} attitudes with a crinkle each, {plan.draws} noise draws: "
        f"{dataset.detected.size} frames, {frames} for each rate of a mode, range and phase.",
        f"95 % intervals (Wilson) are ± {100 * reached:.1f} % at most where 99 % or more are found, "
        f"± {100 * widest:.1f} % elsewhere.",
        f"The frame without LEDs is taken {interval:.0f} ms later: Sun and foil are rendered again for the target turned by "
        f"{interval * 1e-3 * result.scenario.target.tumble_deg_s:.2f}° about an axis "
        f"{result.scenario.target.tumble_lever_m:g} m behind the marker. It is shifted back by the predicted "
        "motion of the marker (error 5 %, assumption), by cubic convolution.",
        f"LED pulses: {1e6 * float(dataset.pulse_s.min()):.2g}–{1e6 * float(dataset.pulse_s.max()):.2g} µs; bright bits aim at "
        f"{100 * result.scenario.auto_exposure.full_well_fraction:g} % of the well. "
        "The chaser casts no shadow except in ‘shadowed’.",
    ]


QUESTION = (
    "Where may the Sun stand so that the marker is still found and its pose good, and which counter-measure helps? The *phase* "
    "is the angle between Sun and camera seen from the target: 0° is a Sun behind the camera, 150° nearly in front of it."
)

#: What this version leaves out.
MISSING = (
    "smear within an exposure (0.05 m/s over a pulse of microseconds is far below a pixel; over 1 ms 0.06 px at 2 m)",
    "off–on–off triples; polarisation of the sunlight that foil returns",
    "stray light of a Sun outside the field, unless the scenario's camera has a table of it; the Sun inside the field",
    "light reflected twice: 0.7 % of the Sun's at most",
    "a shutter that lets light in while closed (parasitic light sensitivity), which matters for microsecond exposures",
    "real cameras' shortest exposures, except in the modes with a fixed shutter",
    "the spread between geometries: intervals count every frame as independent, though a geometry's frames differ in noise alone",
)


def page(result: GlareResult, command: str) -> str:
    """The study as Markdown, for a folder with `figures` beside it."""
    modes = [(name, title(name)) for name in result.plan.modes]
    parts = [
        "# Sun glare: where the Sun may stand", QUESTION,
        f"Made by `{command}`; every number on this page comes from that run.",
        "## Modes", markdown(("mode", "what it is"), modes),
        "## Found", *(f"- {line}" for line in findings(result)),
        "## The thesis's finding (section 8.2), reproduced and resolved", *(f"- {line}" for line in dimmed_findings(result.case)),
        _image("glare-dimmed"),
        "## Where a mode falls short", markdown(SHORTFALL_HEADINGS, shortfall_rows(result.summary)),
        "## Mode by mode", "Each row gives the worst phase angle of its group.", markdown(HEADINGS, mode_rows(result.summary)),
        "## Maps", _image("glare-detection"), _image("glare-pose"), _image("glare-phase"),
        "## Other surroundings, lens and sensor", condition_words(result.conditions),
        markdown(conditions.HEADINGS, conditions.rows(result.conditions, result.scenario)),
        "## Worst frames", _image("glare-gallery"),
        "## False positives on whole frames",
        f"At {result.plan.whole_range_m:g} m, whole frames are searched for identities that they do not hold. In the table of "
        "modes a false positive is a marker found elsewhere in a crop, or another identity remarked without corners.",
        markdown(WHOLE_HEADINGS, whole_rows(result.whole)),
        "## How", *(f"- {line}" for line in how(result)),
        "## Left out", *(f"- {line}" for line in MISSING),
    ]  # fmt: skip
    text = "\n\n".join(parts)
    return text.replace("\n\n- ", "\n- ") + "\n"


def condition_words(changed: xr.Dataset) -> str:
    """What the table of conditions holds."""
    phases = ", ".join(f"{p:g}°" for p in changed.phase_deg.values)
    return (
        f"One thing changed at a time, at {conditions.RANGE_M:g} m, phase angles {phases}, {changed.sizes['frame']} frames each: "
        "the worst phase of each figure, and the phases at which not every pose is within the requirement. Figures of lens and "
        "sensor are assumptions; veiling glare is spread over a crop about the marker, so more of it than over a frame."
    )


def _image(name: str) -> str:
    return f"![{CAPTIONS[name]}](figures/{name}.svg)\n\n*{CAPTIONS[name]}*"


def html(result: GlareResult, command: str, plots: dict[str, Plot]) -> str:
    """The study, with its figures, as one HTML text that loads nothing from elsewhere."""

    def drawn(name: str) -> Block:
        return Figures((figure(plots[name], name, CAPTIONS[name]),), CAPTIONS[name])

    rows = mode_rows(result.summary)
    table = Table(
        HEADINGS, tuple(tuple(Cell(c) for c in row) for row in rows), "Worst phase of each group", sortable=True
    )
    whole = Table(
        WHOLE_HEADINGS, tuple(tuple(Cell(c) for c in row) for row in whole_rows(result.whole)), "Whole frames"
    )
    changed = Table(
        conditions.HEADINGS,
        tuple(tuple(Cell(c) for c in row) for row in conditions.rows(result.conditions, result.scenario)),
        "One thing changed at a time",
        sortable=True,
    )
    dimmed = Bullets(tuple(dimmed_findings(result.case)))
    kinds = Table(
        ("mode", "what it is"), tuple((Cell(n), Cell(title(n), style="left")) for n in result.plan.modes), "Modes"
    )
    short = Table(
        SHORTFALL_HEADINGS,
        tuple(tuple(Cell(c, style="left") for c in row) for row in shortfall_rows(result.summary)),
        "Where a mode falls short",
        sortable=True,
    )
    sections = (
        Section("found", "Found", (Text((QUESTION.replace("*", ""),)), kinds, Bullets(tuple(findings(result))), short)),
        Section("thesis", "The thesis’s finding, reproduced and resolved", (dimmed, drawn("glare-dimmed"))),
        Section("maps", "Where the Sun may stand", (drawn("glare-detection"), drawn("glare-pose"), drawn("glare-phase"))),
        Section("modes", "Mode by mode", (table,)),
        Section("conditions", "Other surroundings, lens and sensor", (Text((condition_words(result.conditions),)), changed)),
        Section("gallery", "Worst frames", (_strip(result),)),
        Section("whole", "False positives", (whole,)),
        Section("how", "How, and what is left out", (Bullets(tuple(how(result))), Text(("Left out:",)), Bullets(MISSING))),
    )  # fmt: skip
    scenario, attributes = result.scenario, result.dataset.attrs
    return render(
        Report(
            scenario.title,
            "Mantis sun glare",
            headline(result),
            verdicts(result.summary, TARGET_MODE)[0],
            _cards(result),
            (),
            sections,
            tuple(assumptions(scenario)),
            tuple(reproduction(scenario, attributes, command)),
            footer(attributes),
        )
    )


def _cards(result: GlareResult) -> tuple[Card, ...]:
    cards = []
    for mode in result.plan.modes:
        met, failures = verdicts(result.summary, mode)
        cells = in_target(result.summary).sel(mode=mode)
        large = f"{int(cells.meets.sum())} of {cells.meets.size}"
        cards.append(Card(mode, large, "cells of range and phase meet the requirement", tuple(failures), met))
    return tuple(cards)


def _strip(result: GlareResult) -> Strip:
    columns = []
    for worst in result.worst:
        side = float(np.ptp(worst.outline_px, axis=0).max()) / result.scenario.marker.aruco_fraction
        image = np.rint(worst.image).astype(np.int32)
        drawn = pictures.marker_picture(
            image, worst.features, worst.outline_px.mean(axis=0), 1.2 * side, worst.outline_px
        )
        picture = Picture(Markup(drawn.svg), worst.where, worst.lines, not worst.failed)
        columns.append((f"{worst.mode}: {MODES[worst.mode].title}", (picture,)))
    return Strip("Worst frame of each mode", tuple(columns), Markup(pictures.legend()))
