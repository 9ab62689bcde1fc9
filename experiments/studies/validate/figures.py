"""The two figures of `mantis validate`: agreement of every cell, and the error budget over range."""

from __future__ import annotations

from typing import Any

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from experiments.reporting.figures import BLACK, COLOURS, MARKERS, new_figure
from experiments.studies.validate.cells import QUANTITIES
from experiments.studies.validate.study import COARSE_TOLERANCE, FINE_PX_PER_BIT, FINE_TOLERANCE

_TITLES = {"signal": "Signal S", "background": "Background B", "snr": "SNR", "cnr": "CNR"}
#: Differences are drawn linearly up to this, logarithmically beyond [%].
_LINEAR_PERCENT = 0.01


def agreement(dataset: xr.Dataset) -> Figure:
    """Rendered over closed form, less one, against pixels per bit: every cell, with the bands of the requirement."""
    figure, axes = new_figure(2, 2, (7.2, 5.6), sharex=True, sharey=True)
    figure.set_dpi(220)  # of the points, thousands of which would swell the file
    px_per_bit = dataset.px_per_bit.broadcast_like(dataset.signal_difference)
    low, high = 0.85 * float(px_per_bit.min()), 1.18 * float(px_per_bit.max())
    for axis, name in zip(axes.flat, QUANTITIES, strict=True):
        for low_px, high_px, tolerance in (
            (low, FINE_PX_PER_BIT, COARSE_TOLERANCE),
            (FINE_PX_PER_BIT, high, FINE_TOLERANCE),
        ):
            axis.fill_between([low_px, high_px], -100 * tolerance, 100 * tolerance, color=BLACK, alpha=0.07, lw=0)
        for k, illumination in enumerate(dataset.illumination.values):
            cells = {"illumination": illumination}
            x, y = px_per_bit.sel(cells).values.ravel(), 100 * dataset[f"{name}_difference"].sel(cells).values.ravel()
            axis.plot(
                x,
                y,
                MARKERS[k],
                ms=2.2,
                mew=0,
                color=COLOURS[k],
                alpha=0.7,
                rasterized=True,
                label=illumination.replace(" deg", "°"),
            )
        axis.axhline(0, color=BLACK, lw=0.6)
        axis.set_title(_TITLES[name])
        axis.set(xscale="log", xlim=(low, high), ylim=(-6, 6))
        axis.set_yscale("symlog", linthresh=_LINEAR_PERCENT)
        axis.yaxis.set_major_locator(FixedLocator([-3, -1, -0.1, -0.01, 0, 0.01, 0.1, 1, 3]))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:+g}" if y else "0"))
        axis.xaxis.set_major_locator(FixedLocator([0.5, 1, 2, 3, 5, 10, 20, 40]))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.minorticks_off()
    for axis in axes[-1]:
        axis.set_xlabel("pixels per bit [px]")
    for axis in axes[:, 0]:
        axis.set_ylabel("rendered / closed form − 1  [%]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, markerscale=2)
    return figure


def error_budget(dataset: xr.Dataset) -> Figure:
    """Size of every term over range: what the closed form includes, and what is left, for signal and background."""
    figure, axes = new_figure(1, 3, (10.2, 4.4), sharey=True, sharex=True)
    small, steep = float(dataset.size_m.min()), float(dataset.tilt_deg.max())
    where = {"size_m": small, "tilt_deg": steep, "illumination": dataset.illumination.values[-1]}
    cells = dataset.sel(where).isel(sensor=0)
    label = f"{small * 100:g} cm, {steep:g}° tilt, {str(where['illumination']).replace(' deg', '°')}"
    _lines(axes[0, 0], cells.effect_on_signal, "effect", {})
    axes[0, 0].set_title("Signal without this effect")
    for axis, quantity in zip(axes[0, 1:], ("signal", "background"), strict=True):
        _lines(axis, cells.remainder.sel(quantity=quantity), "source", {"monte_carlo": ":"})
        difference = abs(cells[f"{quantity}_difference"])
        axis.plot(cells.range_m, difference, "-", color=BLACK, lw=1.8, label="difference found")
        axis.plot(cells.range_m, cells.tolerance, "--", color=BLACK, lw=0.9, label="allowed")
        axis.set_title(f"{quantity.capitalize()}: what is left")
    for axis in axes[0]:
        axis.set(xlabel="range [m]", yscale="log", ylim=(1e-7, 5))
        axis.legend(fontsize=7, loc="lower right", frameon=True, framealpha=0.85)
    axes[0, 0].set_ylabel(f"relative change [–] ({label})")
    return figure


def _lines(axis: Axes, terms: xr.DataArray, dim: str, styles: dict[str, str]) -> None:
    for k, name in enumerate(terms[dim].values):
        size = abs(terms.sel({dim: name}))
        style: dict[str, Any] = {"marker": MARKERS[k], "color": COLOURS[k], "label": str(name).replace("_", " ")}
        axis.plot(terms.range_m, size.where(size > 0), styles.get(str(name), "-"), **style)
