"""Whether a figure shows something, and says of what and in which unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure


def check_figure(figure: Figure, name: str = "") -> None:
    """Hold a figure to showing data in every axes, with a quantity and a unit at every axis that has numbers."""
    figure.draw_without_rendering()
    assert figure.axes, f"{name}: no axes"
    for axes in figure.axes:
        where = f"{name}: axes {axes.get_title() or axes.get_title('left') or axes.get_ylabel()!r}"
        assert any(_shows(axes)) or not axes.axison, f"{where}: empty"
        for axis in (axes.xaxis, axes.yaxis) if axes.axison else ():
            numbers = _numbers(axis)
            assert not numbers or "[" in axis.get_label_text() or _shares_label(axes, axis), (
                f"{where}: {axis.axis_name} axis {numbers} without a unit, label {axis.get_label_text()!r}"
            )


def _shows(axes: Axes) -> Iterator[bool]:
    """Of everything in the axes, whether it has a place to be seen at."""
    yield from (bool(np.isfinite(np.asarray(line.get_xydata(), float)).all(axis=1).any()) for line in axes.lines)
    yield from (
        len(np.ravel(collection.get_offsets())) > 0 or bool(collection.get_paths()) for collection in axes.collections
    )
    yield from (patch.get_path().vertices.size > 0 for patch in axes.patches)
    yield from (image.get_size()[0] > 0 for image in axes.images)
    yield from (bool(text.get_text()) for text in axes.texts)


def _numbers(axis: Axis) -> list[str]:
    """The axis's tick labels where they are numbers; none where they are words or hidden."""
    ticks = [t.get_text() for t in axis.get_ticklabels() if t.get_visible() and t.get_text()]
    words = any(any(c.isalpha() for c in text.replace("mathdefault", "")) for text in ticks)
    return [] if words else ticks


def _shares_label(axes: Axes, axis: Axis) -> bool:
    """Whether the figure has one label for all axes in this direction, or the column or row one at its end, with a unit."""
    figure, place = axes.get_figure(root=True), axes.get_subplotspec()
    across = axis.axis_name == "x"
    if "[" in (figure.get_supxlabel() if across else figure.get_supylabel()):
        return True
    for other in figure.axes:
        there = other.get_subplotspec()
        if place is None or there is None:
            continue
        beside = there.colspan == place.colspan if across else there.rowspan == place.rowspan
        if beside and "[" in (other.get_xlabel() if across else other.get_ylabel()):
            return True
    return False
