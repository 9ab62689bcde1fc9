"""The figure of the comparison: median attitude error over tilt."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from experiments.reporting.figures import COLOURS, MARKERS, new_figure
from experiments.scenario import Scenario
from experiments.studies.shared.trackers import METHODS
from experiments.thesis.comparison.published import published

CAPTION = (
    "Median attitude error over tilt at equal outer size: rendered frames with noise (full lines), closed forms (dashed) and a "
    "published accuracy (dotted, its authors' camera and size)."
)


def tilt(dataset: xr.Dataset, scenario: Scenario) -> Figure:
    """One panel a range: every marker's median error over tilt."""
    plot, axes = new_figure(1, dataset.sizes["range_m"], (4.9 * dataset.sizes["range_m"], 4.6), sharey=True)
    fine = np.linspace(float(dataset.tilt_deg.min()), max(float(dataset.tilt_deg.max()), 1.0), 100)
    for axis, range_m in zip(axes[0], dataset.range_m.values, strict=True):
        at = dataset.sel(range_m=range_m)
        size = float(at.size_px)
        for k, method in enumerate(map(str, dataset.marker.values)):
            style = {"marker": MARKERS[k], "color": COLOURS[k], "label": METHODS[method][1]}
            axis.plot(at.tilt_deg, at.median_deg.sel(marker=method), **style)
        for k, other in enumerate(published()):
            style = {"ls": "--" if other.model else ":", "color": COLOURS[len(dataset.marker) + k], "label": other.name}
            axis.plot(fine, other.median_deg(fine, scenario, size), lw=1.2, **style)
        axis.set(xlabel="tilt about the marker's x axis [deg]", yscale="log", ylim=(1e-3, 300))
        axis.set_title(f"{size:.0f} px across ({range_m:g} m)")
    axes[0, 0].set_ylabel("median attitude error [deg]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    return plot
