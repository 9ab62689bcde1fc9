"""Figures of the errata study: the steps between the models, the three models over range, and the real limit at 20 m."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from experiments import chain
from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, new_figure
from experiments.reporting.formatting import number
from experiments.thesis.errata.study import ErrataResult, full_pixel_snr, limit_margins
from radiometry.corrections import CORRECTIONS
from radiometry.geometry import FloatArray

_ILLUMINATION_TEXT = {"eclipse": "eclipse, LEDs alone", "sunlit": "LEDs and Sun", "sun alone": "Sun alone"}
#: A step that changes neither signal nor SNR by this fraction is left out of a waterfall.
_VISIBLE = 1e-4


def steps_figure(result: ErrataResult, illumination: str, range_m: float) -> Any:
    """Signal and SNR at one range, step by step from the printed to the full model, on logarithmic axes."""
    case = result.dataset.sel(illumination=illumination, range_m=range_m)
    figure, axes = new_figure(1, 2, (8.6, 4.9), sharey=True, width_ratios=(1.25, 1.0))
    for axis, name, label in (
        (axes[0, 0], "signal", "signal [e⁻]"),
        (axes[0, 1], "snr", "SNR, from background on CNR [–]"),
    ):
        _steps_panel(axis, case, case[f"step_{name}"].values, case[f"{name}_factor"].values)
        axis.set_xlabel(label)
    axes[0, 0].invert_yaxis()
    well = chain.usable_well_electrons(result.scenario.sensor)
    axes[0, 0].axvline(well, color=VERMILION, ls="--", lw=1)
    axes[0, 0].annotate(
        "full well", (well, 1), xycoords=("data", "axes fraction"), ha="center", va="bottom", color=VERMILION
    )
    figure.suptitle(
        f"{_ILLUMINATION_TEXT[illumination]}, {result.plan.step_exposure[illumination]}, {range_m:g} m", fontsize=9
    )
    return figure


def _steps_panel(axis: Axes, case: xr.Dataset, values: FloatArray, factors: FloatArray) -> None:
    """A bar for each step that changes something, and a diamond for each of the three models."""
    changes = np.maximum(np.abs(case.signal_factor - 1), np.abs(case.snr_factor - 1)).values > _VISIBLE
    last, rows = len(changes) - 1, list[str]()
    models = {0: "as printed", len(CORRECTIONS): "corrected", last: "full model"}
    beside: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
    for k, value in enumerate(values):
        if changes[k] and k not in (0, last):
            ends, y = (values[k - 1], value), len(rows)
            axis.barh(y, ends[1] - ends[0], left=ends[0], height=0.62, color=BLUE if k <= len(CORRECTIONS) else GREEN)
            text = _factor(factors[k]) if abs(factors[k] - 1) > _VISIBLE else "–"
            axis.annotate(text, (max(ends), y), xytext=(4, 0), fontsize=8, **beside)
            axis.plot([value, value], [y, y + 1], color="0.6", lw=0.7, zorder=0)
            rows.append(str(case.step.values[k]))
        if k in models:
            axis.plot(value, len(rows), "D", color=BLACK, ms=5)
            axis.annotate(number(value), (value, len(rows)), xytext=(7, 0), weight="bold", **beside)
            rows.append(models[k])
    span = values.max() / values.min()
    axis.set(xscale="log", xlim=(values.min() / 3, values.max() * span**0.2))
    axis.grid(axis="y", visible=False)
    axis.set_yticks(range(len(rows)), rows)


def _factor(value: float) -> str:
    return f"×{number(value)}" if abs(value - 1) > 0.1 else f"×{value:.3f}"


def _plot(axis: Axes, case: xr.Dataset, values: xr.DataArray, label: str, colour: str, marker: str) -> None:
    """A curve over range, its markers filled where the pixel holds its charge and open where it does not."""
    held = case.full_well_fraction.values <= 1
    style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 4.5}
    axis.plot(case.range_m.values, values, lw=1, mfc="white", label=None if held.any() else label, **style)
    if held.any():
        axis.plot([], [], lw=1, label=label, **style)
        axis.plot(case.range_m.values[held], values.values[held], ls="", **style)


def _finish_snr(axis: Axes, title: str, full: float) -> None:
    axis.axhline(full, color="0.4", ls="--", lw=0.9)
    above: dict[str, Any] = {"xytext": (0, 2), "textcoords": "offset points", "ha": "right"}
    axis.annotate(
        f"full pixel, {full:.0f}", (1, full), xycoords=("axes fraction", "data"), fontsize=8, color="0.3", **above
    )
    axis.plot([], [], ls="", color="0.4", marker="o", mfc="white", label="open: the pixel overflows")
    axis.set(yscale="log", xlabel="range [m]", ylabel="SNR of a bright bit [–]", title=title, xticks=range(2, 21, 2))
    axis.figure.legend(loc="outside right upper", fontsize=8)


def eclipse_figure(result: ErrataResult) -> Any:
    """SNR over range in eclipse: the three models at the thesis's exposure, and the full one at its automatic exposure."""
    figure, axes = new_figure(size_in=(8.2, 4.0))
    axis, here = axes[0, 0], result.dataset.sel(illumination="eclipse")
    for model, exposure, label, colour, marker in (
        ("corrected", "1/30 s", "corrected, 1/30 s", BLUE, "s"),
        ("full", "1/30 s", "full, 1/30 s", GREEN, "^"),
        ("full", "auto", "full, automatic exposure", VERMILION, "o"),
        ("printed", "1/50 s, 8°", "as printed, 1/50 s, beam 8°", SKY, "v"),
        ("printed", "1/30 s", "as printed, 1/30 s", BLACK, "D"),
    ):
        case = here.sel(model=model, exposure=exposure)
        _plot(axis, case, case.snr, label, colour, marker)
    case = here.sel(model="full", exposure="auto")
    _plot(axis, case, case.cnr, "full, automatic exposure, CNR", ORANGE, "o")
    axis.axhline(2.0, color=BLACK, lw=0.8, ls="-.", label="2, which the thesis's 8 m implies")
    _finish_snr(axis, "Eclipse", full_pixel_snr(result.scenario))
    return figure


def sunlight_figure(result: ErrataResult) -> Any:
    """SNR over range at 1 ms in sunlight, with the LEDs on and without, in the three models."""
    figure, axes = new_figure(size_in=(8.2, 4.0))
    axis, here = axes[0, 0], result.dataset.sel(exposure="1 ms")
    for model, illumination, label, colour, marker in (
        ("corrected", "sunlit", "corrected, LEDs and Sun", BLUE, "s"),
        ("full", "sunlit", "full, LEDs and Sun", GREEN, "^"),
        ("corrected", "sun alone", "corrected, Sun alone", SKY, "s"),
        ("full", "sun alone", "full, Sun alone", ORANGE, "^"),
        ("printed", "sunlit", "as printed (LEDs and Sun)", BLACK, "D"),
    ):
        case = here.sel(model=model, illumination=illumination)
        _plot(axis, case, case.snr, label, colour, marker)
    case = here.sel(model="full", illumination="sun alone")
    _plot(axis, case, case.cnr, "full, Sun alone, CNR", VERMILION, "o")
    _finish_snr(axis, "Sunlight, 1 ms", full_pixel_snr(result.scenario))
    return figure


def limit_figure(result: ErrataResult) -> Any:
    """Pixels per bit over range, and the margin of each closure criterion of the full model in eclipse."""
    figure, axes = new_figure(1, 2, (8.6, 4.2))
    left, right = axes[0]
    dataset = result.dataset
    ranges = dataset.range_m.values
    for bit_mm, colour, marker in ((5.0, BLUE, "s"), (10.0, GREEN, "^"), (17.1, PURPLE, "D")):
        left.plot(ranges, dataset.px_per_bit * bit_mm / 5.0, color=colour, marker=marker, label=f"bit of {bit_mm:g} mm")
    left.axhline(2, color=VERMILION, ls="--", lw=1, label="2 px/bit, needed")
    left.axhline(3, color=VERMILION, ls=":", lw=1, label="3 px/bit, OpenCV's ArUco")
    left.set(yscale="log", ylabel="pixels per bit [px]", title="Sampling")
    left.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    left.minorticks_off()
    styles = zip((BLUE, ORANGE, GREEN, BLACK, PURPLE), "sovD^", strict=True)
    for (label, margin), (colour, marker) in zip(limit_margins(result).items(), styles, strict=True):
        right.plot(ranges, margin, color=colour, marker=marker, label=label)
    right.axhline(1, color=VERMILION, ls="--", lw=1, label="1, below it fails")
    right.set(yscale="log", ylabel="margin of the criterion [–]", title="Full model in eclipse, bit of 5 mm")
    for axis in (left, right):
        axis.set(xlabel="range [m]", xticks=range(2, 21, 3))
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)
    return figure
