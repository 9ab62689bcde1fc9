"""The figure of the requirements: the margins of those that have a number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.reporting.figures import BLACK, BLUE, VERMILION, new_figure
from experiments.thesis.requirements.study import Verified


def margins(verified: Sequence[Verified]) -> Any:
    """Margins of the requirements that have one."""
    having = [v for v in verified if np.isfinite(v.finding.margin)]
    figure, axes = new_figure(size_in=(6.4, 0.9 + 0.36 * max(len(having), 1)))
    axis = axes[0, 0]
    for k, v in enumerate(having):
        colour = BLUE if v.finding.verdict == "met" else VERMILION
        axis.plot([1, v.finding.margin], [k, k], color=colour, lw=3, solid_capstyle="butt")
        axis.plot(v.finding.margin, k, "o", color=colour, ms=6)
        text, at = f"×{v.finding.margin:.3g}, {v.finding.verdict}", (v.finding.margin, k)
        beside: dict[str, Any] = (
            {"ha": "right", "xytext": (-7, -3)} if v.finding.margin < 1 else {"ha": "left", "xytext": (7, -3)}
        )
        axis.annotate(text, at, textcoords="offset points", fontsize=8, **beside)
    axis.axvline(1, color=BLACK, lw=0.8)
    axis.set_yticks(range(len(having)), [v.requirement.identity for v in having])
    axis.set(xscale="log", xlabel="margin [–]: factor by which the figure meets the requirement", xlim=(0.05, 40))
    axis.set_ylim(len(having) - 0.5, -0.6)
    axis.grid(axis="y", visible=False)
    return figure
