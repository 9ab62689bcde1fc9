"""The risk matrix: the thesis's places and measured ones, before and after mitigation."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.reporting.figures import BLACK, BLUE, VERMILION, new_figure
from experiments.studies.shared.failures import MODES
from experiments.thesis.risk.study import LEVELS, RiskResult, modes

_ROWS = {1: "1: < 1 in 100", 2: "2: < 1 in 40", 3: "3: < 1 in 10", 4: "more often:\nno level"}
_LOOKS: dict[str, dict[str, Any]] = {
    "before: the thesis's pipeline": {"mfc": "white", "mec": VERMILION},
    "after: this project's detector (thesis: as proposed)": {"mfc": BLUE, "mec": BLUE},
}
#: Level of likelihood and of severity, by stage and by mode.
Levels = dict[str, dict[str, tuple[int, int]]]


def matrix(result: RiskResult) -> Figure:
    """The thesis's matrix and one of each study's frames, every mode from before to after."""
    judged: Levels = {mode["name"]: {stage: tuple(mode[stage]) for stage in ("before", "after")} for mode in modes()}
    panels: list[tuple[str, Levels]] = [("the thesis's judgement (figures 8.14, 8.17)", judged)]
    for source in result.sources:
        measured: Levels = {mode: {} for mode in MODES}
        for (name, stage, mode), place in result.places.items():
            if name == source["name"] and stage in ("before", "after"):
                measured[mode][stage] = (place.likelihood, place.severity)
        panels.append((source["title"], measured))
    columns = 3
    plot, axes = new_figure(-(-len(panels) // columns), columns, (9.6, 3.4 * -(-len(panels) // columns)))
    for axis, (title, placed) in zip(axes.ravel(), panels, strict=False):
        _panel(axis, title, placed)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    last = axes.ravel()[0]
    handles = [last.plot([], [], "o", ms=9, label=label, **look)[0] for label, look in _LOOKS.items()]
    names = [f"{k} {mode['title']}" for k, mode in enumerate(modes(), 1)]
    handles += [last.plot([], [], ls="none", label=name)[0] for name in names]
    plot.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8)
    return plot


def _panel(axis: Axes, title: str, placed: Levels) -> None:
    """One matrix, with an arrow from a mode's place before to that after."""
    shade = np.add.outer(np.arange(LEVELS), np.arange(3))
    axis.imshow(
        shade, cmap="Greys", vmin=-1, vmax=14, origin="lower", extent=(0.5, 3.5, 0.5, LEVELS + 0.5), aspect="auto"
    )
    for k, mode in enumerate(MODES):
        # A slot of its own in every cell, so that modes and stages do not lie on each other.
        across = -0.4 + 0.2 * k
        spots = {
            stage: (at[1] + across, at[0] + (0.2 if stage == "before" else -0.2)) for stage, at in placed[mode].items()
        }
        if len(spots) == 2:
            arrow = {"arrowstyle": "->", "color": BLACK, "lw": 0.7, "shrinkA": 6, "shrinkB": 6}
            axis.annotate("", spots["after"], spots["before"], arrowprops=arrow, zorder=1)
        for stage, (x, y) in spots.items():
            filled = stage == "after"
            axis.plot(x, y, "o", ms=10, mfc=BLUE if filled else "white", mec=BLUE if filled else VERMILION, mew=1.3)
            axis.text(
                x, y, str(k + 1), color="white" if filled else BLACK, fontsize=7.5, ha="center", va="center_baseline"
            )
    axis.set(xlim=(0.5, 3.5), ylim=(0.5, LEVELS + 0.5), xlabel="severity level [–]", xticks=[1, 2, 3])
    axis.set_yticks(range(1, LEVELS + 1), [_ROWS[k] for k in range(1, LEVELS + 1)], fontsize=7.5)
    axis.hlines(np.arange(1.5, LEVELS + 0.5), 0.5, 3.5, color="white", lw=1)
    axis.vlines([1.5, 2.5], 0.5, LEVELS + 0.5, color="white", lw=1)
    axis.grid(visible=False)
    axis.set_title(title, fontsize=8)
