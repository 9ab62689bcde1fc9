"""The concept trade-off of the thesis's chapter 4, recomputed cell by cell, and any other problem of the same form."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from experiments.chain.progress import Progress
from experiments.thesis.tradeoff.ahp import decide
from experiments.thesis.tradeoff.cells import PrintedCell, thesis_cells
from experiments.thesis.tradeoff.plan import FULL, Plan
from experiments.thesis.tradeoff.problem import ProblemFile


@dataclass(frozen=True)
class TradeoffResult:
    """A solved decision problem.

    Attributes:
        source: the problem and the text of its file.
        dataset: of `ahp.decide`.
        cells: the thesis's printed numbers beside the right ones; empty for another problem.
    """

    source: ProblemFile
    dataset: xr.Dataset
    cells: tuple[PrintedCell, ...]


def run(source: ProblemFile, plan: Plan = FULL, progress: Progress | None = None) -> TradeoffResult:
    """Solve a decision problem, and hold the thesis's printed numbers against it where it is the thesis's."""
    return TradeoffResult(source, decide(source.problem), thesis_cells() if source.is_thesis else ())
