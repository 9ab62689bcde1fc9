"""Figures of the layout study: placements, what is usable over range, rendered frames, and the face's pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from experiments.reporting.figures import BLACK, BLUE, COLOURS, new_figure
from experiments.thesis.layout.placement import Layout

CAPTIONS = {
    "placement": "Placements on a face (figure 6.1 of the thesis gives no numbers): wide, narrow, and nested rings.",
    "cover": "Markers that can be used over range. Colour: share of attitudes, within ±45° and at any roll, with at least one. "
    "Number: markers when the face is seen squarely.",
    "views": "Rendered frames of the middle of the run: LEDs alone, automatic exposure, noise included.",
    "pose": "Error of the face's pose over range from rendered frames, from the surest marker alone and from all markers "
    "together: median (line) and largest (dots) of all attitudes and noise draws.",
}


def placement(layouts: Sequence[Layout]) -> Figure:
    """Each layout's markers drawn on its face."""
    figure, axes = new_figure(1, len(layouts), (2.9 * len(layouts), 3.2))
    for axis, lay in zip(axes[0], layouts, strict=True):
        half = lay.face_m / 2
        axis.add_patch(Rectangle((-half, -half), 2 * half, 2 * half, fill=False, ec=BLACK, lw=1))
        for one in lay.placed:
            x, y = one.centre_m
            size = one.design.size_m
            axis.add_patch(Rectangle((x - size / 2, y - size / 2), size, size, fc=BLUE, ec="white", lw=0.4))
        share = f"{100 * lay.area_share:.2g} % of the face"
        name = lay.kind if lay.kind == "nested" else f"{lay.kind}, {lay.sizing}"
        axis.set(title=f"{name}: {share}", xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axis.set_xlim(-1.08 * half, 1.08 * half)
        axis.set_ylim(-1.08 * half, 1.08 * half)
        axis.grid(visible=False)
    return figure


def cover(counts: xr.Dataset) -> Figure:
    """Heat map of attitudes with a usable marker, layout × range, one panel a face."""
    faces, ranges, names = counts.face_m.values, counts.range_m.values, counts.layout.values
    figure, axes = new_figure(len(faces), 1, (8.4, 0.6 + 1.75 * len(faces)), sharex=True)
    image: Any = None
    for axis, face_m in zip(axes[:, 0], faces, strict=True):
        at = counts.sel(face_m=face_m).transpose("layout", "range_m")
        image = axis.imshow(100 * (1 - at.none), vmin=0, vmax=100, cmap="Blues", aspect="auto")
        for row, column in np.ndindex(at.usable.shape):
            dark = float(at.none[row, column]) < 0.5
            text = f"{int(at.usable[row, column])}"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color="white" if dark else BLACK)
        axis.set_yticks(range(len(names)), names, fontsize=8)
        axis.set_xticks(range(len(ranges)), [f"{r:g}" for r in ranges], fontsize=8)
        axis.set_title(f"face of {face_m:g} m", loc="left")
        axis.grid(visible=False)
    axes[-1, 0].set_xlabel("range [m]")
    figure.colorbar(image, ax=axes[:, 0].tolist(), label="attitudes with a usable marker [%]", shrink=0.5)
    return figure


def views(frames: Mapping[str, NDArray[np.uint16]]) -> Figure:
    """Frames (height, width) [DN] side by side under their titles, brightness stretched to each one's own 99.9th percentile."""
    columns = min(len(frames), 2)
    rows = -(-len(frames) // columns)
    figure, axes = new_figure(rows, columns, (4.0 * columns, 0.2 + 3.3 * rows))
    for axis in axes.flat[len(frames) :]:
        axis.set_visible(False)
    for axis, (title, image) in zip(axes.flat, frames.items(), strict=False):
        top = float(np.percentile(image, 99.9))
        axis.imshow(
            image, cmap="gray", vmin=float(np.percentile(image, 1)), vmax=max(top, 1.0), interpolation="nearest"
        )
        axis.set_title(title, fontsize=8)
        axis.set_xticks([])
        axis.set_yticks([])
        axis.grid(visible=False)
    return figure


def pose(rendered: xr.Dataset) -> Figure:
    """Attitude, range and lateral error over range for each case, one marker and all."""
    quantities = (
        ("attitude_deg", 1.0, "attitude error [deg]"),
        ("range_error_m", 1e3, "range error [mm]"),
        ("lateral_error_m", 1e3, "lateral error [mm]"),
    )
    figure, axes = new_figure(1, 3, (9.6, 3.5))
    for number, (title, here) in enumerate(cases(rendered)):
        ranges = np.unique(here.range_m.values)
        for axis, (name, scale, quantity) in zip(axes[0], quantities, strict=True):
            for solver, style in (("one marker", "--"), ("all markers", "-")):
                values = here[name].sel(solver=solver).values * scale
                groups = [values[(here.range_m.values == r) & np.isfinite(values)] for r in ranges]
                kept = [(r, g) for r, g in zip(ranges, groups, strict=True) if len(g)]
                if not kept:
                    continue
                places = [r for r, _ in kept]
                label = f"{title}, {solver}" if axis is axes[0, 0] else None
                axis.plot(places, [np.median(g) for _, g in kept], color=COLOURS[number], ls=style, label=label)
                axis.plot(places, [g.max() for _, g in kept], ".", color=COLOURS[number], ms=4)
            axis.set(xlabel="range [m]", ylabel=quantity, yscale="log")
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return figure


def cases(rendered: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Frames of each case, by its name."""
    found: dict[str, xr.Dataset] = {}
    for kind, face_m in zip(rendered.kind.values, rendered.face_m.values, strict=True):
        name = f"{kind}, {face_m:g} m face"
        if name not in found:
            found[name] = rendered.isel(frame=np.flatnonzero((rendered.kind == kind) & (rendered.face_m == face_m)))
    return list(found.items())
