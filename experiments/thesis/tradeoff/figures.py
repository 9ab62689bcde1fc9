"""Figures of the trade-off: scores by criterion, and what a change of one weight does."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr

from experiments.reporting.figures import BLACK, COLOURS, new_figure
from experiments.thesis.tradeoff.ahp import MODES


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
