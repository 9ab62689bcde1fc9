"""A budget in the terminal: a table of the shown exposure and the verdict in words, readable at a hundred columns."""

from __future__ import annotations

import numpy as np
import xarray as xr
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from experiments.reporting.formatting import ILLUMINATION_NAMES, number, seconds_text
from experiments.studies.budget.study import BudgetResult, shown_exposure
from experiments.studies.budget.verdict import CaseVerdict, Summary, exposure_name, summarise

_GOOD, _BAD = "blue", "bold red"
_HEADINGS = (
    "range\nm",
    "exposure\n",
    "S/full\nwell",
    "SNR\nform | rend.",
    "CNR\nform | rend.",
    "px/\nbit",
    "found\n%",
    "attitude\n°",
)


def budget_table(result: BudgetResult) -> Table:
    """Every range and illumination with the shown exposure; what fails is marked ✗ in words and colour."""
    shown = shown_exposure(result.scenario)
    label = str(result.dataset.exposure.values[shown])
    table = Table(
        title=Text(f"{result.scenario.title}, {exposure_name(label)}", style="bold"),
        caption="SNR and CNR: closed form | rendered.",
        box=None,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("verdict\n", justify="left", min_width=11)
    for case in summarise(result.dataset, result.scenario).shown:
        table.add_section()
        table.add_row(Text(ILLUMINATION_NAMES[case.illumination], style="bold"))
        here = result.dataset.sel(illumination=case.illumination).isel(exposure=shown)
        for range_m in case.ranges_m:
            table.add_row(*_cells(here.sel(range_m=range_m), case))
    return table


def verdict_panel(summary: Summary) -> Panel:
    """Headline, what fails in each illumination and exposure, and advice."""
    rows: list[RenderableType] = [Text(summary.headline, style="bold")]
    for case in summary.cases:
        rows.append(Text(case.text))
        rows += [Padding(Text(failure), (0, 0, 0, 2)) for failure in case.failures]
    advice = Table.grid(padding=(0, 1))
    for sentence in summary.advice:
        advice.add_row("→", Text(sentence))
    title = "✓ closes" if summary.closes else "✗ does not close"
    border = _GOOD if summary.closes else _BAD
    return Panel(Group(*rows, advice), title=title, title_align="left", border_style=border)


def _cells(here: xr.Dataset, case: CaseVerdict) -> list[Text]:
    margins = dict(zip(here.criterion.values, here.margin.values, strict=True))

    def cell(text: str, criterion: str) -> Text:
        return Text(text, style="" if margins[criterion] >= 1 else _BAD)

    def pair(name: str) -> str:
        rendered = float(here[f"{name}_rendered"])
        return f"{_three(float(here[f'{name}_analytic']))} | {_three(rendered):>4}"

    attitude = float(here.attitude_error_p95_deg)
    failing = case.failing_at(float(here.range_m))
    return [
        Text(f"{float(here.range_m):g}"),
        Text(seconds_text(float(here.exposure_s))),
        cell(f"{float(here.full_well_fraction):.3g}", "saturation"),
        Text(pair("snr")),
        cell(pair("cnr"), "cnr"),
        cell(f"{float(here.px_per_bit):.3g}", "sampling"),
        cell(f"{100 * float(here.detected_fraction):.0f}", "detection"),
        cell("–" if np.isnan(attitude) else f"{attitude:.2g}", "attitude"),
        Text(f"✗ {', '.join(failing)}" if failing else "✓ closes", style=_BAD if failing else _GOOD),
    ]


def _three(value: float) -> str:
    return f"{value:.3g}" if 1e-3 < value < 1e4 else number(value)
