"""The report of `mantis tradeoff`: which alternative wins, how robustly, and the thesis's printed cells one by one."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from experiments.reporting.blocks import (
    Block,
    Bullets,
    Card,
    Cell,
    Code,
    Details,
    Figures,
    Section,
    Table,
    Text,
    text_table,
)
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import digest, made_by, versions_text
from experiments.thesis.tradeoff import study
from experiments.thesis.tradeoff.ahp import MODES

#: Saaty's limit for a consistent matrix of judgements (The Analytic Hierarchy Process, 1980).
CONSISTENT = 0.10
ASSUMPTIONS = (
    "Judgements: those of the problem file, taken as they are. The thesis's own are its tables 4.2 and 4.3.",
    "Priorities are the principal eigenvectors of the matrices of judgements. The ideal mode scales each criterion's best "
    "alternative to one, the distributive mode its sum (Saaty; Belton and Gear on rank reversal).",
    f"A matrix is consistent where its consistency ratio is at most {CONSISTENT:g} (Saaty).",
    "‘Reproduced’ is the recipe that gives the thesis's digits, found by trying: priorities rounded to three digits, their "
    "ideal mode unrounded, and normalised scores against ideal-mode measures in tables 4.5 and 4.6.",
)


def html(result: xr.Dataset, problem_text: str, cells: list[study.Cell], command: str) -> str:
    """The report as one HTML text that loads nothing from elsewhere.

    Args:
        result: of `study.run`.
        problem_text: the problem file's text.
        cells: the thesis's printed cells; empty for another problem.
        command: the command line that made it.
    """
    winners = {mode: _best(result, mode) for mode in MODES}
    worst = float(result.consistency_ratio.max())
    stands = len(set(winners.values())) == 1 and worst <= CONSISTENT
    first = winners[MODES[0]]
    said = (
        f"{first.capitalize()} wins in both modes"
        if len(set(winners.values())) == 1
        else "The winner depends on the mode"
    )
    right = sum(c.verdict == "right" for c in cells)
    headline = f"{said}; {right} of the thesis's {len(cells)} printed cells are right." if cells else f"{said}."
    evidence = [Section("scores", "Scores", tuple(_scores(result)))]
    if cells:
        evidence.append(Section("cells", "The thesis's tables, cell by cell", tuple(_cells(cells))))
    versions = versions_text("numpy", "xarray")
    return render(
        Report(
            str(result.attrs["title"]),
            "Mantis trade-off",
            headline,
            stands,
            tuple(_cards(result, worst)),
            (),
            tuple(evidence),
            (Bullets(ASSUMPTIONS), Text(("The judgements, as the problem file states them:",)), Code(problem_text)),
            tuple(made_by(command, None, {"Problem file": digest(problem_text)}, versions)),
            versions,
        )
    )


def _best(result: xr.Dataset, mode: str) -> str:
    return str(result.alternative.values[int(result["rank"].sel(mode=mode).values.argmin())])


def _cards(result: xr.Dataset, worst: float) -> Iterator[Card]:
    for mode in MODES:
        scores = 100 * result.normalised_score.sel(mode=mode)
        order = scores.argsort().values[::-1]
        lines = tuple(f"{result.alternative.values[k]}: {float(scores[k]):.2f} %" for k in order)
        yield Card(f"{mode.capitalize()} mode", _best(result, mode), "wins; normalised scores", lines, None)
    judged = tuple(
        f"{name}: {float(ratio):.3f}"
        for name, ratio in zip(result.matrix.values, result.consistency_ratio.values, strict=True)
    )
    note = f"largest consistency ratio, {CONSISTENT:g} allowed"
    yield Card("Consistency", f"{worst:.3f}", note, judged, worst <= CONSISTENT)


def _scores(result: xr.Dataset) -> Iterator[Block]:
    yield text_table(study.summary_rows(result), "Scores and ranks in both modes")
    caption = "Normalised scores in both modes, by criterion."
    yield Figures((figure(study.score_figure(result), "scores", caption),), caption)
    caption = "Scores in the ideal mode against the weight of each criterion; circles: a change of winner, dotted: the weight."
    yield Figures((figure(study.weight_figure(result), "weights", caption),), caption)


def _cells(cells: list[study.Cell]) -> Iterator[Block]:
    yield text_table(study.verdict_rows(cells), "Verdicts by table")
    rows = tuple(
        (
            Cell(c.table), Cell(c.row, style="left"), Cell(c.column, style="left"), Cell(c.printed_text),
            _value(c, c.reproduced), _value(c, c.right), Cell(c.verdict, passed=c.verdict == "right", style="left"),
        )
        for c in cells
    )  # fmt: skip
    table = Table(("table", "row", "column", "printed", "reproduced", "right", "verdict"), rows, "Every printed cell")
    yield Details("Every printed cell", (table,), printed=True)


def _value(cell: study.Cell, value: float) -> Cell:
    """A value with one digit more than is printed; the cell's own where the thesis prints none."""
    return Cell("n/a" if value != value else f"{value + 0.0:.{cell.decimals + 1}f}", value)
