"""One plotting style for every study: size, colours, and a file that is the same bytes for the same data."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scenes.atomic import atomic_write

#: Okabe and Ito's palette, told apart by colour-blind readers (jfly.uni-koeln.de/color, 2008), darkest first.
BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY, YELLOW = "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK, YELLOW)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

_STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.markersize": 3.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "mantis",
}


def new_figure(
    rows: int = 1, columns: int = 1, size_in: tuple[float, float] = (6.4, 3.8), **kwargs: Any
) -> tuple[Figure, np.ndarray]:
    """A figure and its axes, always a (rows, columns) array; `kwargs` go to `subplots`.

    Sets matplotlib's defaults for the process: titles and legends look them up when they are made, not with the axes.
    """
    mpl.rcdefaults()  # some libraries set a style of their own when they are imported
    mpl.rcParams.update(_STYLE)
    figure = Figure(figsize=size_in, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **kwargs)


def svg_file(figure: Figure) -> str:
    """The figure as the text of an SVG file."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def save_svg(figure: Figure, path: Path) -> Path:
    """Write the figure as SVG, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(svg_file(figure), encoding="utf-8")
    return path


def svg_element(text: str) -> str:
    """The `<svg>` element of an SVG file, to stand inside HTML."""
    return text[text.index("<svg") :]
