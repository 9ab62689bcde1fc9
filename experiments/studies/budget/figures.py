"""Figures of a budget, one panel each so that a page can set them side by side or one below the other."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from experiments import chain
from experiments.chain.statistics import binomial_interval
from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, new_figure
from experiments.reporting.formatting import ILLUMINATION_NAMES, number
from experiments.studies.budget.advice import exposure_windows
from experiments.studies.budget.study import BudgetResult, shown_exposure
from radiometry import link

#: OpenCV's ArUco decodes from about this many pixels per bit on (`closure.Requirement`).
OPENCV_PX_PER_BIT = 3.0
_SIZE_IN = (4.9, 3.9)
_STYLE = {"eclipse": (BLUE, "o", -1), "sunlit": (VERMILION, "s", 1)}


def snr_panels(result: BudgetResult) -> list[Figure]:
    """SNR against range, one panel an illumination: closed form, rendered, and the most that a full pixel gives."""
    sensor = result.scenario.sensor
    figures = []
    for illumination in result.scenario.budget.illuminations:
        figure, axes = _panel(
            result, f"Signal-to-noise ratio in {ILLUMINATION_NAMES[illumination]}", "SNR of a bright bit [–]"
        )
        _lines(axes, result, illumination, "snr")
        full = link.snr(chain.usable_well_electrons(sensor), 0.0, sensor.total_noise_electrons)
        axes.axhline(float(full), color="0.45", linestyle=":", label=f"full pixel, {number(float(full))}")
        figures.append(_finish(figure))
    return _same_scale(figures)


def cnr_panels(result: BudgetResult) -> list[Figure]:
    """CNR against range, one panel an illumination: closed form, rendered, limit."""
    figures = []
    for illumination in result.scenario.budget.illuminations:
        figure, axes = _panel(
            result, f"Contrast-to-noise ratio in {ILLUMINATION_NAMES[illumination]}", "CNR of a bit [–]"
        )
        _lines(axes, result, illumination, "cnr")
        _limit(axes, result.scenario.requirement.cnr_min, "needed")
        figures.append(_finish(figure))
    return _same_scale(figures)


def difference_panels(result: BudgetResult) -> list[Figure]:
    """Rendered over closed form, less one, at the shown exposure: signal before noise, SNR and CNR with 95 % intervals."""
    ranges = result.dataset.range_m.values
    step = float(np.diff(ranges).min()) if len(ranges) > 1 else 1.0
    figures = []
    for illumination in result.scenario.budget.illuminations:
        case = result.dataset.sel(illumination=illumination).isel(exposure=shown_exposure(result.scenario))
        figure, axes = _panel(
            result,
            f"Rendered against closed form in {ILLUMINATION_NAMES[illumination]}",
            "rendered / closed form − 1 [%]",
            log=False,
        )
        axes.axhline(0.0, color="0.45", linewidth=0.8)
        axes.plot(
            ranges, 100 * (case.signal_expected / case.signal_analytic - 1), color=GREEN, label="signal, before noise"
        )
        for name, colour, marker, side in (("snr", BLUE, "o", -1), ("cnr", VERMILION, "s", 1)):
            ratio = case[f"{name}_rendered"] / case[f"{name}_analytic"]
            half = case[f"{name}_rendered_ci95"] / case[f"{name}_analytic"]
            axes.errorbar(
                ranges + 0.12 * side * step,
                100 * (ratio - 1),
                100 * half,
                fmt=marker,
                color=colour,
                elinewidth=0.9,
                label=name.upper(),
            )
        figures.append(_finish(figure, columns=3))
    return _same_scale(figures)


def saturation_panels(result: BudgetResult) -> list[Figure]:
    """Bright bits over full well against range at every exposure, one panel an illumination."""
    figures = []
    for illumination in result.scenario.budget.illuminations:
        figure, axes = _panel(result, f"Saturation in {ILLUMINATION_NAMES[illumination]}", "bright bit / full well [–]")
        for case, label, style in _exposures(result, illumination):
            axes.plot(case.range_m, case.full_well_fraction, label=label, **style)
        _limit(axes, result.scenario.requirement.full_well_fraction_max, "allowed")
        figures.append(_finish(figure))
    return _same_scale(figures)


def exposure_panels(result: BudgetResult) -> list[Figure]:
    """Exposures that meet CNR, saturation and smear against range, in closed form, one panel an illumination."""
    windows = exposure_windows(result.dataset, result.scenario)
    figures = []
    for illumination in result.scenario.budget.illuminations:
        figure, axes = _panel(result, f"Usable exposures in {ILLUMINATION_NAMES[illumination]}", "exposure [s]")
        window, ranges = windows.sel(illumination=illumination), windows.range_m.values
        ceiling = np.minimum(window.saturation, window.smear).values
        axes.fill_between(
            ranges,
            window.cnr,
            ceiling,
            where=(ceiling >= window.cnr).values,
            color=SKY,
            alpha=0.35,
            label="usable",
            linewidth=0,
        )
        for name, text, colour, dash in (
            ("smear", "longest by smear", PURPLE, "-."),
            ("saturation", "longest by saturation", VERMILION, "-"),
            ("cnr", "shortest by CNR", BLUE, "-"),
        ):
            axes.plot(ranges, window[name], dash, color=colour, label=text, marker="." if len(ranges) == 1 else "")
        fixed = ["s", "D", "^", "v"]
        for case, label, style in _exposures(result, illumination):
            marker = "o" if style["color"] == BLUE else fixed[0]
            fixed = fixed if style["color"] == BLUE else fixed[1:] + fixed[:1]
            axes.plot(case.range_m, case.exposure_s, marker, color=BLACK, markersize=3, fillstyle="none", label=label)
        figures.append(_finish(figure))
    return _same_scale(figures)


def sampling_panel(result: BudgetResult) -> Figure:
    """Pixels per bit against range with the limits."""
    figure, axes = _panel(result, "Sampling", "pixels along a bit's shorter side [px]", plain_ticks=True)
    axes.plot(result.dataset.range_m, result.dataset.px_per_bit, "o-", color=BLUE, label="pixels per bit")
    needed = result.scenario.requirement.px_per_bit_min
    _limit(axes, needed, "needed")
    if needed != OPENCV_PX_PER_BIT:
        axes.axhline(OPENCV_PX_PER_BIT, color=ORANGE, linestyle="-.", label=f"OpenCV decodes: {OPENCV_PX_PER_BIT:g}")
    return _finish(figure)


def detection_panel(result: BudgetResult) -> Figure:
    """Share of frames in which the marker is found, with its exact 95 % interval."""
    figure, axes = _panel(result, "Detection", "frames with the marker found [%]", log=False)
    trials = result.scenario.budget.trials
    for case, colour, marker, shift in _illuminations(result):
        share = case.detected_fraction.values
        low, high = binomial_interval(np.rint(np.nan_to_num(share) * trials), trials)
        axes.errorbar(
            case.range_m + shift,
            100 * share,
            100 * np.array([share - low, high - share]),
            fmt=marker,
            color=colour,
            elinewidth=0.8,
            label=f"{ILLUMINATION_NAMES[str(case.illumination.values)]}, {trials} frames a point",
        )
    _limit(axes, 100 * result.scenario.requirement.detection_min, "needed", " %")
    axes.set_ylim(-3, 103)
    return _finish(figure)


def attitude_panel(result: BudgetResult) -> Figure:
    """95th percentile of the attitude error of the frames in which a pose was found."""
    figure, axes = _panel(result, "Attitude", "attitude error, 95th percentile [°]", plain_ticks=True)
    for case, colour, marker, shift in _illuminations(result):
        axes.plot(
            case.range_m + shift,
            case.attitude_error_p95_deg,
            marker,
            color=colour,
            label=ILLUMINATION_NAMES[str(case.illumination.values)],
        )
    _limit(axes, result.scenario.requirement.attitude_error_max_deg, "allowed", "°")
    return _finish(figure)


def _panel(
    result: BudgetResult, title: str, y_label: str, *, log: bool = True, plain_ticks: bool = False
) -> tuple[Figure, Axes]:
    figure, grid = new_figure(size_in=_SIZE_IN)
    axes = grid[0, 0]
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_xlabel("range [m]")
    ranges = result.dataset.range_m.values
    pad = 0.05 * (ranges[-1] - ranges[0]) or 0.5
    axes.set_xlim(ranges[0] - pad, ranges[-1] + pad)
    axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10]))
    axes.set_ylabel(y_label)
    if log:
        axes.set_yscale("log")
    if plain_ticks:
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    return figure, axes


def _finish(figure: Figure, columns: int = 2) -> Figure:
    """Put the legend below the axes, where it covers no data."""
    figure.legend(loc="outside lower center", ncols=columns, fontsize=8)
    return figure


def _same_scale(figures: list[Figure]) -> list[Figure]:
    """Give panels that are read side by side one vertical scale."""
    axes = [figure.axes[0] for figure in figures]
    limits = [a.get_ylim() for a in axes]
    for a in axes:
        a.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    return figures


def _limit(axes: Axes, value: float, word: str, unit: str = "") -> None:
    axes.axhline(value, color=ORANGE, linestyle="--", linewidth=1.6, label=f"{word}: {value:g}{unit}")


def _exposures(result: BudgetResult, illumination: str) -> Iterable[tuple[xr.Dataset, str, dict[str, Any]]]:
    """Each exposure's results, name and style; the shown one first, in blue."""
    shown, others = shown_exposure(result.scenario), [GREEN, PURPLE, VERMILION, "0.5"]
    for i in sorted(range(result.dataset.sizes["exposure"]), key=lambda i: i != shown):
        case = result.dataset.sel(illumination=illumination).isel(exposure=i)
        colour = BLUE if i == shown else others[(i if i < shown else i - 1) % len(others)]
        yield case, str(case.exposure.values), {"color": colour, "marker": "." if len(case.range_m) == 1 else ""}


def _illuminations(result: BudgetResult) -> Iterable[tuple[xr.Dataset, str, str, float]]:
    """Shown results of each illumination, with colour, marker and a small shift in range that keeps both visible."""
    ranges = result.dataset.range_m.values
    step = float(np.diff(ranges).min()) if len(ranges) > 1 else 1.0
    for illumination in result.scenario.budget.illuminations:
        colour, marker, side = _STYLE[illumination]
        case = result.dataset.sel(illumination=illumination).isel(exposure=shown_exposure(result.scenario))
        yield case, colour, marker, 0.12 * side * step


def _lines(axes: Axes, result: BudgetResult, illumination: str, name: str) -> None:
    """Closed form as lines, rendered frames as points with 95 % intervals, at every exposure."""
    for case, label, style in _exposures(result, illumination):
        saturated = bool(case[f"{name}_rendered"].isnull().all())
        note = " (saturated)" if saturated else ""
        axes.plot(case.range_m, case[f"{name}_analytic"], label=f"closed form, {label}{note}", **style)
        if not saturated:
            colour = VERMILION if style["color"] == BLUE else style["color"]
            axes.errorbar(
                case.range_m,
                case[f"{name}_rendered"],
                case[f"{name}_rendered_ci95"],
                fmt="o",
                color=colour,
                elinewidth=0.9,
                capsize=1.5,
                label=f"rendered, {label}",
            )
