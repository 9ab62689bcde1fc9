"""Figures of the glare study: polar maps of where the Sun may stand, rates over phase, dimmed LEDs, and the worst frames."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from experiments.reporting.figures import BLACK, BLUE, COLOURS, GREEN, MARKERS, ORANGE, SKY, VERMILION, new_figure
from experiments.studies.glare.gallery import Worst
from experiments.studies.glare.tables import TARGET_PHASES_DEG

#: Attitude errors of this and less, and of this and more, share a colour [deg].
_ATTITUDE_DEG = (0.03, 10.0)


#: Pieces of one azimuth's sector.
_ARCS = 12
#: Modes side by side in a map.
_COLUMNS = 6
#: Modes drawn over phase: more lines could not be told apart; the table has all.
_OVER_PHASE = ("single", "narrow", "bracket", "two_bands", "pair", "long", "thesis")


def detection_map(dataset: xr.Dataset) -> Figure:
    """Share of frames in which the marker is found, by the Sun's phase (radius) and azimuth, mode and range."""
    rate = 100 * dataset.detected.mean("frame")
    return _polar(rate, "marker found [%]", "viridis", Normalize(0, 100))


def pose_map(dataset: xr.Dataset) -> Figure:
    """Largest attitude error of the frames of each Sun; grey where none was found."""
    error = dataset.attitude_error_deg.fillna(-np.inf).max("frame")
    return _polar(error.where(error > -np.inf), "largest attitude error [°]", "plasma_r", LogNorm(*_ATTITUDE_DEG))


def _polar(values: xr.DataArray, label: str, colours: str, norm: Normalize) -> Figure:
    modes, ranges, phases = (values[d].values for d in ("mode", "range_m", "phase_deg"))
    azimuth = np.radians(values.azimuth_deg.values)
    step = 2 * np.pi / len(azimuth)
    columns = min(len(modes), _COLUMNS)
    rows = len(ranges) * -(-len(modes) // columns)
    figure, axes = new_figure(
        rows, columns, (1.28 * columns + 0.9, 1.45 * rows + 0.9), subplot_kw={"projection": "polar"}
    )
    figure.set_dpi(220)  # of the maps inside the drawing
    colour_map = colormaps[colours].with_extremes(bad="#bbbbbb")
    # Rings of one width each, for half of the story lies within 10° of the camera's own direction.
    edges = np.arange(len(phases) + 1)
    mesh = None
    for (row, column), axis in np.ndenumerate(axes):
        block, i = divmod(row, len(ranges))
        j = block * columns + column
        if j >= len(modes):
            axis.axis("off")
            continue
        cells = values.sel(mode=modes[j], range_m=ranges[i]).transpose("phase_deg", "azimuth_deg").values
        # A quadrilateral's outer side is a chord: many narrow ones make an arc. As an image they stay small.
        angle = azimuth[0] - step / 2 + np.linspace(0, 2 * np.pi, _ARCS * len(azimuth) + 1)
        fine = np.ma.masked_invalid(np.repeat(cells, _ARCS, axis=1))
        mesh = axis.pcolormesh(angle, edges, fine, cmap=colour_map, norm=norm, rasterized=True)
        axis.set(xticks=[], yticks=[], ylim=(0, len(phases)))
        axis.grid(False)
        for k, phase in enumerate(phases):
            if (i == 0 and j == 0) or k == len(phases) - 1:
                axis.text(np.radians(75), k + 0.5, f"{phase:g}", fontsize=4.5, ha="center", va="center", color=BLACK)
        if i == 0:
            axis.set_title(str(modes[j]))
        if column == 0:
            axis.set_ylabel(f"{ranges[i]:g} m", labelpad=10)
    assert mesh is not None
    figure.colorbar(mesh, ax=axes, label=label, shrink=0.8, aspect=30)
    figure.supxlabel(
        "rings: phase angle [°]; direction: side of the camera on which the Sun stands, 0° to the right", fontsize=8
    )
    return figure


def over_phase(summary: xr.Dataset) -> Figure:
    """Detection with its interval, attitude error and bias of the blobs over phase, by range and mode."""
    ranges, modes = summary.range_m.values, [m for m in _OVER_PHASE if m in summary.mode.values] or summary.mode.values
    figure, axes = new_figure(3, len(ranges), (max(3.4 * len(ranges) + 0.4, 6.4), 6.6), sharex=True, sharey="row")
    place = np.arange(summary.sizes["phase_deg"])
    for j, range_m in enumerate(ranges):
        for m, mode in enumerate(modes):
            cells = summary.sel(range_m=range_m, mode=mode)
            style = {"color": COLOURS[m % len(COLOURS)], "marker": MARKERS[m % len(MARKERS)], "ms": 3, "lw": 1.0}
            rate, low, high = (100 * cells[k].values for k in ("detection", "detection_low", "detection_high"))
            axes[0, j].errorbar(
                place + 0.06 * (m - len(modes) / 2),
                rate,
                [rate - low, high - rate],
                label=str(mode),
                elinewidth=0.6,
                **style,
            )
            axes[1, j].plot(place, cells.attitude_p95_deg, **style)
            axes[2, j].plot(place, cells.blob_bias_px, **style)
        axes[0, j].set_title(f"{range_m:g} m, {float(summary.px_per_bit.sel(range_m=range_m)):.1f} px/bit or more")
        axes[1, j].set_yscale("log")
        axes[2, j].set_yscale("log")
        axes[2, j].set(xlabel="phase angle [°]", xticks=place, xticklabels=[f"{p:g}" for p in summary.phase_deg.values])
        low_deg = int(np.argmax(summary.phase_deg.values >= TARGET_PHASES_DEG[0]))
        for axis in axes[:, j]:
            axis.axvspan(-0.5, low_deg - 0.5, color=BLACK, alpha=0.05, lw=0)
            axis.set_xlim(-0.5, len(place) - 0.5)
    for axis, label in zip(
        axes[:, 0],
        ("marker found [%]", "attitude error,\n95th percentile [°]", "largest bias\nof a blob [px]"),
        strict=True,
    ):
        axis.set_ylabel(label)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


def dimmed(case: xr.Dataset) -> Figure:
    """Blobs found over the LEDs' share of the light, the Sun nearly behind the camera and from the side."""
    phases = case.phase_deg.values
    figure, axes = new_figure(1, len(phases), (3.6 * len(phases), 3.0), sharey=True)
    for axis, phase in zip(axes[0], phases, strict=True):
        here = case.sel(phase_deg=phase)
        for m, mode in enumerate(case.mode.values):
            blobs = here.blobs.sel(mode=mode).mean("frame")
            axis.plot(
                here.led_over_sun,
                blobs,
                color=(VERMILION, ORANGE, SKY, BLUE)[m % 4],
                marker=MARKERS[m],
                label=str(mode),
            )
        axis.set(
            xscale="log",
            xlabel="LED light over sunlight on the bits [–]",
            title=f"phase angle {phase:g}°",
            ylim=(-0.1, 4.1),
        )
    axes[0, 0].set_ylabel("blobs found, of four [–]")
    axes[0, -1].legend(loc="lower right", frameon=True)
    return figure


def gallery(frames: list[Worst]) -> Figure:
    """The worst frame of each mode, enlarged, with what failed written below."""
    columns = 5
    rows = -(-len(frames) // columns)
    figure, axes = new_figure(rows, columns, (2.15 * columns, 2.95 * rows))
    for axis in axes.flat:
        axis.axis("off")
    for axis, worst in zip(axes.flat, frames, strict=False):
        _show(axis, worst)
    return figure


def _show(axis: Axes, worst: Worst) -> None:
    low, high = np.percentile(worst.image, [1.0, 99.7])
    axis.imshow(
        np.sqrt(np.clip((worst.image - low) / max(high - low, 1.0), 0, 1)), cmap="gray", interpolation="nearest"
    )
    closed = np.vstack([worst.outline_px, worst.outline_px[:1]])
    axis.plot(*closed.T, "--", color=ORANGE, lw=0.7)
    if worst.features.corners_px is not None:
        axis.plot(*np.vstack([worst.features.corners_px, worst.features.corners_px[:1]]).T, color=SKY, lw=0.8)
    blobs = [b for b in worst.features.blobs_px.values() if b is not None]
    if blobs:
        axis.plot(*np.array(blobs).T, "D", mfc="none", mec=GREEN, ms=4, mew=1)
    axis.set_title(f"{worst.mode}: {worst.where}", fontsize=6.5)
    axis.text(0.5, -0.03, "\n".join(worst.lines), transform=axis.transAxes, ha="center", va="top", fontsize=6)
