"""Figures of the laboratory, in the thesis's axes: yaw over frame number, per pass; the arm's lines; frames; lamp and lens."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure as Plot

from experiments.reporting.figures import BLACK, BLUE, GREEN, MARKERS, ORANGE, SKY, VERMILION, new_figure
from experiments.thesis.physical import arm
from experiments.thesis.physical.methods import METHODS
from experiments.thesis.physical.study import NEAR_PHASE_DEG
from experiments.thesis.physical.summary import ILLUMINATION_NAMES, beside, series

CAPTIONS = {
    "yaw": "Yaw over frame number, frames as taken, by the thesis's pipeline (figure 8.11). Rows are illuminations, columns "
    "passes.",
    "yaw-scaled": "Yaw over frame number of the frames scaled as in section 7.1.5, by the thesis's pipeline (figure 8.12).",
    "yaw-mantis": "Yaw over frame number of the scaled frames, by this project's detector.",
    "error": "Yaw error over true yaw in eclipse, all passes, frames as taken and scaled.",
    "trajectories": "Lines of the arm (figure 7.5, reconstructed), marker and lamp.",
    "frames": "Frames as the thesis's pipeline gets them, 8 bits (figures 8.13 and 7.6).",
    "lamp": "Blobs found over the lamp's level, and over the lens's sharpness.",
}
COLOURS = {"mantis": BLUE, "inner": SKY, "thesis": VERMILION, "thesis_inner": ORANGE, "window_inner": GREEN}
COLOURS_OF_PASSES = (BLUE, VERMILION, GREEN, ORANGE)
_DOTS: dict[str, Any] = {"ls": "none", "mew": 0, "rasterized": True}
#: Part of a frame's height about its middle that is shown of a scaled one.
_SHOWN = 0.5


def yaw(frames: xr.Dataset, scale: str, project: str) -> Plot:
    """Yaw over frame number of inner ArUco alone and all of Mantis by one project; a column a pass, a row an illumination."""
    inner = "inner" if project == "mantis" else "thesis_inner"
    passes = frames.passing.values
    plot, axes = new_figure(2, len(passes), (9.6, 5.0), sharey=True)
    for row, illumination in zip(axes, frames.illumination.values, strict=True):
        for axis, passing in zip(row, passes, strict=True):
            at = frames.sel(passing=passing)
            order = np.argsort(at.frame_number.values.ravel())
            number = at.frame_number.values.ravel()[order]
            true = np.broadcast_to(at.true_yaw_deg.values, at.frame_number.shape).ravel()[order]
            axis.plot(number, true, color=BLACK, lw=0.7, label="true")
            near = np.broadcast_to(beside(at).values, at.frame_number.shape).ravel()[order]
            if str(illumination) == "sunlit":
                axis.fill_between(number, -200, 200, where=near, color="0.88", lw=0, label="lamp beside the camera")
            for by, mark, size in ((inner, "s", 4.5), (project, "o", 3.0)):
                here = series(at, str(illumination), scale, by)
                measured = here.yaw_deg.values.ravel()[order]
                axis.plot(number, measured, mark, color=COLOURS[by], ms=size, label=METHODS[by], **_DOTS)
            both = series(at, str(illumination), scale, project).virtual.values.ravel()[order] > 0
            low = np.full(both.sum(), -68.0)
            axis.plot(number[both], low, "|", color=COLOURS[project], ms=5, label="virtual point found")
            axis.set_ylim(-75, 75)
            height = float(at.height_m)
            axis.set_title(f"{ILLUMINATION_NAMES[str(illumination)]}, pass {passing}, {height:g} m up", fontsize=8)
        row[0].set_ylabel("yaw [°]")
    for axis in axes[-1]:
        axis.set_xlabel("frame number [–]")
    handles, labels = axes[-1, -1].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, markerscale=1.5)
    return plot


def error(frames: xr.Dataset) -> Plot:
    """Yaw error over true yaw in eclipse, at both sizes of frame: all passes together."""
    scales = frames.scale.values
    plot, axes = new_figure(1, len(scales), (8.4, 3.6), sharey=True)
    for axis, scale in zip(axes[0], scales, strict=True):
        for by, mark in zip(("thesis_inner", "thesis", "inner", "mantis"), MARKERS, strict=False):
            here = series(frames, "eclipse", str(scale), by).transpose("passing", "step", "way")
            true = np.broadcast_to(here.true_yaw_deg.values[..., None], here.yaw_error_deg.shape)
            axis.plot(
                true.ravel(),
                here.yaw_error_deg.values.ravel(),
                mark,
                color=COLOURS[by],
                ms=3,
                label=METHODS[by],
                **_DOTS,
            )
        axis.set_yscale("symlog", linthresh=0.3)
        axis.set_yticks([-100, -10, -1, 0, 1, 10, 100], ["−100", "−10", "−1", "0", "1", "10", "100"])
        axis.set_ylim(-150, 150)
        axis.set(
            xlabel="true yaw [°]",
            title={"full": "frames as taken", "scaled": "frames scaled as in section 7.1.5"}[str(scale)],
        )
    axes[0, 0].set_ylabel("yaw error [°], linear to ±0.3°")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8, markerscale=1.5)
    return plot


def trajectories(passes: list[list[arm.Station]]) -> Plot:
    """The arm's lines from above and from the front, with marker and lamp: thesis figure 7.5, reconstructed."""
    plot, axes = new_figure(1, 2, (8.4, 3.6))
    lamp = arm.table()["lamp"]["distance_m"] * arm.lamp_direction()
    for axis, across, label in zip(axes[0], (2, 1), ("out of the face [m]", "up [m]"), strict=True):
        for k, passing in enumerate(passes):
            place = np.array([s.place_m for s in passing])
            axis.plot(
                place[:, 0],
                place[:, across],
                MARKERS[k],
                ms=3,
                mew=0,
                color=COLOURS_OF_PASSES[k],
                label=f"pass {k + 1}",
            )
        axis.plot(0, 0, "s", color=BLACK, ms=8, label="marker")
        axis.plot([0, lamp[0]], [0, lamp[across]], color=BLACK, lw=0.6, ls=":")
        axis.plot(lamp[0], lamp[across], "*", color=BLACK, ms=12, mew=0, label="lamp")
        axis.set(xlabel="to the marker's right [m]", ylabel=label, aspect="equal")
    axes[0, 0].set_title("from above: the passes lie above each other", fontsize=8)
    axes[0, 1].set_title("from the front", fontsize=8)
    axes[0, 1].set_ylim(-1.0, 2.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8)
    return plot


def frames_shown(pictures: dict[str, np.ndarray]) -> Plot:
    """Frames as the thesis's pipeline gets them: in eclipse, under the lamp from aside and from beside the camera, and scaled."""
    plot, axes = new_figure(1, len(pictures), (2.4 * len(pictures), 2.7))
    for axis, (name, image) in zip(axes[0], pictures.items(), strict=True):
        shown = image
        if name == "scaled":
            high, wide = image.shape
            half = int(_SHOWN * high / 2)
            shown = image[high // 2 - half : high // 2 + half, wide // 2 - half : wide // 2 + half]
        axis.imshow(shown, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axis.set_title(name, fontsize=8)
        axis.set_axis_off()
    return plot


def lamp_and_lens(levels: xr.Dataset, sharpness: xr.Dataset) -> Plot:
    """Blobs found over the lamp's level, and over the lens's point spread."""
    plot, axes = new_figure(1, 2, (8.0, 3.4))
    lux = levels.level.values * arm.table()["lamp"]["illuminance_lx"]
    for k, by in enumerate(levels.by.values):
        for near, style in ((True, "-"), (False, "--")):
            blobs = levels.blobs.sel(by=by, near=near)
            label = f"{METHODS[str(by)]}, lamp {'beside the camera' if near else 'aside'}"
            axes[0, 0].plot(lux, blobs, style, marker=MARKERS[k], color=COLOURS[str(by)], label=label)
        blobs = sharpness.blobs.sel(by=by)
        look = {"marker": MARKERS[k], "color": COLOURS[str(by)], "label": METHODS[str(by)]}
        axes[0, 1].plot(sharpness.psf_sigma_px, blobs, **look)
    axes[0, 0].set(
        xscale="log", xlabel="illuminance of the lamp [lx]", ylabel="blobs found of four, mean [–]", ylim=(-0.2, 4.2)
    )
    axes[0, 0].set_title(f"beside the camera: up to {NEAR_PHASE_DEG:g}° from it", fontsize=8)
    axes[0, 1].set(
        xlabel="standard deviation of the lens's point spread [px]",
        ylabel="blobs found of four [–]",
        ylim=(-0.2, 4.2),
        yticks=range(5),
    )
    axes[0, 1].set_title(f"eclipse, middle of the first pass, {arm.nearest().range_m:.1f} m", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    return plot
