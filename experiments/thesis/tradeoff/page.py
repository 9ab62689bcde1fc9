"""The page of `mantis tradeoff`: which alternative wins, how robustly, and the thesis's printed cells one by one."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from experiments.reporting.blocks import (
    Block,
    Card,
    Cell,
    Code,
    Details,
    Plot,
    Plots,
    Section,
    Table,
    Text,
    text_table,
)
from experiments.reporting.page import Page
from experiments.thesis.claims import THESIS
from experiments.thesis.tradeoff import figures
from experiments.thesis.tradeoff.ahp import MODES
from experiments.thesis.tradeoff.cells import VERDICTS, PrintedCell
from experiments.thesis.tradeoff.study import TradeoffResult

#: Saaty's limit for a consistent matrix of judgements (The Analytic Hierarchy Process, 1980).
CONSISTENT = 0.10
LIMITS = (
    "Judgements: those of the problem file, taken as they are; nothing here says whether they are wise. The thesis's own are "
    "its tables 4.2 and 4.3.",
    "Priorities are the principal eigenvectors of the matrices of judgements. The ideal mode scales each criterion's best "
    "alternative to one, the distributive mode its sum (Saaty; Belton and Gear on rank reversal).",
    f"A matrix is consistent where its consistency ratio is at most {CONSISTENT:g} (Saaty).",
    "One weight or one measure changes at a time.",
)
#: How the thesis's digits come about.
RECIPE = (
    "‘Reproduced’ is the recipe that gives the thesis's digits, found by trying: priorities rounded to three digits, their "
    "ideal mode unrounded, and normalised scores against ideal-mode measures in tables 4.5 and 4.6. ‘Right’ is at full "
    "precision, with one normalisation throughout."
)


def page(result: TradeoffResult, command: str) -> Page:
    """What the trade-off says.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
    """
    data, cells = result.dataset, result.cells
    winners = {_best(data, mode) for mode in MODES}
    worst = float(data.consistency_ratio.max())
    said = (
        f"{_best(data, MODES[0]).capitalize()} wins in both modes"
        if len(winners) == 1
        else "The winner depends on the mode"
    )
    right = sum(cell.verdict == "right" for cell in cells)
    sections = [Section("scores", "Scores", tuple(_scores(data)))]
    if cells:
        sections.append(Section("cells", "The thesis's tables, cell by cell", tuple(_cells(cells))))
    problem = (Text(("The decision problem as its file states it.",)), Code(result.source.text))
    sections.append(Section("problem", "The judgements", (Details("The problem file", problem),)))
    return Page(
        study="tradeoff",
        title=str(data.attrs["title"]),
        headline=f"{said}; {right} of the thesis's {len(cells)} printed cells are right." if cells else f"{said}.",
        passed=len(winners) == 1 and worst <= CONSISTENT,
        command=command,
        about=(f"The trade-off of chapter 4 of the thesis ({THESIS}), recomputed.",) if cells else (),
        cards=tuple(_cards(data, worst)),
        sections=tuple(sections),
        limits=LIMITS,
        data=data,
    )


def _best(data: xr.Dataset, mode: str) -> str:
    return str(data.alternative.values[int(data["rank"].sel(mode=mode).values.argmin())])


def _cards(data: xr.Dataset, worst: float) -> Iterator[Card]:
    for mode in MODES:
        scores = 100 * data.normalised_score.sel(mode=mode)
        order = scores.argsort().values[::-1]
        lines = tuple(f"{data.alternative.values[k]}: {float(scores[k]):.2f} %" for k in order)
        yield Card(f"{mode.capitalize()} mode", _best(data, mode), "wins; normalised scores", lines, None)
    judged = tuple(
        f"{name}: {float(ratio):.3f}"
        for name, ratio in zip(data.matrix.values, data.consistency_ratio.values, strict=True)
    )
    note = f"largest consistency ratio, {CONSISTENT:g} allowed"
    yield Card("Consistency", f"{worst:.3f}", note, judged, worst <= CONSISTENT)


def _scores(data: xr.Dataset) -> Iterator[Block]:
    yield scores_table(data)
    caption = "Normalised scores in both modes, by criterion."
    yield Plots((Plot("scores", figures.score_figure(data), caption),))
    caption = "Scores in the ideal mode against the weight of each criterion. Circles: a change of winner. Dotted: the weight."
    yield Plots((Plot("weights", figures.weight_figure(data), caption),))


def scores_table(data: xr.Dataset) -> Table:
    """Scores [%] and ranks of each alternative in both modes, best of the ideal mode first."""
    rows: list[tuple[str, ...]] = [("alternative", "ideal [%]", "ideal rank", "distributive [%]", "distributive rank")]
    order = data["rank"].sel(mode="ideal").argsort().values
    for alternative in data.alternative.values[order]:
        row: list[str] = [str(alternative)]
        for mode in MODES:
            at = data.sel(mode=mode, alternative=alternative)
            row += [f"{100 * float(at.normalised_score):.2f}", str(int(at["rank"]))]
        rows.append(tuple(row))
    return text_table(rows, "Scores and ranks in both modes", key="scores", terminal=True)


def _cells(cells: tuple[PrintedCell, ...]) -> Iterator[Block]:
    yield Text((RECIPE,))
    yield verdicts_table(cells)
    yield Details("Every printed cell", (cells_table(cells),), printed=True)


def verdicts_table(cells: tuple[PrintedCell, ...]) -> Table:
    """How many cells of each of the thesis's tables got which verdict."""
    rows: list[tuple[str, ...]] = [("table", *VERDICTS)]
    for table in sorted({cell.table for cell in cells}):
        own = [cell.verdict for cell in cells if cell.table == table]
        rows.append((table, *(str(own.count(verdict)) for verdict in VERDICTS)))
    return text_table(rows, "The thesis's printed cells, by verdict", terminal=True)


def cells_table(cells: tuple[PrintedCell, ...]) -> Table:
    """Every printed cell beside the reproduced and the right one."""
    rows = tuple(
        (
            Cell(c.table),
            Cell(c.row, style="left"),
            Cell(c.column, style="left"),
            Cell(c.printed_text),
            Cell(c.text(c.reproduced)),
            Cell(c.text(c.right)),
            Cell(c.verdict, passed=c.verdict == "right", style="left"),
        )
        for c in cells
    )
    headings = ("table", "row", "column", "printed", "reproduced", "right", "verdict")
    return Table(headings, rows, "Every printed cell", key="cells", inline=False)
