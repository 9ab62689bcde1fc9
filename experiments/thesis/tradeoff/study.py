"""The concept trade-off of the thesis's chapter 4, recomputed cell by cell, and any other problem of the same form.

Every printed number is set beside two others: *reproduced*, by the recipe that gives the thesis's digits, and *right*,
at full precision and with one normalisation throughout. The recipe, found by trying: priority vectors rounded to three
digits, their ideal mode unrounded, and in tables 4.5 and 4.6 ideal-mode measures against scores normalised to sum one.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments.reporting.figures import BLACK, COLOURS, new_figure, save_svg
from experiments.reporting.files import write_netcdf, write_text
from experiments.thesis.tradeoff.ahp import MODES, DecisionProblem, FloatArray, decide, load_problem

THESIS_PROBLEM = Path(__file__).parent / "thesis.toml"


@dataclass(frozen=True)
class Cell:
    """One number of a printed table. NaN stands for "n/a"; percentages are in per cent, as printed."""

    table: str
    row: str
    column: str
    printed_text: str
    reproduced: float
    right: float

    @property
    def printed(self) -> float:
        """The printed value as a number."""
        return float("nan") if self.printed_text == "n/a" else float(self.printed_text)

    @property
    def decimals(self) -> int:
        """Digits after the printed point."""
        return len(self.printed_text.partition(".")[2]) if self.printed_text != "n/a" else 2

    def agrees(self, value: float) -> bool:
        """Whether `value`, rounded as the cell is, gives the printed digits."""
        if np.isnan(value) or np.isnan(self.printed):
            return bool(np.isnan(value) and np.isnan(self.printed))
        # Half a unit of the last place, and a hair for values that lie on the very edge.
        return abs(value - self.printed) <= 0.5001 * 10.0**-self.decimals

    @property
    def verdict(self) -> str:
        """right | rounding (of the inputs) | method (another normalisation or bound) | sign | misprint."""
        if self.agrees(self.right):
            return "right"
        if not np.isnan(self.reproduced) and self.agrees(-self.reproduced):
            return "sign"
        if not self.agrees(self.reproduced):
            return "misprint"
        # Inputs of three digits leave about 1 % in a number derived from them; NaN is never close to anything.
        return "rounding" if abs(self.reproduced - self.right) <= 0.01 * abs(self.right) else "method"


def thesis_cells() -> list[Cell]:
    """Every number of tables 4.2 to 4.6, printed, reproduced and right (ideal mode, which the thesis adopts)."""
    problem = load_problem(THESIS_PROBLEM)
    printed = tomllib.loads(THESIS_PROBLEM.read_text(encoding="utf-8"))["printed"]
    right = decide(problem)
    recipe = _thesis_recipe(right)
    return [
        *_consistency_cells(printed, right),
        *_score_cells(printed, right, recipe),
        *_reversal_cells(printed, right, recipe),
    ]


@dataclass(frozen=True)
class _Recipe:
    """The thesis's numbers as it seems to have made them."""

    weights: FloatArray
    measures: FloatArray
    scores: FloatArray

    @property
    def shares(self) -> FloatArray:
        return self.scores / self.scores.sum()


def _thesis_recipe(right: xr.Dataset) -> _Recipe:
    weights = right.weight.values.round(3)
    rounded = right.measure.sel(mode="distributive").values.round(3)
    measures = rounded / rounded.max(axis=0)
    return _Recipe(weights, measures, measures @ weights)


def _consistency_cells(printed: dict[str, Any], right: xr.Dataset) -> Iterator[Cell]:
    columns = {"λ max": "largest_eigenvalue", "CI": "consistency_index", "CR": "consistency_ratio"}
    for matrix, values in printed["consistency"].items():
        table = "4.2" if matrix == "weights" else "4.3"
        for (column, variable), text in zip(columns.items(), values, strict=True):
            value = float(right[variable].sel(matrix=matrix))
            yield Cell(table, matrix, column, text, value, value)


def _score_cells(printed: dict[str, Any], right: xr.Dataset, recipe: _Recipe) -> Iterator[Cell]:
    criteria, alternatives = right.criterion.values, right.alternative.values
    ideal, priority = right.measure.sel(mode="ideal").values, right.measure.sel(mode="distributive").values
    for k, criterion in enumerate(criteria):
        weight = float(right.weight[k])
        yield Cell("4.2", criterion, "priority", printed["table_4_2"]["weights"][k], weight, weight)
        yield Cell("4.4", "weight", criterion, printed["table_4_2"]["weights"][k], weight, weight)
        for i, alternative in enumerate(alternatives):
            texts = {kind: printed["table_4_3"][kind][k][i] for kind in ("priority", "ideal")}
            yield Cell(
                "4.3", f"{criterion}: {alternative}", "priority", texts["priority"], priority[i, k], priority[i, k]
            )
            yield Cell(
                "4.3", f"{criterion}: {alternative}", "ideal", texts["ideal"], recipe.measures[i, k], ideal[i, k]
            )
            yield Cell(
                "4.4", alternative, criterion, printed["table_4_4"][alternative][k], recipe.measures[i, k], ideal[i, k]
            )
    for i, alternative in enumerate(alternatives):
        score, share = printed["table_4_4"][alternative][len(criteria) :]
        yield Cell("4.4", alternative, "score", score, recipe.scores[i], float(right.score.sel(mode="ideal")[i]))
        normalised = 100 * float(right.normalised_score.sel(mode="ideal")[i])
        yield Cell("4.4", alternative, "normalised score [%]", share, 100 * recipe.shares[i], normalised)


def _reversal_cells(printed: dict[str, Any], right: xr.Dataset, recipe: _Recipe) -> Iterator[Cell]:
    ideal = right.sel(mode="ideal")
    for table, variable, formula in (
        ("4.5", "weight_reduction", _weight_formula),
        ("4.6", "measure_reduction", _measure_formula),
    ):
        for pair, texts in printed[f"table_{table.replace('.', '_')}"].items():
            i, k = (int(number) - 1 for number in pair.split("-"))
            values = formula(recipe, i, k)
            for j, text in enumerate(texts):
                # The thesis leaves out every change beyond 100 %, in either direction.
                reproduced = 100 * values[j] if abs(values[j]) <= 1 else np.nan
                yield Cell(
                    table, pair, str(right.criterion.values[j]), text, reproduced, 100 * float(ideal[variable][i, k, j])
                )


def _weight_formula(recipe: _Recipe, i: int, j: int) -> FloatArray:
    """Equations 4.4 and 4.5 with normalised scores and ideal-mode measures, which do not belong together."""
    slope = recipe.measures[j] - recipe.measures[i]
    gap = np.full(slope.shape, recipe.shares[j] - recipe.shares[i])
    return np.divide(gap, slope, out=np.full(slope.shape, np.inf), where=slope != 0) / recipe.weights


def _measure_formula(recipe: _Recipe, i: int, k: int) -> FloatArray:
    """Equation 4.7, which is the distributive mode's, on ideal-mode measures."""
    gap = recipe.shares[i] - recipe.shares[k]
    return gap / (gap + recipe.weights * (recipe.measures[k] - recipe.measures[i] + 1)) / recipe.measures[i]


def cells_csv(cells: list[Cell]) -> str:
    """The comparison as CSV, one cell of a table a line."""
    buffer = StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["table", "row", "column", "printed", "reproduced", "right", "verdict"])
    for c in cells:
        # + 0.0 turns a rounded −0.0 into 0.0.
        values = [
            "n/a" if np.isnan(v) else f"{round(v, c.decimals + 1) + 0.0:.{c.decimals + 1}f}"
            for v in (c.reproduced, c.right)
        ]
        writer.writerow([c.table, c.row, c.column, c.printed_text, *values, c.verdict])
    return buffer.getvalue()


def score_figure(result: xr.Dataset) -> Any:
    """Stacked share of each criterion in each alternative's normalised score, one panel a mode."""
    figure, axes = new_figure(1, 2, (7.2, 3.0), sharey=True)
    for axis, mode in zip(axes[0], MODES, strict=True):
        chosen = result.sel(mode=mode)
        part = 100 * (chosen.measure * chosen.weight / chosen.score.sum()).transpose("criterion", "alternative").values
        left = np.zeros(part.shape[1])
        for values, name, colour in zip(part, result.criterion.values, COLOURS * 2, strict=False):
            axis.barh(
                result.alternative.values, values, left=left, color=colour, edgecolor="white", linewidth=0.6, label=name
            )
            left += values
        for row, total in enumerate(left):
            axis.text(total + 0.5, row, f"{total:.1f}", va="center", fontsize=8)
        axis.set_xlim(0, 1.15 * left.max())
        axis.set_title(f"{mode} mode")
        axis.set_xlabel("normalised score [%]")
        axis.grid(axis="y", visible=False)
    axes[0, 0].invert_yaxis()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), fontsize=8)
    return figure


def weight_figure(result: xr.Dataset, mode: str = "ideal") -> Any:
    """Normalised score of each alternative against the weight of one criterion, the other weights in proportion."""
    chosen, names = result.sel(mode=mode), result.criterion.values
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure, axes = new_figure(rows, columns, (7.2, 0.6 + 2.1 * rows), sharex=True, sharey=True)
    share = np.linspace(0, 1, 1001)
    for k, (axis, name) in enumerate(zip(axes.flat, names, strict=False)):
        now = float(chosen.weight[k])
        others = np.delete(np.arange(len(names)), k)
        rest = chosen.measure.values[:, others] @ chosen.weight.values[others] / (1 - now)
        scores = np.outer(rest, 1 - share) + np.outer(chosen.measure.values[:, k], share)
        for row, alternative in enumerate(result.alternative.values):
            style = {"color": COLOURS[row % len(COLOURS)], "ls": ("-", "--", "-.", ":")[row % 4]}
            axis.plot([0, 1], scores[row, [0, -1]], label=alternative, **style)
        axis.axvline(now, color=BLACK, lw=0.8, ls=":")
        axis.annotate(f"weight {now:.3f}", (now, 0.03), xytext=(3, 0), textcoords="offset points", fontsize=7)
        best = scores.argmax(axis=0)
        for at in [i for i, (a, b) in enumerate(pairwise(best)) if a != b]:
            axis.plot(share[at], scores[best[at], at], "o", color=BLACK, ms=5, mfc="none")
        axis.set_title(name)
        axis.set_ylim(0, 1.05)
    for axis in axes[-1]:
        axis.set_xlabel("weight of the criterion [1]")
    for axis in axes[:, 0]:
        axis.set_ylabel(f"score, {mode} mode [1]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4), fontsize=8)
    return figure


def summary_rows(result: xr.Dataset) -> list[tuple[str, ...]]:
    """Header, then one row an alternative, best of the ideal mode first: scores [%] and ranks in both modes."""
    rows: list[tuple[str, ...]] = [("alternative", "ideal [%]", "ideal rank", "distributive [%]", "distributive rank")]
    order = result["rank"].sel(mode="ideal").argsort().values
    for alternative in result.alternative.values[order]:
        row: list[str] = [str(alternative)]
        for mode in MODES:
            at = result.sel(mode=mode, alternative=alternative)
            row += [f"{100 * float(at.normalised_score):.2f}", str(int(at["rank"]))]
        rows.append(tuple(row))
    return rows


def verdict_rows(cells: list[Cell]) -> list[tuple[str, ...]]:
    """Header, then one row a table: how many of its cells got which verdict."""
    verdicts = ("right", "rounding", "method", "sign", "misprint")
    tables = sorted({cell.table for cell in cells})
    counts = {(t, v): sum(c.table == t and c.verdict == v for c in cells) for t in tables for v in verdicts}
    return [("table", *verdicts), *((t, *(str(counts[t, v]) for v in verdicts)) for t in tables)]


def run(out_dir: Path, problem_path: Path | None = None) -> xr.Dataset:
    """Solve a decision problem (default: the thesis's) and write its dataset and figures to `out_dir`.

    Writes tradeoff.nc, tradeoff-scores.svg, tradeoff-weights.svg, and for the thesis tradeoff-cells.csv. There is
    nothing random and nothing slow in it, hence no seed and no quick form. Raises ValueError for a bad problem file.
    """
    problem: DecisionProblem = load_problem(problem_path or THESIS_PROBLEM)
    result = decide(problem)
    write_netcdf(result, out_dir / "tradeoff.nc")
    save_svg(score_figure(result), out_dir / "tradeoff-scores.svg")
    save_svg(weight_figure(result), out_dir / "tradeoff-weights.svg")
    if problem_path is None:
        write_text(cells_csv(thesis_cells()), out_dir / "tradeoff-cells.csv")
    return result
