"""Figures of the closure search: front, what binds over range, exposures, tornado, probability, and the rendered confirmation."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from experiments.reporting.figures import BLACK, BLUE, COLOURS, GREEN, MARKERS, ORANGE, PURPLE, VERMILION, new_figure
from experiments.studies.close.search import margins, operate, sets_of
from experiments.studies.close.sensitivity import FIXED, FOLLOWING, Bar
from experiments.studies.close.study import ClosureResult

_SIZE_IN = (5.2, 4.0)
_LIFE = {"worn": "end of life", "new": "new"}


def _log_axis(axis: Any) -> None:
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _range_axis(axes: Axes) -> None:
    axes.set_xlabel("range [m]")
    axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10]))


def front(result: ClosureResult) -> Figure:
    """Mean power against marker size; colour is focal length, a ring marks the front, numbers the proposed sets."""
    figure, grid = new_figure(size_in=_SIZE_IN)
    axes: Axes = grid[0, 0]
    cloud = result.found.closing
    shown = axes.scatter(
        [100 * p.size_m for p in cloud],
        [1e3 * p.power_w for p in cloud],
        c=[1e3 * p.focal_length_m for p in cloud],
        cmap="viridis",
        s=14,
        linewidths=0,
        label="closes",
    )
    axes.scatter(
        [100 * p.size_m for p in result.found.front],
        [1e3 * p.power_w for p in result.found.front],
        s=46,
        facecolors="none",
        edgecolors=BLACK,
        linewidths=0.9,
        label="Pareto front",
    )
    for p in result.proposed:
        axes.annotate(
            f"{1e3 * p.focal_length_m:.4g} mm F/{p.f_number:.3g}",
            (100 * p.size_m, 1e3 * p.power_w),
            xytext=(-7, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=8,
        )
    axes.set_yscale("log")
    _log_axis(axes.yaxis)
    low, high = axes.get_xlim()
    axes.set_xlim(low - 0.3 * (high - low), high)
    axes.set_ylim(0.8 * axes.get_ylim()[0], None)  # room for the labels
    axes.set_xlabel("marker's side [cm]")
    axes.set_ylabel(f"mean power at {result.constraints.frame_rate_hz(result.base):g} frames/s [mW]")
    figure.colorbar(shown, ax=axes, label="focal length [mm]")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def binding(result: ClosureResult) -> Figure:
    """Margin of every criterion against range, the worst light of each."""
    figure, grid = new_figure(size_in=_SIZE_IN)
    axes: Axes = grid[0, 0]
    assert result.recommended is not None
    sets = sets_of(result.form, result.recommended)
    found = margins(result.form, sets, result.constraints, operate(result.form, sets, result.constraints))
    ranges = result.form.ranges_m
    for i, (name, margin) in enumerate(found.items()):
        least = np.broadcast_to(margin, (1, *margin.shape[1:]))[0].min(axis=0)
        style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
        axes.plot(ranges, np.clip(least, None, 1000), label=name, linestyle="--" if i >= len(COLOURS) else "-", **style)
    axes.axhline(1.0, color=BLACK, linewidth=1.6)
    axes.set_yscale("log")
    _log_axis(axes.yaxis)
    axes.set_ylim(0.8, 1000)
    _range_axis(axes)
    axes.set_ylabel("margin: factor by which it is met [–]")
    figure.legend(loc="outside lower center", ncols=5, fontsize=8)
    return figure


def exposures(result: ClosureResult) -> Figure:
    """Pulse against range, eclipse and brightest Sun, new and worn."""
    figure, grid = new_figure(size_in=_SIZE_IN)
    axes: Axes = grid[0, 0]
    styles = {
        ("eclipse", "worn"): (BLUE, "o", "-"),
        ("sunlit", "worn"): (VERMILION, "s", "-"),
        ("eclipse", "new"): (BLUE, "^", "--"),
        ("sunlit", "new"): (VERMILION, "D", "--"),
    }
    for (illumination, life), (colour, marker, dash) in styles.items():
        mine = [e for e in result.schedule if (e.illumination, e.life) == (illumination, life)]
        if mine:
            name = "eclipse" if illumination == "eclipse" else "brightest Sun"
            axes.plot(
                [e.range_m for e in mine],
                [1e6 * e.pulse_s for e in mine],
                color=colour,
                marker=marker,
                linestyle=dash,
                label=f"{name}, {_LIFE[life]}",
            )
    axes.set_yscale("log")
    _log_axis(axes.yaxis)
    _range_axis(axes)
    axes.set_ylabel("pulse [µs]")
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def tornado_figure(result: ClosureResult) -> Figure:
    """Two panels: the exposure follows the light, and the exposures that were set beforehand."""
    assert result.tornado is not None
    tornado = result.tornado
    figure, grid = new_figure(1, 2, size_in=(7.4, 4.2), sharey=True)

    def panel(axes: Axes, nominal: float, ends: Any, title: str, criteria: tuple[str, ...]) -> None:
        for i, bar in enumerate(tornado.bars):
            for end, colour, label in zip(ends(bar), (BLUE, ORANGE), ("low end", "high end"), strict=True):
                axes.barh(i, end - nominal, left=nominal, height=0.62, color=colour, label=label if i == 0 else None)
        axes.axvline(1.0, color=VERMILION, linewidth=1.6, linestyle="--", label="fails left of this")
        axes.axvline(nominal, color=BLACK, linewidth=0.8)
        axes.set_xscale("log")
        axes.set_title(title, loc="left", fontweight="bold")
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0.8), max(high, 1.25 * nominal))
        axes.xaxis.set_major_locator(FixedLocator([0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5]))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set_xlabel(f"smallest margin [–] of\n{', '.join(criteria)}")

    panel(grid[0, 0], tornado.following, lambda b: b.following, "Exposure follows the light", FOLLOWING)
    panel(grid[0, 1], tornado.fixed, lambda b: b.fixed, "Exposures set beforehand", FIXED)
    names = [_bar_label(bar) for bar in tornado.bars]
    grid[0, 0].set_yticks(range(len(names)), names)
    grid[0, 0].invert_yaxis()
    for axes in grid[0]:
        axes.grid(False, axis="y")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)
    return figure


def _bar_label(bar: Bar) -> str:
    return f"{bar.name}, ×{bar.low:.3g} to ×{bar.high:.3g}"


def probability_figure(result: ClosureResult) -> Figure:
    """Share of drawn worlds that close at each range, for either exposure: the recommended set, and the best hardware's."""
    figure, grid = new_figure(size_in=_SIZE_IN)
    axes: Axes = grid[0, 0]
    best = result.best.name if result.best else ""
    own = [p for p in result.probabilities if p.label not in {a.name for a in result.alternatives}]
    for i, p in enumerate([*own, *(p for p in result.probabilities if p.label == best)]):
        for shares, dash, how in (
            (p.by_range[0], "-", "exposure follows"),
            (p.by_range[1], ":", "exposure set beforehand"),
        ):
            axes.plot(
                result.form.ranges_m,
                100 * shares,
                linestyle=dash,
                color=COLOURS[i % len(COLOURS)],
                marker=MARKERS[i % len(MARKERS)],
                label=f"{p.label}, {how}",
            )
    axes.set_ylim(0, 103)
    _range_axis(axes)
    axes.set_ylabel("worlds in which the range closes [%]")
    figure.legend(loc="outside lower center", ncols=1, fontsize=8)
    return figure


def confirmation(result: ClosureResult) -> Figure:
    """CNR and attitude error of the rendered frames of the recommended set, by view and light."""
    assert result.recommended is not None
    figure, grid = new_figure(1, 2, size_in=(7.4, 3.9))
    mine = [r for r in result.records if r["set"] == result.recommended.label]
    limits = result.base.requirement
    for axes, key, label, limit in (
        (grid[0, 0], "cnr_rendered", "CNR of a bit [–]", limits.cnr_min),
        (grid[0, 1], "attitude_error_p95_deg", "attitude error, 95th percentile [°]", limits.attitude_error_max_deg),
    ):
        for i, view in enumerate(result.constraints.confirm.views):
            where = (view.pitch_deg, view.yaw_deg, view.phase_deg)
            for illumination, fill in (("eclipse", "full"), ("sunlit", "none")):
                here = [
                    r
                    for r in mine
                    if r["illumination"] == illumination and (r["pitch_deg"], r["yaw_deg"], r["phase_deg"]) == where
                ]
                axes.plot(
                    [r["range_m"] for r in here],
                    [r[key] for r in here],
                    linestyle="",
                    marker=MARKERS[i],
                    color=(BLUE, GREEN, PURPLE)[i % 3],
                    fillstyle=fill,
                    label=f"{view.label if illumination == 'sunlit' else view.label.rsplit(',', 1)[0]}, {illumination}",
                )
        if key == "cnr_rendered":
            frontal = [r for r in mine if (r["pitch_deg"], r["yaw_deg"], r["illumination"]) == (0, 0, "eclipse")]
            axes.plot(
                [r["range_m"] for r in frontal], [r["cnr_analytic"] for r in frontal], color=BLACK, label="closed form"
            )
        axes.axhline(limit, color=ORANGE, linestyle="--", label="limit")
        axes.set_yscale("log")
        _log_axis(axes.yaxis)
        _range_axis(axes)
        axes.set_ylabel(label)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    return figure
