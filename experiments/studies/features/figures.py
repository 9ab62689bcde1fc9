"""Figures of the study of features."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.chain.statistics import binomial_interval
from experiments.reporting.figures import BLACK, COLOURS, MARKERS, new_figure
from experiments.studies.features.detection import AT_PX_PER_BIT
from experiments.studies.features.tables import BIAS_PX, RATIO, ratios, rms_over_blobs


def _lines(axes: Axes, x: xr.DataArray, values: xr.DataArray, over: str, label: str, scale: float = 1.0) -> None:
    """One line for each coordinate of the dimension `over`."""
    for k, at in enumerate(values[over].values):
        line = scale * values.sel({over: at}).values
        axes.plot(x, line, color=COLOURS[k % 8], marker=MARKERS[k % 8], label=label.format(at))


def scatter_figure(data: xr.Dataset) -> Figure:
    """Ratios of scatter to bound."""
    figure, axes = new_figure(2, 2, (7.2, 5.4), sharex=True)
    for axis, (name, ratio) in zip(axes.ravel(), ratios(data).items(), strict=True):
        _lines(axis, data.range_m, ratio, "pitch_deg", "pitch {:g}°")
        axis.axhline(RATIO, color=BLACK, linestyle="--", linewidth=0.8)
        axis.set(title=name, ylabel="scatter / bound [–]", yscale="log")
        _plain_ticks(axis, (0.5, 1, 1.5, 2, 3, 5, 10, 20), ratio.values)
    for axis in axes[1]:
        axis.set_xlabel("range [m]")
    axes[0, 0].legend(fontsize=7)
    return figure


def _plain_ticks(axis: Axes, ticks: tuple[float, ...], values: np.ndarray) -> None:
    low, high = min(0.7, float(np.nanmin(values))), max(2.2, float(np.nanmax(values)))
    axis.set_ylim(0.9 * low, 1.15 * high)
    axis.set_yticks([t for t in ticks if 0.9 * low <= t <= 1.15 * high])
    axis.get_yaxis().set_major_formatter("{x:g}")
    axis.minorticks_off()


def bias_figure(data: xr.Dataset) -> Figure:
    """Biases of corners and blobs."""
    figure, axes = new_figure(1, 2, (7.2, 3.2), sharey=True)
    worst = abs(data.blob_bias_px).max("element")
    for axis, (name, bias) in zip(
        axes[0], {"worst corner": data.corner_bias_px, "worst blob": worst}.items(), strict=True
    ):
        _lines(axis, data.pitch_deg, bias, "range_m", "{:g} m")
        axis.axhline(BIAS_PX, color=BLACK, linestyle="--", linewidth=0.8)
        axis.set(title=name, xlabel="pitch [°]")
    axes[0, 0].set_ylabel("mean error [px]")
    axes[0, 0].set_ylim(0, None)
    axes[0, 0].legend(fontsize=7, title="range", ncols=2, loc="upper left", bbox_to_anchor=(0, 0.9))
    return figure


def bound_figure(data: xr.Dataset) -> Figure:
    """Bounds and scatter themselves."""
    blob_bound = rms_over_blobs(data.blob_bound_px.where(data.blob_scatter_px.notnull()))
    panels = {
        "corner's coordinate [px]": (data.corner_bound_px, data.corner_scatter_px, 1.0),
        "blob [px]": (blob_bound, rms_over_blobs(data.blob_scatter_px), 1.0),
        "attitude [°]": (data.attitude_bound_deg, data.attitude_scatter_deg, 1.0),
        "range [mm]": (data.range_bound_m, data.range_scatter_m, 1e3),
    }
    figure, axes = new_figure(2, 2, (7.2, 5.4), sharex=True)
    for axis, (name, (bound, scatter, scale)) in zip(axes.ravel(), panels.items(), strict=True):
        for k, pitch in enumerate(data.pitch_deg.values):
            colour = COLOURS[k % 8]
            axis.plot(data.range_m, scale * bound.sel(pitch_deg=pitch), color=colour, label=f"pitch {pitch:g}°")
            measured = scale * scatter.sel(pitch_deg=pitch)
            axis.plot(data.range_m, measured, color=colour, marker=MARKERS[k % 8], linestyle="none")
        axis.set(ylabel=name, yscale="log")
    for axis in axes[1]:
        axis.set_xlabel("range [m]")
    axes[0, 0].legend(fontsize=7)
    return figure


def detection_figure(found: xr.Dataset) -> Figure:
    """Detection rates against size and contrast."""
    figure, axes = new_figure(1, 2, (7.6, 3.6), sharey=True)
    k = 0
    for family in found.family.values:
        for detector in found.detector.values:
            counts = found.sel(family=family, detector=detector)
            if counts.found_by_size.isnull().all():
                continue
            for axis, name, along in zip(axes[0], ("size", "cnr"), ("px_per_bit", "cnr"), strict=True):
                values, frames = counts[f"found_by_{name}"].values, found[f"frames_by_{name}"].values
                low, high = binomial_interval(values, frames)
                rate = values / frames
                axis.errorbar(
                    found[along],
                    100 * rate,
                    100 * np.maximum([rate - low, high - rate], 0.0),
                    color=COLOURS[k % 8],
                    marker=MARKERS[k % 8],
                    capsize=2,
                    linewidth=1.0,
                    label=f"{detector}, {family}",
                )
            k += 1
    axes[0, 0].set(xlabel="pixels per bit [px]", ylabel="found [%]")
    axes[0, 1].set(xlabel=f"contrast-to-noise ratio at {found.attrs['px_per_bit_of_cnr']:g} px/bit [–]", xscale="log")
    ticks = [float(c) for c in found.cnr.values]
    axes[0, 1].set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes[0, 1].minorticks_off()
    axes[0, 0].axvline(AT_PX_PER_BIT, color=BLACK, linestyle="--", linewidth=0.8)
    axes[0, 0].legend(fontsize=7, loc="lower right")
    return figure
