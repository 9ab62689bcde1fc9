"""The report of `mantis budget`: verdict, evidence, assumptions with their sources, and how to make it again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr
from markupsafe import Markup

from experiments import chain
from experiments.reporting import pictures
from experiments.reporting.blocks import (
    Block,
    Card,
    Cell,
    Details,
    Download,
    Figures,
    Picture,
    Section,
    Strip,
    Table,
    Text,
    csv_text,
)
from experiments.reporting.formatting import ILLUMINATION_NAMES, number, percent, ranges_text, seconds_text
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import assumptions, footer, reproduction
from experiments.scenario import Scenario
from experiments.studies.budget import figures as budget_figures
from experiments.studies.budget.study import BudgetResult, Snapshot, shown_exposure
from experiments.studies.budget.verdict import MEASURES, CaseVerdict, Summary, exposure_name, summarise
from experiments.thesis.errata.section import three_models

#: Ranges that the strip of pictures shows at most; a longer plan is thinned evenly.
MAX_PICTURED_RANGES = 24
#: Side of the pictured crop over the marker's side.
CROP_OVER_MARKER = 1.35


def render_budget_report(result: BudgetResult, command: str = "mantis budget") -> str:
    """The report as one HTML text that loads nothing from elsewhere; the same for the same result.

    Args:
        result: of `budget.run_budget`.
        command: the command line that made it, for the reader to run again.
    """
    summary = summarise(result.dataset, result.scenario)
    sections = (
        Section("figures", "Signal, noise and contrast over range", tuple(_figures(result))),
        Section("pictures", "What the camera sees", tuple(_pictures(result, summary))),
        Section("table", "Range by range", tuple(_tables(result, summary))),
        Section("matrix", "Which criterion fails where", tuple(_matrices(result, summary))),
        Section("models", "The thesis's budget: printed, repaired, right", tuple(three_models())),
    )
    scenario, attributes = result.scenario, result.dataset.attrs
    return render(
        Report(
            scenario.title,
            "Mantis optical navigation budget",
            summary.headline,
            summary.closes,
            _cards(result, summary),
            summary.advice,
            sections,
            tuple(assumptions(scenario)),
            tuple(reproduction(scenario, attributes, command)),
            footer(attributes),
        )
    )


def _cards(result: BudgetResult, summary: Summary) -> tuple[Card, ...]:
    cards = []
    for case in summary.shown:
        others = [c for c in summary.cases if c.illumination == case.illumination and not c.shown]
        seconds = result.dataset.exposure_s.sel(illumination=case.illumination).isel(
            exposure=shown_exposure(result.scenario)
        )
        low, high = (seconds_text(float(s)) for s in (seconds.min(), seconds.max()))
        note = f"closes with {exposure_name(case.exposure)}" + (f", {low} to {high}" if low != high else "")
        remarks = tuple(
            f"{c.exposure} closes at {_where(c)}. {'; '.join(c.failures)}".rstrip(" .") + "." for c in others
        )
        title = ILLUMINATION_NAMES[case.illumination].capitalize()
        cards.append(
            Card(title, _where(case), note, case.failures, case.closes, "Other exposures of the plan", remarks)
        )
    return tuple(cards)


def _where(case: CaseVerdict) -> str:
    return "every range" if case.closes else ranges_text(case.ranges_m, case.closing_m)


def _figures(result: BudgetResult) -> Iterator[Block]:
    def row(name: str, plots: list, captions: list[str], caption: str) -> Figures:
        return Figures(
            tuple(figure(p, f"{name}-{i}", c) for i, (p, c) in enumerate(zip(plots, captions, strict=True))), caption
        )

    illuminations = [ILLUMINATION_NAMES[illumination] for illumination in result.scenario.budget.illuminations]
    yield row(
        "snr", budget_figures.snr_panels(result), [f"SNR against range in {illumination}" for illumination in illuminations],
        "Lines are the closed form, points the rendered frames with 95 % intervals over the noise draws, where bits do not "
        "saturate. The dashed line is the thesis's formula as printed at the thesis's own exposure, for its own 5 mm bit. "
        "Where a line is marked saturated its SNR is formal only: no exposure exceeds a full pixel's SNR (dotted).",
    )  # fmt: skip
    yield row(
        "cnr", budget_figures.cnr_panels(result), [f"CNR against range in {illumination}" for illumination in illuminations],
        "Contrast between a bright bit and the dark cells beside it. It falls at long range even at constant SNR, because "
        "lens and pixel blur bright bits into dark ones. The thesis has no contrast criterion.",
    )  # fmt: skip
    yield row(
        "difference", budget_figures.difference_panels(result),
        [f"Rendered over closed form against range in {illumination}" for illumination in illuminations],
        f"The expected signal, before noise, differs by at most {percent(_largest_difference(result))}; SNR and CNR scatter with "
        "the few pixels and noise draws they are taken from, as their 95 % intervals say.",
    )  # fmt: skip
    yield row(
        "saturation", budget_figures.saturation_panels(result), [f"Saturation against range in {illumination}" for illumination in illuminations],
        "Expected charge of a bright bit over the well; above one the pixel is full and its level says nothing.",
    )  # fmt: skip
    yield row(
        "exposure", budget_figures.exposure_panels(result), [f"Usable exposures against range in {illumination}" for illumination in illuminations],
        "Between the shortest exposure that gives the contrast and the longest that neither saturates nor smears, the "
        "closed form closes. Circles and other signs are the exposures of the plan.",
    )  # fmt: skip
    yield row(
        "frames",
        [budget_figures.sampling_panel(result), budget_figures.detection_panel(result), budget_figures.attitude_panel(result)],
        ["Pixels per bit against range", "Detection against range", "Attitude error against range"],
        f"Detection and attitude are of the rendered frames with {exposure_name(_shown_label(result))}; bars are 95 % "
        "Clopper–Pearson intervals. The frames of one point differ by noise alone: pose and pixel phase are the same, so "
        "neighbouring ranges scatter more than the bars. Ranges without a pose have no attitude point.",
    )  # fmt: skip


def _largest_difference(result: BudgetResult) -> float:
    """Largest relative difference of the rendered from the closed-form signal."""
    return float(abs(result.dataset.signal_expected / result.dataset.signal_analytic - 1).max())


def _shown_label(result: BudgetResult) -> str:
    return str(result.dataset.exposure.values[shown_exposure(result.scenario)])


def _pictures(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    scenario = result.scenario
    ranges = list(scenario.budget.ranges_m)
    if len(ranges) > MAX_PICTURED_RANGES:
        ranges = [
            ranges[i] for i in np.unique(np.rint(np.linspace(0, len(ranges) - 1, MAX_PICTURED_RANGES)).astype(int))
        ]
        yield Text((f"{len(ranges)} of the {len(scenario.budget.ranges_m)} ranges are shown.",))
    yield Text(
        (
            f"The first noise draw at {exposure_name(_shown_label(result))}, cropped about the marker and enlarged by a whole "
            "factor, so that every square is one pixel. Grey is the square root of the digital number, stretched between "
            f"percentiles {pictures.BLACK_PERCENTILE:g} and {pictures.WHITE_PERCENTILE:g} of the crop.",
        )
    )
    cases = {case.illumination: case for case in summary.shown}
    columns = []
    for range_m in ranges:
        px_per_bit = float(result.dataset.px_per_bit.sel(range_m=range_m))
        shots = [s for s in result.snapshots if s.range_m == range_m]
        columns.append(
            (
                f"{range_m:g} m, {number(px_per_bit)} px/bit",
                tuple(_picture(scenario, s, cases[s.illumination]) for s in shots),
            )
        )
    yield Strip("Pictures of the marker over range", tuple(columns), Markup(pictures.legend()))


def _picture(scenario: Scenario, shot: Snapshot, case: CaseVerdict) -> Picture:
    view = chain.view(scenario.at(range_m=shot.range_m))
    side_px = scenario.marker.size_m * max(scenario.camera.focal_px) / shot.range_m * CROP_OVER_MARKER
    centre_px, outline_px = view.to_image(np.zeros((1, 3)))[0], view.to_image(scenario.marker.corners_m)
    drawn = pictures.marker_picture(shot.frame, shot.features, centre_px, side_px, outline_px)
    found = "marker not found"
    if shot.features.detected:
        blobs = sum(p is not None for p in shot.features.blobs_px.values())
        found = f"found, {blobs} of 4 blobs, {len(shot.features.virtual_points_px)} of 4 virtual points"
    elif shot.features.identity is not None:
        found = f"marker not found, identity {shot.features.identity} seen"
    failing = case.failing_at(shot.range_m)
    judged = f"fails over all draws: {', '.join(failing)}" if failing else "closes"
    heading = f"{ILLUMINATION_NAMES[shot.illumination]}, {seconds_text(shot.exposure_s)}, enlarged ×{drawn.enlarged}"
    return Picture(Markup(drawn.svg), heading, (found, judged), not failing)


_COLUMNS = (
    "range [m]", "illumination", "exposure", "bright bit / full well", "closed form", "rendered ±", "thesis", "closed form",
    "rendered ±", "px/bit", "smear [px]", "frames found", "attitude p95 [°]", "range error p95", "what fails",
)  # fmt: skip
_GROUPS = (("case", 3), ("charge", 1), ("SNR", 3), ("CNR", 2), ("image", 2), ("frames", 3), ("verdict", 1))


def _tables(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    yield Text(
        (
            "A mark and a colour say whether the criterion is met: ✓ met, ✗ not. Values without a mark are not judged. "
            "Rendered SNR and CNR are missing where bits saturate. The thesis's column is its formula as printed at the "
            "row's exposure.",
        )
    )
    yield Download("Save all exposures as CSV", "mantis-budget.csv", _csv(result.dataset))
    shown = shown_exposure(result.scenario)
    for i in sorted(range(result.dataset.sizes["exposure"]), key=lambda i: i != shown):
        label = str(result.dataset.exposure.values[i])
        rows = tuple(
            _row(result.dataset.sel(range_m=r, illumination=illumination).isel(exposure=i), label, summary)
            for illumination in result.scenario.budget.illuminations
            for r in result.scenario.budget.ranges_m
        )
        table = Table(_COLUMNS, rows, f"Every range with {exposure_name(label)}", _GROUPS, sortable=True)
        yield table if i == shown else Details(f"The same with {label}", (table,))


def _small(value: float) -> str:
    """A number of which less than a hundredth does not matter."""
    return "<0.01" if 0 <= value < 0.01 else number(value)


def _row(here: xr.Dataset, label: str, summary: Summary) -> tuple[Cell, ...]:
    illumination = str(here.illumination.values)
    margin = {str(c): float(m) for c, m in zip(here.criterion.values, here.margin.values, strict=True)}

    def cell(variable: str, criterion: str | None = None, say: Callable[[float], str] = number) -> Cell:
        value = float(here[variable])
        return Cell(say(value), value, margin[criterion] >= 1 if criterion else None)

    def rendered(name: str) -> Cell:
        value, half = float(here[f"{name}_rendered"]), float(here[f"{name}_rendered_ci95"])
        return Cell("–" if np.isnan(value) else f"{number(value)} ± {half:.2g}", value)

    case = next(c for c in summary.cases if c.illumination == illumination and c.exposure == label)
    failing = case.failing_at(float(here.range_m))
    return (
        Cell(f"{float(here.range_m):g}", float(here.range_m)),
        Cell(ILLUMINATION_NAMES[illumination]),
        cell("exposure_s", say=seconds_text),
        cell("full_well_fraction", "saturation"),
        cell("snr_analytic"),
        rendered("snr"),
        cell("snr_thesis", say=_small),
        cell("cnr_analytic", "cnr"),
        rendered("cnr"),
        cell("px_per_bit", "sampling"),
        cell("smear_px", "smear", _small),
        cell("detected_fraction", "detection", lambda v: f"{100 * v:.0f} %"),
        cell("attitude_error_p95_deg", "attitude", lambda v: "–" if np.isnan(v) else f"{v:.2g}"),
        cell("range_error_p95", "range", lambda v: "–" if np.isnan(v) else f"{100 * v:.2g} %"),
        Cell(", ".join(failing) if failing else "closes", len(failing), not failing, "left"),
    )


def _csv(dataset: xr.Dataset) -> str:
    """Every variable at every range, illumination and exposure, a row a case; units in the headings."""
    per_case = dataset.drop_dims(["trial", "criterion"])
    shape = per_case.exposure_s.dims
    columns: dict[str, list[object]] = {}
    grid = xr.broadcast(*[per_case[name] for name in shape])
    for name, array in zip(shape, grid, strict=True):
        columns[str(name)] = list(array.transpose(*shape).values.ravel().tolist())
    for name, array in per_case.data_vars.items():
        unit = array.attrs.get("units", "1")
        full = array.broadcast_like(per_case.exposure_s).transpose(*shape)
        columns[f"{name} [{unit}]"] = full.values.ravel().tolist()
    for i, criterion in enumerate(dataset.criterion.values):
        columns[f"margin_{criterion} [1]"] = (
            dataset.margin.transpose(*shape, "criterion").values[..., i].ravel().tolist()
        )
    return csv_text(columns)


def _matrices(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    yield Text(
        (
            "Each number is the margin: the factor by which the criterion is met (✓, 1 or more) or missed (✗, below 1). "
            "A dash means that there was nothing to measure, which fails.",
        )
    )
    ranges = result.scenario.budget.ranges_m
    for case in summary.cases:
        here = result.dataset.sel(illumination=case.illumination).isel(exposure=_index(result, case))
        rows = []
        for name, measure in MEASURES.items():
            margins = here.margin.sel(criterion=name).values
            values = here[measure.variable].values
            cells = [_margin(m, v) for m, v in zip(margins, values, strict=True)]
            rows.append((Cell(measure.name), *cells))
        rows.append((Cell("closes"), *(Cell("", None, r in case.closing_m) for r in ranges)))
        table = Table(
            ("range [m]", *(f"{r:g}" for r in ranges)), tuple(rows),
            f"{ILLUMINATION_NAMES[case.illumination].capitalize()}, {exposure_name(case.exposure)}", compact=True,
        )  # fmt: skip
        yield table if case.shown else Details(table.caption, (table,))


def _index(result: BudgetResult, case: CaseVerdict) -> int:
    return [str(v) for v in result.dataset.exposure.values].index(case.exposure)


def _margin(margin: float, value: float) -> Cell:
    if np.isnan(value):
        return Cell("–", None, False)
    text = (
        ">99"
        if margin >= 99.5
        else "0"
        if margin == 0
        else "<0.01"
        if margin < 0.01
        else f"{margin:.3g}"
        if 0.95 < margin < 1.1
        else f"{margin:.2g}"
    )
    return Cell(text, None, bool(margin >= 1))
