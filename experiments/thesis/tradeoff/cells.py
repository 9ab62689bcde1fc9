"""Every number that the thesis's tables 4.2 to 4.6 print, beside what it should be.

Each printed number is set beside two others: *reproduced*, by the recipe that gives the thesis's digits, and *right*,
at full precision and with one normalisation throughout. The recipe, found by trying: priority vectors rounded to three
digits, their ideal mode unrounded, and in tables 4.5 and 4.6 ideal-mode measures against scores normalised to sum one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from experiments.thesis.tradeoff.ahp import FloatArray, decide, load_problem
from experiments.thesis.tradeoff.problem import THESIS_PROBLEM

VERDICTS = ("right", "rounding", "method", "sign", "misprint")


@dataclass(frozen=True)
class PrintedCell:
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

    def text(self, value: float) -> str:
        """A value with one digit more than is printed; 'n/a' for NaN."""
        digits = self.decimals + 1
        # + 0.0 turns a rounded −0.0 into 0.0.
        return "n/a" if np.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"

    @property
    def verdict(self) -> str:
        """Right | rounding (of the inputs) | method (another normalisation or bound) | sign | misprint."""
        if self.agrees(self.right):
            return "right"
        if not np.isnan(self.reproduced) and self.agrees(-self.reproduced):
            return "sign"
        if not self.agrees(self.reproduced):
            return "misprint"
        # Inputs of three digits leave about 1 % in a number derived from them; NaN is never close to anything.
        return "rounding" if abs(self.reproduced - self.right) <= 0.01 * abs(self.right) else "method"


def thesis_cells() -> tuple[PrintedCell, ...]:
    """Every number of tables 4.2 to 4.6, printed, reproduced and right (ideal mode, which the thesis adopts)."""
    problem = load_problem(THESIS_PROBLEM)
    printed = tomllib.loads(THESIS_PROBLEM.read_text(encoding="utf-8"))["printed"]
    right = decide(problem)
    recipe = _thesis_recipe(right)
    return (
        *_consistency_cells(printed, right),
        *_score_cells(printed, right, recipe),
        *_reversal_cells(printed, right, recipe),
    )


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


def _consistency_cells(printed: dict[str, Any], right: xr.Dataset) -> Iterator[PrintedCell]:
    columns = {"λ max": "largest_eigenvalue", "CI": "consistency_index", "CR": "consistency_ratio"}
    for matrix, values in printed["consistency"].items():
        table = "4.2" if matrix == "weights" else "4.3"
        for (column, variable), text in zip(columns.items(), values, strict=True):
            value = float(right[variable].sel(matrix=matrix))
            yield PrintedCell(table, matrix, column, text, value, value)


def _score_cells(printed: dict[str, Any], right: xr.Dataset, recipe: _Recipe) -> Iterator[PrintedCell]:
    criteria, alternatives = right.criterion.values, right.alternative.values
    ideal, priority = right.measure.sel(mode="ideal").values, right.measure.sel(mode="distributive").values
    for k, criterion in enumerate(criteria):
        weight = float(right.weight[k])
        yield PrintedCell("4.2", criterion, "priority", printed["table_4_2"]["weights"][k], weight, weight)
        yield PrintedCell("4.4", "weight", criterion, printed["table_4_2"]["weights"][k], weight, weight)
        for i, alternative in enumerate(alternatives):
            texts = {kind: printed["table_4_3"][kind][k][i] for kind in ("priority", "ideal")}
            yield PrintedCell(
                "4.3", f"{criterion}: {alternative}", "priority", texts["priority"], priority[i, k], priority[i, k]
            )
            yield PrintedCell(
                "4.3", f"{criterion}: {alternative}", "ideal", texts["ideal"], recipe.measures[i, k], ideal[i, k]
            )
            yield PrintedCell(
                "4.4", alternative, criterion, printed["table_4_4"][alternative][k], recipe.measures[i, k], ideal[i, k]
            )
    for i, alternative in enumerate(alternatives):
        score, share = printed["table_4_4"][alternative][len(criteria) :]
        yield PrintedCell("4.4", alternative, "score", score, recipe.scores[i], float(right.score.sel(mode="ideal")[i]))
        normalised = 100 * float(right.normalised_score.sel(mode="ideal")[i])
        yield PrintedCell("4.4", alternative, "normalised score [%]", share, 100 * recipe.shares[i], normalised)


def _reversal_cells(printed: dict[str, Any], right: xr.Dataset, recipe: _Recipe) -> Iterator[PrintedCell]:
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
                yield PrintedCell(
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
