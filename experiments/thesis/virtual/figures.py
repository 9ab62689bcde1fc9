"""Figures of the virtual experiment, in the thesis's axes: error of pitch and of range over true pitch, and detection."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure as Plot
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, new_figure
from experiments.thesis.virtual.summary import PITCH_TARGET_DEG, find, method_title, rolling, title

CAPTIONS = {
    "3.3m": "Errors and detection at 3.3 m: left against ArUco as in the thesis's figures 8.2 and 8.3, right against the others.",
    "2.3m": "Errors and detection at 2.3 m: left against ArUco as in figures 8.4 and 8.5, right against the others.",
    "1.3m": "Errors and detection at 1.3 m, improved ring: left against ArUco as in figures 8.7 and 8.8, right against the "
    "others.",
    "2.3m-both": "Errors and detection at 2.3 m, pitch and yaw alike: left against ArUco as in figures 8.9 and 8.10, right "
    "against the others.",
    "overview": "Rms pitch error of every series, over all frames and near frontal; dotted: the targets for Mantis.",
    "bound": "Mantis's errors, improved ring, beside twice the Cramér–Rao bound of each range.",
    "misplaced": "The left element a millimetre off its place: with the design believed, and with the element calibrated.",
}
COLOURS = {
    "mantis": BLUE,
    "thesis": VERMILION,
    "aruco": GREEN,
    "aruco_opencv": SKY,
    "aruco_thesis": ORANGE,
    "apriltag": PURPLE,
    "svms": BLACK,
}
#: Figures by name: range, rotation, the thesis's figures, and the Mantis Marker that it shows there.
CONDITIONS = {
    "3.3m": (3.3, "pitch", "8.2 and 8.3", "mantis"),
    "2.3m": (2.3, "pitch", "8.4 and 8.5", "mantis"),
    "1.3m": (1.3, "pitch", "8.7 and 8.8", "improved"),
    "2.3m-both": (2.3, "both", "8.9 and 8.10", "mantis"),
}
#: Linear up to this, logarithmic beyond: pitch [deg] and range [mm].
_LINEAR = {"pitch": 0.5, "range": 10.0}
_TICKS = {"pitch": (0.25, 1, 10, 90), "range": (5, 30, 100, 1000)}
_LIMIT = {"pitch": 180.0, "range": 3000.0}
_DOTS: dict[str, Any] = {"ls": "none", "marker": ".", "mew": 0, "rasterized": True}


def condition(dataset: xr.Dataset, name: str) -> Plot | None:
    """Errors and detection over true pitch of everything at one range; None where no Mantis was run there."""
    range_m, rotation, figures, main = CONDITIONS[name]

    def series(method: str, target: str) -> xr.Dataset | None:
        return find(dataset, method, target=target, range_m=range_m, rotation=rotation)

    left = [series(m, "aruco") for m in ("aruco_thesis", "aruco_opencv", "aruco")] + [series("mantis", main)]
    right = [series("thesis", main), series("apriltag", "apriltag"), series("svms", "svms"), series("mantis", main)]
    if left[-1] is None:
        return None
    plot, axes = new_figure(3, 2, (7.6, 6.6), sharex=True, sharey="row", gridspec_kw={"height_ratios": [1.3, 1.3, 0.7]})
    for column, shown in zip(axes.T, (left, right), strict=True):
        for here in shown:
            if here is not None:
                _draw(column, here)
        column[0].legend(
            loc="upper center", bbox_to_anchor=(0.5, 1.32), ncols=2, fontsize=7, markerscale=2.5, columnspacing=1
        )
        column[2].set_xlabel("true pitch [°]" + (", yaw the same" if rotation == "both" else ""))
    for row, label in zip(axes[:, 0], ("pitch error [°]", "range error [mm]", "found [%]"), strict=True):
        row.set_ylabel(label)
    _scale(axes[0, 0], "pitch")
    _scale(axes[1, 0], "range")
    axes[2, 0].set_ylim(-5, 105)
    told = "in brackets: tests of table 8.1; scales linear near zero, logarithmic beyond"
    plot.suptitle(f"{range_m:g} m (thesis figures {figures}); {told}", fontsize=8)
    return plot


def _draw(column: Any, here: xr.Dataset) -> None:
    method = str(here.method.values)
    label = (
        ("Mantis, wide ring" if here.target == "improved" else "Mantis") if method == "mantis" else method_title(method)
    )
    if int(here.test):
        label += f" ({int(here.test)})"
    angle = here.pitch_deg.values
    shown = np.isfinite(angle)
    colour = COLOURS[method]
    size = _dot_size(int(shown.sum()))
    column[0].plot(angle, here.pitch_error_deg, color=colour, label=label, ms=size, **_DOTS)
    column[1].plot(angle, 1e3 * here.range_error_m, color=colour, ms=size, **_DOTS)
    found = rolling(here.found.values[shown], angle[shown])
    column[2].plot(angle[shown], 100 * found, color=colour, lw=1.2)


def _dot_size(count: int) -> float:
    """Diameter of dots that do not run into each other, however many there are [pt]."""
    return float(np.clip(90 / np.sqrt(count), 3, 7))


def _scale(axis: Any, key: str) -> None:
    """Linear near zero, logarithmic beyond, ticks as plain numbers."""
    axis.set_yscale("symlog", linthresh=_LINEAR[key], linscale=1.0)
    ticks = [s * t for t in _TICKS[key] for s in (-1, 1)]
    axis.yaxis.set_major_locator(FixedLocator([0, *ticks]))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}".replace("-", "−")))
    axis.set_ylim(-_LIMIT[key], _LIMIT[key])


def overview(summary: xr.Dataset) -> Plot:
    """Rms pitch error, overall and near frontal, of every series, with the targets."""
    plot, axes = new_figure(1, 2, (7.6, 4.4), sharey=True)
    groups = [name for name in CONDITIONS if (summary.range_m == CONDITIONS[name][0]).any()]
    marks = {"pitch_rms_deg": "all frames", "pitch_frontal_rms_deg": "within 10° of frontal"}
    for axis, (statistic, heading) in zip(axes[0], marks.items(), strict=True):
        for place, name in enumerate(groups):
            range_m, rotation, _, _ = CONDITIONS[name]
            at = np.flatnonzero((summary.range_m.values == range_m) & (summary.rotation.values == rotation))
            for s in at:
                here = summary.isel(series=int(s))
                method, target = str(here.method.values), str(here.target.values)
                beside = target in ("misplaced", "calibrated") or (target == "improved" and method != "mantis")
                if beside or method not in COLOURS:
                    continue
                wide = target == "improved"
                shift = 0.11 * (list(COLOURS).index(method) - 3) + (0.05 if method != "mantis" else 0.0)
                x, inside = place + shift + (0.08 if wide else 0), "white" if wide else COLOURS[method]
                axis.semilogy(x, float(here[statistic]), "o", color=COLOURS[method], mfc=inside, ms=5)
            if rotation == "pitch":
                limit = PITCH_TARGET_DEG[range_m]
                axis.hlines(limit, place - 0.4, place + 0.5, color=BLACK, lw=0.8, ls=":")
        axis.set_xticks(range(len(groups)), [_group(name) for name in groups])
        axis.set_title(heading)
    axes[0, 0].set_ylabel("rms pitch error [°]")
    keys = [("Mantis", BLUE, BLUE), ("Mantis, wide ring", BLUE, "white")]
    keys += [(method_title(m), c, c) for m, c in COLOURS.items() if m != "mantis"]
    handles = [axes[0, 0].plot([], [], "o", color=c, mfc=f, label=label)[0] for label, c, f in keys]
    handles.append(axes[0, 0].plot([], [], ":", color=BLACK, lw=0.8, label="target for Mantis")[0])
    plot.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=7.5)
    return plot


def _group(name: str) -> str:
    range_m, rotation, _, _ = CONDITIONS[name]
    return f"{range_m:g} m" + (",\npitch and yaw" if rotation == "both" else "")


def misplaced(dataset: xr.Dataset) -> Plot | None:
    """Pitch error with an element off its place, unknown and calibrated; None where it was not run."""
    shown = [
        ("thesis", "misplaced", VERMILION, "thesis's pipeline"),
        ("mantis", "misplaced", SKY, "Mantis, as designed"),
        ("mantis", "calibrated", BLUE, "Mantis, calibrated"),
    ]
    series = [(find(dataset, method, target=target), colour, label) for method, target, colour, label in shown]
    if any(here is None for here, _, _ in series):
        return None
    plot, axes = new_figure(1, 2, (7.6, 3.0))
    for here, colour, label in series:
        assert here is not None
        for axis in axes[0]:
            axis.plot(here.pitch_deg, here.pitch_error_deg, color=colour, label=label, ms=5, **_DOTS)
    axes[0, 0].set_ylim(-15, 15)
    axes[0, 1].set_ylim(-0.5, 0.5)
    axes[0, 0].set_ylabel("pitch error [°]")
    for axis in axes[0]:
        axis.set_xlabel("true pitch [°]")
    axes[0, 0].legend(fontsize=7.5, markerscale=2)
    plot.suptitle("left element 1 mm off its place, 1.3 m (thesis figure 8.7)", fontsize=9)
    return plot


def against_bound(dataset: xr.Dataset, bounds: xr.Dataset) -> Plot | None:
    """Mantis's pitch and range errors at the three ranges with twice the Cramér–Rao bound; None where no bound was taken."""
    shown = [
        (r, here)
        for r in bounds.range_m.values
        if (here := find(dataset, "mantis", target="improved", range_m=float(r), rotation="pitch")) is not None
    ]
    if not shown:
        return None
    plot, axes = new_figure(2, len(shown), (7.6, 4.4), sharex=True, sharey="row")
    for column, (range_m, here) in zip(axes.T, shown, strict=True):
        limit = bounds.sel(range_m=range_m)
        for axis, error, name in zip(
            column, (here.pitch_error_deg, 1e3 * here.range_error_m), ("pitch_bound_deg", "range_bound_m"), strict=True
        ):
            twice = 2 * limit[name].values * (1e3 if name == "range_bound_m" else 1)
            size = _dot_size(int(np.isfinite(here.pitch_deg).sum()))
            axis.plot(here.pitch_deg, error, color=BLUE, label="Mantis", ms=size, **_DOTS)
            for sign in (-1, 1):
                axis.plot(
                    bounds.pitch_deg, sign * twice, color=VERMILION, lw=1, label="± 2 bounds" if sign > 0 else None
                )
        column[0].set_title(title(here).replace("improved ", ""), fontsize=8)
        column[1].set_xlabel("true pitch [°]")
    axes[0, 0].set_ylabel("pitch error [°]")
    axes[1, 0].set_ylabel("range error [mm]")
    axes[0, -1].legend(fontsize=7.5, loc="upper right", markerscale=2)
    return plot
