"""The page of `mantis budget`: verdict, curves, pictures, every range and every margin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from experiments import chain
from experiments.reporting import pictures
from experiments.reporting.blocks import Block, Card, Picture, Plot, Plots, Section, Strip, Text
from experiments.reporting.formatting import ILLUMINATION_NAMES, number, percent, ranges_text, seconds_text
from experiments.reporting.page import Page
from experiments.scenario import Scenario, load_scenario
from experiments.studies.budget import figures, tables
from experiments.studies.budget.study import BudgetResult, Snapshot, shown_exposure
from experiments.studies.budget.terminal import budget_table, verdict_panel
from experiments.studies.budget.verdict import CaseVerdict, Summary, exposure_name, summarise

#: Ranges that the strip of pictures shows at most; a longer plan is thinned evenly.
MAX_PICTURED_RANGES = 24
#: Side of the pictured crop over the marker's side.
CROP_OVER_MARKER = 1.35

ABOUT = (
    "Every range is rendered once and exposed in every illumination with every exposure of the scenario's plan; the detector "
    "looks for the marker in each frame. A range closes where every criterion of the scenario's requirement is met. Beside each "
    "rendered figure stands the closed form's."
)
THESIS = (
    "The shipped default scenario is the thesis's reference system: the command mantis errata sets the thesis's own link budget "
    "beside this one."
)
LIMITS = (
    "All frames of one range and illumination have the same pose and the same place on the pixels; they differ by noise alone.",
)


def page(result: BudgetResult, command: str = "mantis budget") -> Page:
    """The page of a budget; the same for the same result.

    Args:
        result: of `study.run`.
        command: the command line that made it, for the reader to run again.
    """
    scenario, dataset = result.scenario, result.dataset
    summary = summarise(dataset, scenario)
    sections = (
        Section("figures", "Signal, noise and contrast over range", tuple(_plots(result))),
        Section("pictures", "What the camera sees", tuple(_pictures(result, summary))),
        Section("table", "Range by range", tuple(tables.range_by_range(result, summary))),
        Section("matrix", "Which criterion fails where", tuple(tables.margins(result, summary))),
    )
    return Page(
        study="budget",
        title=scenario.title,
        headline=summary.headline,
        passed=summary.closes,
        command=command,
        sections=sections,
        findings=summary.advice,
        findings_title="What would help, and what the frames show",
        cards=_cards(result, summary),
        about=(ABOUT, THESIS) if is_default(scenario) else (ABOUT,),
        limits=LIMITS,
        scenario=scenario,
        data=dataset,
        extra={"verdict": asdict(summary), "results": dataset.to_dict(data="list")},
        screen=(budget_table(result), verdict_panel(summary)),
    )


def is_default(scenario: Scenario) -> bool:
    """Whether a scenario is the shipped default one, whatever part of its plan is walked through and with which seed."""
    free = {"budget", "render", "seed"}
    return scenario.model_dump(exclude=free) == load_scenario().model_dump(exclude=free)


def _cards(result: BudgetResult, summary: Summary) -> tuple[Card, ...]:
    """One card an illumination: where it closes with the shown exposure, and where with the others."""
    cards = []
    for case in summary.shown:
        others = [c for c in summary.cases if c.illumination == case.illumination and not c.shown]
        seconds = result.dataset.exposure_s.sel(illumination=case.illumination, exposure=case.exposure)
        low, high = (seconds_text(float(s)) for s in (seconds.min(), seconds.max()))
        note = f"closes with {exposure_name(case.exposure)}" + (f", {low} to {high}" if low != high else "")
        remarks = tuple(
            f"{c.exposure} closes at {_where(c)}. {'; '.join(c.failures)}".rstrip(" .") + "." for c in others
        )
        title = ILLUMINATION_NAMES[case.illumination].capitalize()
        cards.append(
            Card(
                title=title,
                large=_where(case),
                note=note,
                lines=case.failures,
                passed=case.closes,
                remarks_title="Other exposures of the plan",
                remarks=remarks,
            )
        )
    return tuple(cards)


def _where(case: CaseVerdict) -> str:
    return "every range" if case.closes else ranges_text(case.ranges_m, case.closing_m)


def _plots(result: BudgetResult) -> Iterator[Block]:
    def by_illumination(key: str, panels: Sequence[Figure], what: str, caption: str) -> Plots:
        names = result.scenario.budget.illuminations
        plots = (
            Plot(f"{key}-{name}", panel, f"{what} against range in {ILLUMINATION_NAMES[name]}")
            for name, panel in zip(names, panels, strict=True)
        )
        return Plots(tuple(plots), caption)

    yield by_illumination(
        "snr",
        figures.snr_panels(result),
        "SNR",
        "Lines are the closed form; points are rendered frames with 95 % intervals over the noise draws, where bits do not "
        "saturate. No exposure gives more than a full pixel's SNR (dotted): a line that is marked saturated is formal only.",
    )
    yield by_illumination(
        "cnr",
        figures.cnr_panels(result),
        "CNR",
        "Contrast between a bright bit and the dark cells beside it. It falls at long range even where the SNR is constant, "
        "because lens and pixel blur bright bits into dark ones.",
    )
    yield by_illumination(
        "difference",
        figures.difference_panels(result),
        "Rendered over closed form",
        f"The expected signal, before noise, differs by at most {percent(_largest_difference(result))}. SNR and CNR are taken "
        "from few pixels and noise draws and scatter accordingly, as their 95 % intervals say.",
    )
    yield by_illumination(
        "saturation",
        figures.saturation_panels(result),
        "Saturation",
        "Expected charge of a bright bit over the well. Above one the pixel is full and its level says nothing.",
    )
    yield by_illumination(
        "exposure",
        figures.exposure_panels(result),
        "Usable exposures",
        "Between the shortest exposure that gives enough contrast and the longest that neither saturates nor smears, the closed "
        "form closes. Circles and other signs are the exposures of the plan.",
    )
    yield Plots(
        (
            Plot("sampling", figures.sampling_panel(result), "Pixels per bit against range"),
            Plot("detection", figures.detection_panel(result), "Detection against range"),
            Plot("attitude", figures.attitude_panel(result), "Attitude error against range"),
        ),
        f"Detection and attitude are those of the rendered frames with {exposure_name(_shown_label(result))}; bars are exact "
        "95 % intervals (Clopper and Pearson). They cover noise alone, so neighbouring ranges, where the marker lies otherwise "
        "on the pixels, scatter more. A range without a pose has no attitude point.",
    )


def _largest_difference(result: BudgetResult) -> float:
    """Largest relative difference of the rendered from the closed-form signal."""
    return float(abs(result.dataset.signal_expected / result.dataset.signal_analytic - 1).max())


def _shown_label(result: BudgetResult) -> str:
    return str(result.dataset.exposure.values[shown_exposure(result.scenario)])


def _pictures(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    ranges = list(result.scenario.budget.ranges_m)
    if len(ranges) > MAX_PICTURED_RANGES:
        indices = np.rint(np.linspace(0, len(ranges) - 1, MAX_PICTURED_RANGES)).astype(int)
        yield Text((f"{MAX_PICTURED_RANGES} of the {len(ranges)} ranges are shown.",))
        ranges = [ranges[i] for i in indices]
    yield Text(
        (
            f"The first noise draw with {exposure_name(_shown_label(result))}, cropped to the marker and enlarged by a whole "
            "factor, so that every square is one pixel. Grey is the square root of the digital number, stretched between "
            f"percentiles {pictures.BLACK_PERCENTILE:g} and {pictures.WHITE_PERCENTILE:g} of the crop.",
        )
    )
    cases = {case.illumination: case for case in summary.shown}
    columns = []
    for range_m in ranges:
        px_per_bit = float(result.dataset.px_per_bit.sel(range_m=range_m))
        column = tuple(
            _picture(result.scenario, snapshot, cases[snapshot.illumination])
            for snapshot in result.snapshots
            if snapshot.range_m == range_m
        )
        columns.append((f"{range_m:g} m, {number(px_per_bit)} px/bit", column))
    yield Strip("Pictures of the marker over range", tuple(columns), Markup(pictures.legend()))


def _picture(scenario: Scenario, snapshot: Snapshot, case: CaseVerdict) -> Picture:
    view, features = chain.view(scenario.at(range_m=snapshot.range_m)), snapshot.features
    side_px = scenario.marker.size_m * max(scenario.camera.focal_px) / snapshot.range_m * CROP_OVER_MARKER
    centre_px, outline_px = view.to_image(np.zeros((1, 3)))[0], view.to_image(scenario.marker.corners_m)
    drawn = pictures.marker_picture(snapshot.frame, features, centre_px, side_px, outline_px)
    found = "marker not found"
    if features.detected:
        blobs = sum(p is not None for p in features.blobs_px.values())
        found = f"found, {blobs} of 4 blobs, {len(features.virtual_points_px)} of 4 virtual points"
    elif features.identity is not None:
        found = f"marker not found, identity {features.identity} seen"
    failing = case.failing_at(snapshot.range_m)
    judged = f"fails over all draws: {', '.join(failing)}" if failing else "closes"
    illumination = ILLUMINATION_NAMES[snapshot.illumination]
    heading = f"{illumination}, {seconds_text(snapshot.exposure_s)}, enlarged ×{drawn.enlarged}"
    return Picture(Markup(drawn.svg), heading, (found, judged), not failing)
