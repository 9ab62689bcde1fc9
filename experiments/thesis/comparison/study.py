"""Attitude error over tilt of several markers at equal size in pixels: rendered where they can be, by closed form where not.

The frames are those of the virtual experiment (`experiments.thesis.virtual`): its camera, its 25 mm targets and its methods; here every
tilt is repeated, each time with its own noise and its own sampling.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.reporting.claims import StudyPage
from experiments.reporting.figures import COLOURS, MARKERS, new_figure
from experiments.scenario import Scenario
from experiments.studies.shared.trackers import METHODS
from experiments.thesis.virtual import study as virtual
from experiments.thesis.virtual.targets import Run, load
from radiometry.encoding import RAYLEIGH_MEDIAN, lens_deviation, slit_deviation
from radiometry.geometry import FloatArray

#: What is rendered, and the methods that are shown of each.
TARGETS = ("improved", "aruco", "apriltag", "svms")
SHOWN = ("mantis", "aruco", "aruco_opencv", "apriltag", "svms")

#: Frames of one tilt are spread evenly over so much to either side of it [deg]: at one exact attitude all edges would fall on the
#: same sub-pixels, and a solver that starts from frontal would be right at frontal by standing still.
SPREAD_DEG = 2.0


@dataclass(frozen=True)
class Plan:
    """Ranges, tilts about the marker's x axis, and frames of each, spread about it by `SPREAD_DEG`."""

    ranges_m: tuple[float, ...]
    tilts_deg: tuple[float, ...]
    frames: int


FULL = Plan((2.3, 4.6), tuple(np.arange(0.0, 61.0, 5.0)), 16)
QUICK = Plan((2.3,), (0.0, 30.0), 3)


def runs(plan: Plan) -> list[Run]:
    """Every target at every range; tilts one after the other, the frames of each spread about it."""
    about = SPREAD_DEG * (2 * (np.arange(plan.frames) + 0.5) / plan.frames - 1)
    angles = tuple(float(a) for a in np.add.outer(plan.tilts_deg, about).ravel())
    return [Run(0, target, range_m, "pitch", angles) for range_m in plan.ranges_m for target in TARGETS]


def run(scenario: Scenario, plan: Plan, workers: int | None = None, progress: Progress | None = None) -> xr.Dataset:
    """Median and 95th percentile of the attitude error, share with a pose and of flips, by marker, range_m, tilt_deg."""
    frames = virtual.study(scenario, runs(plan), workers, progress)
    methods = [m for m in SHOWN if m in frames.method.values]
    shape = (len(methods), len(plan.ranges_m), len(plan.tilts_deg))
    table = {name: np.full(shape, np.nan) for name in ("median_deg", "p95_deg", "posed", "flipped")}
    for m, name in enumerate(methods):
        for r, range_m in enumerate(plan.ranges_m):
            rows = np.flatnonzero((frames.method.values == name) & (frames.range_m.values == range_m))
            error = frames.attitude_error_deg.values[rows[0]].reshape(len(plan.tilts_deg), plan.frames)
            for t, values in enumerate(error):
                good = values[np.isfinite(values)]
                table["posed"][m, r, t] = len(good) / plan.frames
                table["flipped"][m, r, t] = np.mean(good > virtual.OUTLIER_DEG) if len(good) else np.nan
                if len(good):
                    table["median_deg"][m, r, t], table["p95_deg"][m, r, t] = np.median(good), np.percentile(good, 95)
    texts = {
        "median_deg": ("deg", "median attitude error"),
        "p95_deg": ("deg", "95th percentile of the attitude error"),
        "posed": ("1", "share of frames with a pose"),
        "flipped": ("1", "share of those poses that are off by more than 10 deg"),
    }
    dims = ("marker", "range_m", "tilt_deg")
    focal = max(scenario.camera.focal_px)
    size = [focal * scenario.marker.size_m / r for r in plan.ranges_m]
    coordinates = {
        "marker": methods,
        "range_m": ("range_m", list(plan.ranges_m), {"units": "m"}),
        "tilt_deg": ("tilt_deg", list(plan.tilts_deg), {"units": "deg"}),
        "size_px": ("range_m", size, {"units": "pixel", "long_name": "outer side of every marker seen squarely"}),
    }
    data: dict[str, Any] = {k: (dims, v, {"units": texts[k][0], "long_name": texts[k][1]}) for k, v in table.items()}
    return xr.Dataset(data, coordinates, {**frames.attrs, "title": "Attitude error over tilt", "frames": plan.frames})


@dataclass(frozen=True)
class Published:
    """A marker that is not rendered; see `published.toml`."""

    name: str
    source: str
    model: str = ""
    field_deg: float = 0.0
    sigma_px: float = 0.0
    per_axis: int = 1
    level_deg: float = 0.0

    def median_deg(self, tilt_deg: FloatArray, scenario: Scenario, size_px: float) -> FloatArray:
        """Median attitude error over tilt [deg], two axes alike, for an outer side in pixels; a level where there is no model."""
        if not self.model:
            return np.full(np.shape(tilt_deg), self.level_deg)
        marker = scenario.marker
        length = size_px * marker.element_length_m / marker.size_m
        tilt = np.radians(tilt_deg)
        if self.model == "lens":
            deviation = lens_deviation(tilt, np.radians(self.field_deg), length, self.sigma_px)
        else:
            deviation = slit_deviation(tilt, marker.virtual_depth_fraction * length, self.sigma_px)
        return np.degrees(RAYLEIGH_MEDIAN * deviation / np.sqrt(self.per_axis))


def published() -> tuple[Published, ...]:
    """Markers of the data file."""
    text = (files("experiments") / "thesis" / "comparison" / "published.toml").read_text(encoding="utf-8")
    return tuple(Published(**entry) for entry in tomllib.loads(text)["marker"])


def rows(dataset: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a method, range and tilt."""
    table: list[tuple[str, ...]] = [
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


def source_rows() -> list[tuple[str, ...]]:
    """Heading, then each curve and where it comes from."""
    table: list[tuple[str, ...]] = [("curve", "source")]
    for name in SHOWN:
        table.append((METHODS[name][1], "rendered here; method as in experiments/studies/shared/trackers.py"))
    table += [(p.name, p.source) for p in published()]
    return table


CAPTION = (
    "Median attitude error over tilt at equal outer size: rendered frames with noise (full lines), closed forms "
    "(dashed) and a published "
    "accuracy (dotted, its authors' camera and size)"
)


def figure(dataset: xr.Dataset, scenario: Scenario) -> Any:
    """One panel a range: every marker's median error over tilt."""
    plot, axes = new_figure(1, dataset.sizes["range_m"], (4.9 * dataset.sizes["range_m"], 4.6), sharey=True)
    fine = np.linspace(float(dataset.tilt_deg.min()), max(float(dataset.tilt_deg.max()), 1.0), 100)
    for axis, range_m in zip(axes[0], dataset.range_m.values, strict=True):
        at = dataset.sel(range_m=range_m)
        size = float(at.size_px)
        for k, method in enumerate(dataset.marker.values):
            axis.plot(
                at.tilt_deg, at.median_deg.sel(marker=method), marker=MARKERS[k], color=COLOURS[k], label=METHODS[str(method)][1]
            )  # fmt: skip
        for k, other in enumerate(published()):
            style = {"ls": "--" if other.model else ":", "color": COLOURS[len(dataset.marker) + k], "lw": 1.2}
            axis.plot(fine, other.median_deg(fine, scenario, size), label=other.name, **style)
        axis.set(
            xlabel="tilt about the marker's x axis [deg]",
            yscale="log",
            ylim=(1e-3, 300),
            title=f"{size:.0f} px across ({range_m:g} m)",
        )
    axes[0, 0].set_ylabel("median attitude error [deg]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    plot.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    return plot


def answers(dataset: xr.Dataset) -> tuple[str, ...]:
    """What is found, a sentence a range."""
    said = []
    for range_m in dataset.range_m.values:
        at = dataset.sel(range_m=range_m)
        front = {str(m): float(at.median_deg.sel(marker=m).isel(tilt_deg=0)) for m in dataset.marker.values}
        ranked = sorted((v, METHODS[m][1]) for m, v in front.items() if np.isfinite(v))
        listed = ", ".join(f"{name} {v:.2g}°" for v, name in ranked)
        said.append(f"At {float(at.size_px):.0f} px, seen squarely (median): {listed}.")
    return tuple(said)


def page(dataset: xr.Dataset, scenario: Scenario, command: str) -> StudyPage:
    """Everything that is written."""
    front = dataset.median_deg.isel(tilt_deg=0)
    planar = [m for m in ("aruco", "apriltag") if m in dataset.marker.values]
    gain = front.sel(marker=planar).min("marker") / front.sel(marker="mantis")
    low, high = float(gain.min()), float(gain.max())
    span = f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"
    return StudyPage(
        name="comparison",
        title="Encoding and plain markers at equal pixel size",
        headline=f"Seen squarely, the Mantis Marker's attitude error is {span} times smaller than the best planar "
        f"tag's.",
        passed=low > 1,
        answers=answers(dataset),
        statements=[],
        tables={"tilt": rows(dataset), "sources": source_rows()},
        table_captions={"tilt": "Attitude error over tilt, rendered", "sources": "Where each curve comes from"},
        plots={"tilt": figure(dataset, scenario)},
        captions={"tilt": CAPTION},
        about=ABOUT,
        short=("sources",),
        limits=LIMITS,
        command=command,
        scenario=scenario,
    )


ABOUT = (
    "Section 5.1 of the thesis surveys encoding markers. This page sets attitude error over tilt of those that can "
    "be rendered here "
    "(the Mantis Marker, ArUco, AprilTag, a protrusion as of the Space Vision Marker System) beside those that "
    "cannot, by closed "
    "form or as published, at equal outer size in pixels.",
)
LIMITS = (
    "Equal outer side: a tag fills it with its pattern, the Mantis Marker with elements and an ArUco of half its "
    "side, the protrusion with "
    "dots at its corners and a post as high as the Mantis Marker's virtual points lie deep.",
    f"The frames of one tilt are spread over ±{SPREAD_DEG:g}° about it; those of 0° lie on both sides of frontal.",
    "The protrusion's detector is idealised: it knows which dot is which, and never loses one.",
    "Lens and moiré markers are not rendered: their curves are a closed form with assumed field and deviation, and "
    "a published number "
    "that holds for its authors' camera and size.",
    "LEDs alone, the camera and the empty surroundings of the virtual experiment.",
)


def study(
    out: Path, command: str, quick: bool = False, seed: int | None = None, overrides: tuple[str, ...] = (),
    workers: int | None = None, progress: Progress | None = None,
) -> StudyPage:  # fmt: skip
    """Run and write comparison.nc, report.html, data/comparison-*.csv and figures/comparison-tilt.svg into a folder."""
    scenario = load(overrides, seed)
    dataset = run(scenario, QUICK if quick else FULL, workers, progress)
    result = page(dataset, scenario, command)
    result.write(out, dataset)
    return result
