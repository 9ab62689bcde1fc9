"""The page of `mantis glare`."""

from __future__ import annotations

import numpy as np
import xarray as xr

from experiments.chain.statistics import wilson_interval
from experiments.reporting.blocks import Block, Bullets, Card, Plot, Plots, Section, Text, csv_text, text_table
from experiments.reporting.page import Page
from experiments.studies.glare import conditions, figures, tables
from experiments.studies.glare.failures import failure_rows
from experiments.studies.glare.modes import MODES
from experiments.studies.glare.study import GlareResult

#: The mode for which the target is stated.
TARGET_MODE = "pair"
QUESTION = (
    "Where may the Sun stand so that the marker is still found and its pose good, and which counter-measure helps? The phase "
    "is the angle between Sun and camera seen from the target: 0° is a Sun behind the camera, 150° nearly in front of it."
)
#: What this version leaves out.
LIMITS = (
    "Smear within an exposure is left out: 0.05 m/s over a pulse of microseconds is far below a pixel; over 1 ms it is 0.06 px "
    "at 2 m.",
    "There are no off–on–off triples, and sunlight that foil returns is taken to be unpolarised.",
    "Stray light of a Sun outside the field counts only where the scenario's camera has a table of it; the Sun never stands "
    "inside the field.",
    "Light that is reflected twice is left out: 0.7 % of the Sun's at most.",
    "A closed shutter lets no light in. Parasitic light sensitivity matters for exposures of microseconds.",
    "Real cameras' shortest exposures count only in the modes with a fixed shutter.",
    "Intervals count every frame as independent, though the frames of one geometry differ in noise alone; the spread between "
    "geometries is not in them.",
)


def page(result: GlareResult, command: str) -> Page:
    """The study: modes, findings, the thesis's finding, maps, tables, worst frames and whole frames."""
    met = tables.verdicts(result.summary, TARGET_MODE)[0]
    line = headline(result)
    return Page(
        study="glare",
        title="Sun glare: where the Sun may stand",
        headline=line,
        passed=met,
        command=command,
        sections=_sections(result),
        findings=tuple(findings(result)),
        cards=_cards(result),
        about=(QUESTION,),
        limits=LIMITS,
        scenario=result.scenario,
        data=result.dataset,
        unmet={} if met else {TARGET_MODE: line},
        extra={"meets": met},
        files=_files(result),
    )


def headline(result: GlareResult) -> str:
    """One sentence: whether the pair meets the requirement at every phase angle of the target."""
    met, _ = tables.verdicts(result.summary, TARGET_MODE)
    low, high = tables.TARGET_PHASES_DEG
    cells = tables.in_target(result.summary).sel(mode=TARGET_MODE)
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
    summary, low = result.summary, tables.TARGET_PHASES_DEG[0]
    cells = tables.in_target(summary).sel(mode=TARGET_MODE)
    frames = cells.detection.size * summary.attrs["trials"]
    found, usable = (float(cells[name].mean()) * frames for name in ("detection", "usable"))
    surely = 100 * float(wilson_interval(found, frames)[0])
    lines = [
        f"All of these together: found in {found:.0f} of {frames} frames, at least {surely:.2f} % with 95 % confidence; pose "
        f"within the requirement in {usable:.0f}."
    ]
    passing = [str(m) for m in summary.mode.values if tables.verdicts(summary, str(m))[0]]
    lines.append(f"Modes that meet it at every range and phase from {low:g}° on: {', '.join(passing) or 'none'}.")
    near = summary.sel(phase_deg=[p for p in summary.phase_deg.values if 0 < p < low])
    for mode in ("single", TARGET_MODE) if near.sizes["phase_deg"] else ():
        here = near.sel(mode=mode)
        phases = ", ".join(f"{p:g}°" for p in near.phase_deg.values)
        lines.append(
            f"{mode}, Sun {phases} from the camera: attitude p95 up to {float(here.attitude_p95_deg.max()):.2f}°, blobs biased "
            f"by up to {float(here.blob_bias_px.max()):.2f} px, {int(here.meets.sum())} of {here.meets.size} cells meet the "
            "requirement."
        )
    return lines


def _cards(result: GlareResult) -> tuple[Card, ...]:
    cards = []
    for mode in result.plan.modes:
        met, failures = tables.verdicts(result.summary, mode)
        cells = tables.in_target(result.summary).sel(mode=mode)
        large = f"{int(cells.meets.sum())} of {cells.meets.size}"
        cards.append(Card(mode, large, "cells of range and phase meet the requirement", tuple(failures), met))
    return tuple(cards)


def _sections(result: GlareResult) -> tuple[Section, ...]:
    modes = [("mode", "what it is"), *((name, MODES[name].title) for name in result.plan.modes)]
    short = [tables.SHORTFALL_HEADINGS, *tables.shortfall_rows(result.summary)]
    by_mode = text_table(
        [tables.HEADINGS, *tables.mode_rows(result.summary)],
        "Worst phase of each group",
        key="modes",
        terminal=True,
        terminal_columns=tables.TERMINAL,
    )
    changed = [conditions.HEADINGS, *conditions.rows(result.conditions, result.scenario)]
    return (
        Section("modes", "Modes", (text_table(modes),)),
        Section("short", "Where a mode falls short", (text_table(short),)),
        Section(
            "thesis",
            "The thesis's finding (section 8.2), reproduced and explained",
            (Bullets(tuple(dimmed_findings(result.dimmed))), _dimmed_plot(result)),
        ),
        Section("maps", "Maps", _maps(result)),
        Section("by-mode", "Mode by mode", (by_mode,)),
        Section(
            "conditions",
            "Other surroundings, lens and sensor",
            (Text((_condition_text(result.conditions),)), text_table(changed, key="conditions")),
        ),
        Section("worst", "Worst frames", (_gallery(result),)),
        Section("whole", "False positives on whole frames", _whole_frames(result)),
        Section("how", "How it was done", (Bullets(tuple(_how(result))),)),
    )


def _maps(result: GlareResult) -> tuple[Plots, ...]:
    detection = Plot(
        "detection",
        figures.detection_map(result.dataset),
        "Where the Sun may stand: share of frames in which the marker is found.",
    )
    pose = Plot(
        "pose",
        figures.pose_map(result.dataset),
        "Where the Sun may stand: largest attitude error of the frames in which it is found.",
    )
    phase = Plot(
        "phase",
        figures.over_phase(result.summary),
        "All azimuths pooled: detection with its 95 % interval, attitude error, and the largest mean error of a blob.",
    )
    return tuple(Plots((plot,), plot.caption) for plot in (detection, pose, phase))


def _dimmed_plot(result: GlareResult) -> Plots:
    caption = (
        "Section 8.2 of the thesis: with weak LEDs its pipeline keeps the blobs only with the Sun behind the camera."
    )
    return Plots((Plot("dimmed", figures.dimmed(result.dimmed), caption),), caption)


def _gallery(result: GlareResult) -> Plots:
    caption = "Worst frame of each mode, and what failed; dashed: true outline. Pairs are shown as differences."
    return Plots((Plot("gallery", figures.gallery(result.worst), caption),), caption)


def dimmed_findings(dimmed: xr.Dataset) -> list[str]:
    """Blobs that each pipeline finds with LEDs dimmed until its blobs are lost from the side but not from behind the camera."""
    blobs = dimmed.blobs.mean("frame")
    behind, side = (blobs.sel(phase_deg=dimmed.phase_deg.values[k], mode="thesis").values for k in (0, -1))
    k = int(np.argmax(behind - side))
    scale, ratio = float(dimmed.led_scale[k]), float(dimmed.led_over_sun.isel(phase_deg=-1)[k])
    near, far = dimmed.phase_deg.values[[0, -1]]
    lines = [
        f"LEDs dimmed to {100 * scale:.2g} % ({ratio:.2g} of the sunlight on the bits at {far:g}°): the thesis's pipeline finds "
        f"{behind[k]:.2f} of 4 blobs with the Sun at {near:g}° and {side[k]:.2f} at {far:g}°. This is its finding."
    ]
    at = blobs.isel(led_scale=k)
    for mode in dimmed.mode.values[1:]:
        counts = [float(at.sel(mode=mode, phase_deg=p)) for p in (near, far)]
        lines.append(f"Same light, {mode}: {counts[0]:.2f} of 4 at {near:g}°, {counts[1]:.2f} at {far:g}°.")
    for phase in (near, far):
        weakest = [f"{mode} {_weakest(dimmed.usable.sel(mode=mode, phase_deg=phase))}" for mode in dimmed.mode.values]
        lines.append(
            f"Weakest LEDs with which every frame gives a usable pose, Sun at {phase:g}°: {', '.join(weakest)}."
        )
    return lines


def _weakest(usable: xr.DataArray) -> str:
    """Least scale from which up to the full one every frame is usable."""
    good = usable.all("frame").values
    count = int(np.argmin(good)) if not good.all() else len(good)
    return f"{100 * float(usable.led_scale[count - 1]):.2g} %" if count else "none"


def _condition_text(changed: xr.Dataset) -> str:
    phases = ", ".join(f"{p:g}°" for p in changed.phase_deg.values)
    return (
        f"One thing is changed at a time, at {conditions.RANGE_M:g} m and phase angles {phases}, with {changed.sizes['frame']} "
        "frames each. The table gives the worst phase of each figure, and the phases at which not every pose is within the "
        "requirement. Figures of lens and sensor are assumptions. Veiling glare is spread over a crop about the marker, so there "
        "is more of it than over a whole frame."
    )


def _whole_frames(result: GlareResult) -> tuple[Block, ...]:
    text = (
        f"At {result.plan.whole_range_m:g} m, whole frames are searched for identities that they do not hold. In the table of "
        "modes a false positive is a marker found elsewhere in a crop, or another identity remarked without corners."
    )
    return Text((text,)), text_table([tables.WHOLE_HEADINGS, *tables.whole_rows(result.whole)])


def _how(result: GlareResult) -> list[str]:
    """How it was run, and how sure the rates are."""
    plan, dataset, target = result.plan, result.dataset, result.scenario.target
    reached, widest = tables.widest_interval(result.summary)
    frames, interval = result.summary.attrs["trials"], 1e3 * plan.pair_interval_s
    pulses = [1e6 * float(p) for p in (dataset.pulse_s.min(), dataset.pulse_s.max())]
    return [
        f"Modes: {dataset.sizes['mode']}; ranges: {len(plan.ranges_m)}; phase angles: {len(plan.phases_deg)}; azimuths: "
        f"{len(plan.azimuths_deg)}; attitudes, each with a crinkle of its own: {len(plan.attitudes)}; noise draws: {plan.draws}. "
        f"These are {dataset.detected.size} frames, {frames} for each rate of a mode, range and phase.",
        f"95 % intervals (Wilson) are ± {100 * reached:.1f} % at most where 99 % or more are found, "
        f"± {100 * widest:.1f} % elsewhere.",
        f"The frame without LEDs is taken {interval:.0f} ms later: Sun and foil are rendered again for the target turned by "
        f"{interval * 1e-3 * target.tumble_deg_s:.2f}° about an axis {target.tumble_lever_m:g} m behind the marker. It is "
        "shifted back by the predicted motion of the marker (error 5 %, assumption), by cubic convolution.",
        f"LED pulses last {pulses[0]:.2g}–{pulses[1]:.2g} µs; bright bits aim at "
        f"{100 * result.scenario.auto_exposure.full_well_fraction:g} % of the well. "
        "The chaser casts no shadow except in ‘shadowed’.",
        "Every rate, interval and limit by mode, range and phase is in data/glare.csv, the failure modes of thesis section 8.3 "
        "are in data/glare-failures.csv.",
    ]


def _files(result: GlareResult) -> dict[str, str]:
    """Summary and failure modes as CSV, one row for every mode, range and phase."""
    frame = result.summary.drop_vars("px_per_bit").to_dataframe().reset_index()
    head, *rows = failure_rows(result.dataset, result.scenario, result.plan.attitudes)
    return {
        "data/glare.csv": csv_text({column: [_five_digits(v) for v in frame[column]] for column in frame}),
        "data/glare-failures.csv": csv_text(dict(zip(head, zip(*rows, strict=True), strict=True))),
    }


def _five_digits(value: object) -> object:
    return f"{value:.5g}" if isinstance(value, float) else value
