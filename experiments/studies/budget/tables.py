"""Tables of a budget: range by range, the margins of every criterion, and every case as CSV."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Block, Cell, Details, Download, Table, Text, csv_text
from experiments.reporting.formatting import ILLUMINATION_NAMES, number, seconds_text
from experiments.studies.budget.criteria import MEASURES
from experiments.studies.budget.study import BudgetResult, shown_exposure
from experiments.studies.budget.verdict import CaseVerdict, Summary, exposure_name

#: Columns of the table of ranges by the group that they stand under.
_COLUMNS = {
    "case": ("range [m]", "illumination", "exposure"),
    "charge": ("bright bit / full well",),
    "SNR": ("closed form", "rendered ±"),
    "CNR": ("closed form", "rendered ±"),
    "image": ("px/bit", "smear [px]"),
    "frames": ("marker found", "attitude p95 [°]", "range error p95"),
    "verdict": ("what fails",),
}
_HEADINGS = tuple(heading for headings in _COLUMNS.values() for heading in headings)
_GROUPS = tuple((group, len(headings)) for group, headings in _COLUMNS.items())


def range_by_range(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    """A table an exposure, the shown one first, and every case of all exposures as a file."""
    yield Text(
        (
            "A mark and a colour say whether a criterion is met: ✓ met, ✗ not. Values without a mark are not judged. Rendered "
            "SNR and CNR are missing where bits saturate.",
        )
    )
    yield Download("All exposures as CSV", "mantis-budget.csv", all_cases_csv(result.dataset), key="")
    for case_label in _labels(result):
        rows = tuple(
            _row(result.dataset.sel(range_m=range_m, illumination=illumination, exposure=case_label), summary)
            for illumination in result.scenario.budget.illuminations
            for range_m in result.scenario.budget.ranges_m
        )
        shown = case_label == _labels(result)[0]
        caption = f"Every range with {exposure_name(case_label)}"
        table = Table(_HEADINGS, rows, caption, _GROUPS, key=f"ranges-{_slug(case_label)}", inline=shown)
        yield table if shown else Details(f"The same with {case_label}", (table,))


def margins(result: BudgetResult, summary: Summary) -> Iterator[Block]:
    """By which factor every criterion is met at every range, a table for each illumination and exposure."""
    yield Text(
        (
            "Each number is the margin: the factor by which the criterion is met (✓, 1 or more) or missed (✗, below 1). A dash "
            "means that there was nothing to measure, which counts as a failure.",
        )
    )
    ranges = result.scenario.budget.ranges_m
    for case in summary.cases:
        here = result.dataset.sel(illumination=case.illumination, exposure=case.exposure)
        rows = [_margin_row(here, name) for name in MEASURES]
        rows.append((Cell("closes"), *(Cell("", None, r in case.closing_m) for r in ranges)))
        headings = ("range [m]", *(f"{r:g}" for r in ranges))
        table = Table(headings, tuple(rows), _case_name(case), compact=True)
        yield table if case.shown else Details(table.caption, (table,))


def all_cases_csv(dataset: xr.Dataset) -> str:
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
    for criterion in dataset.criterion.values:
        margin = dataset.margin.sel(criterion=criterion).transpose(*shape)
        columns[f"margin_{criterion} [1]"] = margin.values.ravel().tolist()
    return csv_text(columns)


def _labels(result: BudgetResult) -> list[str]:
    """The exposures' names, that of the shown one first."""
    labels = [str(label) for label in result.dataset.exposure.values]
    shown = labels[shown_exposure(result.scenario)]
    return [shown, *(label for label in labels if label != shown)]


def _slug(label: str) -> str:
    """A name of an exposure as part of a file's name: '1-30-s' for '1/30 s'."""
    return re.sub(r"[^a-z0-9.]+", "-", label.lower().replace("µ", "u"))


def _row(here: xr.Dataset, summary: Summary) -> tuple[Cell, ...]:
    illumination, label = str(here.illumination.values), str(here.exposure.values)
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
        cell("cnr_analytic", "cnr"),
        rendered("cnr"),
        cell("px_per_bit", "sampling"),
        cell("smear_px", "smear", _small),
        cell("detected_fraction", "detection", lambda v: f"{100 * v:.0f} %"),
        cell("attitude_error_p95_deg", "attitude", lambda v: "–" if np.isnan(v) else f"{v:.2g}"),
        cell("range_error_p95", "range", lambda v: "–" if np.isnan(v) else f"{100 * v:.2g} %"),
        Cell(", ".join(failing) if failing else "closes", len(failing), not failing, "left"),
    )


def _small(value: float) -> str:
    """A number of which less than a hundredth does not matter."""
    return "<0.01" if 0 <= value < 0.01 else number(value)


def _margin_row(here: xr.Dataset, criterion: str) -> tuple[Cell, ...]:
    measure = MEASURES[criterion]
    values, found = here[measure.variable].values, here.margin.sel(criterion=criterion).values
    return Cell(measure.name), *(_margin(m, v) for m, v in zip(found, values, strict=True))


def _margin(margin: float, value: float) -> Cell:
    return Cell("–", None, False) if np.isnan(value) else Cell(_margin_text(margin), None, bool(margin >= 1))


def _margin_text(margin: float) -> str:
    """Two digits, and three about the limit so that none is rounded across it."""
    if margin >= 99.5:
        return ">99"
    if margin == 0:
        return "0"
    if margin < 0.01:
        return "<0.01"
    return f"{margin:.3g}" if 0.95 < margin < 1.1 else f"{margin:.2g}"


def _case_name(case: CaseVerdict) -> str:
    return f"{ILLUMINATION_NAMES[case.illumination].capitalize()}, {exposure_name(case.exposure)}"
