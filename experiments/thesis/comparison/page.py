"""What the comparison says: tables, figure and the page."""

from __future__ import annotations

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.page import Page
from experiments.studies.shared.trackers import METHODS
from experiments.thesis.comparison import figures
from experiments.thesis.comparison.published import published
from experiments.thesis.comparison.study import SHOWN, SPREAD_DEG, ComparisonResult

Row = tuple[str, ...]


def rows(dataset: xr.Dataset) -> list[Row]:
    """Heading, then one row a method, range and tilt."""
    table: list[Row] = [
        ("marker", "range_m", "side_px", "tilt_deg", "median_deg", "p95_deg", "with_pose", "off_by_10_deg")
    ]
    for method in dataset.marker.values:
        for range_m in dataset.range_m.values:
            for tilt in dataset.tilt_deg.values:
                at = dataset.sel(marker=method, range_m=range_m, tilt_deg=tilt)
                numbers = (at.median_deg, at.p95_deg, at.posed, at.flipped)
                name = METHODS[str(method)][1]
                cells = (f"{float(v):.3g}" for v in numbers)
                table.append((name, f"{range_m:g}", f"{float(at.size_px):.1f}", f"{tilt:g}", *cells))
    return table


def source_rows() -> list[Row]:
    """Heading, then each curve and where it comes from."""
    rendered = [
        (METHODS[name][1], "rendered here; method as in experiments/studies/shared/trackers.py") for name in SHOWN
    ]
    return [("curve", "source"), *rendered, *((p.name, p.source) for p in published())]


def findings(dataset: xr.Dataset) -> tuple[str, ...]:
    """What is found, a sentence a range."""
    found = []
    for range_m in dataset.range_m.values:
        at = dataset.sel(range_m=range_m)
        front = {str(m): float(at.median_deg.sel(marker=m).isel(tilt_deg=0)) for m in dataset.marker.values}
        ranked = sorted((v, METHODS[m][1]) for m, v in front.items() if np.isfinite(v))
        listed = ", ".join(f"{name} {v:.2g}°" for v, name in ranked)
        found.append(f"Median attitude error at {float(at.size_px):.0f} px across, seen squarely: {listed}.")
    return tuple(found)


def page(result: ComparisonResult, command: str) -> Page:
    """The page of the study."""
    front = result.data.median_deg.isel(tilt_deg=0)
    planar = [m for m in ("aruco", "apriltag") if m in result.data.marker.values]
    gain = front.sel(marker=planar).min("marker") / front.sel(marker="mantis")
    low, high = float(gain.min()), float(gain.max())
    span = f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"
    plot = Plot("tilt", figures.tilt(result.data, result.scenario), figures.CAPTION)
    tables = (
        text_table(rows(result.data), "Attitude error over tilt, rendered", key="tilt", inline=False),
        text_table(source_rows(), "Where each curve comes from", key="sources"),
    )
    return Page(
        study="comparison",
        title="Encoding and plain markers at equal pixel size",
        headline=f"Seen squarely, the Mantis Marker's attitude error is {span} times smaller than the best planar tag's.",
        passed=low > 1,
        command=command,
        sections=(
            Section("figures", "Figures", (Plots((plot,)),)),
            Section("tables", "Tables", tables, wordy=True),
        ),
        findings=findings(result.data),
        about=ABOUT,
        limits=LIMITS,
        scenario=result.scenario,
        data=result.data,
    )


ABOUT = (
    "Section 5.1 of the thesis surveys encoding markers. This page shows the attitude error over tilt, at equal outer size in "
    "pixels, of markers that can be rendered here: the Mantis Marker, ArUco, AprilTag, and a protrusion as of the Space Vision "
    "Marker System. Beside them stand those that cannot be rendered, by closed form or as published.",
)
LIMITS = (
    "The outer sides are equal. A tag fills its side with its pattern; the Mantis Marker fills it with elements and an ArUco of "
    "half its side; the protrusion has dots at its corners and a post as high as the Mantis Marker's virtual points lie deep.",
    f"The frames of one tilt are spread over ±{SPREAD_DEG:g}° about it; those of 0° lie on both sides of frontal.",
    "The protrusion's detector is idealised: it knows which dot is which, and never loses one.",
    "Lens and moiré markers are not rendered: their curves are a closed form with assumed field and deviation, and a published "
    "number that holds for its authors' camera and size.",
    "LEDs alone, the camera and the empty surroundings of the virtual experiment.",
)
