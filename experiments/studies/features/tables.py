"""What the study of features says: each target beside what was measured, and the tables of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from experiments.chain.statistics import binomial_interval
from experiments.reporting.formatting import number, ranges_text
from experiments.studies.features.accuracy import WIDE_ENOUGH_PX
from experiments.studies.features.clutter import upper_limit
from experiments.studies.features.detection import AT_PX_PER_BIT
from experiments.studies.shared.calibrations import Trial

#: Targets: scatter over bound, bias, detection at `AT_PX_PER_BIT`, misplacement, focal length.
RATIO, BIAS_PX, FOUND, OFFSET_MM, FOCAL = 1.5, 0.05, 0.99, 0.05, 1e-3


@dataclass(frozen=True)
class Target:
    """One target and what the run says of it; `met` is None where the run was too short to judge."""

    name: str
    wanted: str
    measured: str
    met: bool | None


def rms_over_blobs(values: xr.DataArray) -> xr.DataArray:
    """Root mean square over the elements whose blob was found."""
    return (values**2).mean("element") ** 0.5


def ratios(data: xr.Dataset) -> dict[str, xr.DataArray]:
    """Scatter over bound by range and pitch."""
    found = data.blob_scatter_px.notnull()
    return {
        "corners": data.corner_scatter_px / data.corner_bound_px,
        "blobs": rms_over_blobs(data.blob_scatter_px) / rms_over_blobs(data.blob_bound_px.where(found)),
        "attitude": data.attitude_scatter_deg / data.attitude_bound_deg,
        "range": data.range_scatter_m / data.range_bound_m,
    }


def single_blob(data: xr.Dataset) -> xr.DataArray:
    """Scatter over bound of the blob where it is largest, by range and pitch."""
    return (data.blob_scatter_px / data.blob_bound_px).max("element")


def targets(
    accuracy: xr.Dataset, detection: xr.Dataset, clutter: xr.Dataset, trials: dict[str, list[Trial]]
) -> list[Target]:
    """Every target of the study, in the order of the page."""
    wide = accuracy.blob_width_px >= WIDE_ENOUGH_PX
    found = [
        _ratio_target(name, ratio.where(wide) if name == "blobs" else ratio) for name, ratio in ratios(accuracy).items()
    ]
    found.append(_ratio_target("the worst single blob", single_blob(accuracy).where(wide)))
    worst_blob = abs(accuracy.blob_bias_px).max("element").where(wide)
    found += [_bias_target("corners", accuracy.corner_bias_px), _bias_target("blobs", worst_blob)]
    return [*found, *_detection_targets(detection), _free_target(clutter), *_calibration_targets(trials)]


def _ratio_target(name: str, ratio: xr.DataArray) -> Target:
    median, worst = float(ratio.median()), float(ratio.max())
    good = [float(r) for r in ratio.range_m.values if bool((ratio.sel(range_m=r).dropna("pitch_deg") <= RATIO).all())]
    judged = [float(r) for r in ratio.range_m.values if bool(ratio.sel(range_m=r).notnull().any())]
    held = ranges_text(judged, [r for r in good if r in judged])
    text = f"median {number(median)}, worst {number(worst)}; held at every pitch at {held}"
    return Target(f"scatter of {name} over its bound", f"≤ {RATIO:g}", text, worst <= RATIO)


def _bias_target(name: str, bias: xr.DataArray) -> Target:
    worst = float(bias.max())
    at = bias.where(bias == worst, drop=True)
    good = [float(r) for r in bias.range_m.values if not bool((bias.sel(range_m=r) >= BIAS_PX).any())]
    judged = [float(r) for r in bias.range_m.values if bool(bias.sel(range_m=r).notnull().any())]
    text = (
        f"worst {worst:.3f} px ({float(at.range_m[0]):g} m, pitch {float(at.pitch_deg[0]):g}°); "
        f"held at {ranges_text(judged, [r for r in good if r in judged])}"
    )
    return Target(f"bias of {name}", f"< {BIAS_PX:g} px", text, worst < BIAS_PX)


def _detection_targets(found: xr.Dataset) -> list[Target]:
    if AT_PX_PER_BIT not in found.px_per_bit.values:
        return []
    at = found.found_by_size.sel(px_per_bit=AT_PX_PER_BIT)
    frames = int(found.frames_by_size.sel(px_per_bit=AT_PX_PER_BIT))
    result = []
    for family in found.family.values:
        row = at.sel(family=family).dropna("detector")
        texts = [f"{name} {_rate(float(row.sel(detector=name)), frames)}" for name in row.detector.values]
        own = float(row.sel(detector="Mantis"))
        low = float(binomial_interval(np.array(own), frames)[0])
        # Few frames cannot tell: where all are found, it takes 368.
        telling = own / frames < FOUND or float(binomial_interval(np.array(frames), frames)[0]) >= FOUND
        judged = low >= FOUND if telling else None
        name = f"found at {AT_PX_PER_BIT:g} px/bit, {family}"
        result.append(Target(name, f"≥ {100 * FOUND:g} %", f"of {frames} frames " + "; ".join(texts), judged))
    return result


def _rate(count: float, frames: int) -> str:
    low, high = binomial_interval(np.array(count), frames)
    return f"{100 * count / frames:.1f} % [{100 * float(low):.1f}, {100 * float(high):.1f}]"


def _free_target(clutter: xr.Dataset) -> Target:
    frames, false = int(clutter.frames.sum()), int(clutter.false.sum())
    text = f"{false} in {frames} frames; rate below {100 * upper_limit(false, frames):.2g} % with 95 % confidence"
    return Target(
        "false markers on marker-free frames", "none in 10 000", text, false == 0 if frames >= 10_000 else None
    )


def _calibration_targets(trials: dict[str, list[Trial]]) -> list[Target]:
    result = []
    for label in ("poses unknown", "poses known"):
        elements = [
            t for t in trials.get("elements", []) if t.what.endswith(label) and not t.what.startswith("virtual")
        ]
        if elements:
            off = max(abs(t.found - t.true) for t in elements)
            moved = next(t for t in elements if t.true)
            text = f"{moved.found:.3f} ± {moved.sigma:.3f} mm; worst of the four off by {off:.3f} mm"
            result.append(
                Target(f"one element off by 1 mm, {label}", f"within {OFFSET_MM:g} mm", text, off <= OFFSET_MM)
            )
    for name in ("camera", "distorted camera"):
        focal = [t for t in trials.get(name, []) if t.what.startswith("focal")]
        if focal:
            off = max(abs(t.found / t.true - 1) for t in focal)
            text = f"off by {100 * off:.3f} %" + (f"; {_distortion(trials[name])}" if name != "camera" else "")
            result.append(Target(f"focal length, {name}", f"within {100 * FOCAL:g} %", text, off <= FOCAL))
    return result


def _distortion(trials: Sequence[Trial]) -> str:
    return ", ".join(
        f"{t.what} = {t.found:.4f} ± {t.sigma:.4f} for {t.true:g}" for t in trials if t.what in ("k1", "p1")
    )


def headline(found: Sequence[Target]) -> str:
    """One sentence."""
    judged = [t for t in found if t.met is not None]
    met = [t for t in judged if t.met]
    missed = [t.name for t in judged if not t.met]
    return f"{len(met)} of {len(judged)} targets met" + (f"; not met: {', '.join(missed)}." if missed else ".")


TARGET_HEADINGS = ("", "target", "wanted", "measured")


def target_rows(found: Sequence[Target]) -> list[tuple[str, ...]]:
    """Cells of the targets."""
    marks = {True: "✓", False: "✗", None: "–"}
    return [(marks[t.met], t.name, t.wanted, t.measured) for t in found]


ACCURACY_HEADINGS = (
    "range [m]",
    "pitch [°]",
    "px/bit",
    "blob width [px]",
    "corner: bound [px]",
    "scatter/bound",
    "bias [px]",
    "blob: bound [px]",
    "scatter/bound",
    "worst blob",
    "bias [px]",
    "attitude: bound [°]",
    "scatter/bound",
    "range: bound [mm]",
    "scatter/bound",
)


def accuracy_rows(data: xr.Dataset) -> list[tuple[str, ...]]:
    """Cells of bounds, scatter and bias, range by range."""
    share = {**ratios(data), "worst": single_blob(data)}
    blob_bound = rms_over_blobs(data.blob_bound_px.where(data.blob_scatter_px.notnull()))
    worst = abs(data.blob_bias_px).max("element")
    rows: list[tuple[str, ...]] = []
    for at in (dict(range_m=r, pitch_deg=p) for r in data.range_m.values for p in data.pitch_deg.values):
        here = data.sel(at)
        ratio = {name: f"{float(value.sel(at)):.2f}" for name, value in share.items()}
        rows.append(
            (
                f"{at['range_m']:g}",
                f"{at['pitch_deg']:g}",
                f"{float(here.bit_px):.1f}",
                f"{float(here.blob_width_px):.1f}",
                f"{float(here.corner_bound_px):.4f}",
                ratio["corners"],
                f"{float(here.corner_bias_px):.3f}",
                f"{float(blob_bound.sel(at)):.4f}",
                ratio["blobs"],
                ratio["worst"],
                f"{float(worst.sel(at)):.3f}",
                f"{float(here.attitude_bound_deg):.4f}",
                ratio["attitude"],
                f"{1e3 * float(here.range_bound_m):.3f}",
                ratio["range"],
            )
        )
    return rows


CLUTTER_HEADINGS = ("frames show", "frames of", "frames", "false markers", "another identity named")
_COUNTS = ("frames", "false", "false_other")


def clutter_rows(data: xr.Dataset) -> list[tuple[str, ...]]:
    """Cells of the marker-free frames."""
    rows = [
        (str(kind), f"{size} px", *(str(int(data[name].sel(kind=kind, size_px=size))) for name in _COUNTS))
        for size in data.size_px.values
        for kind in data.kind.values
    ]
    return [*rows, ("all", "", *(str(int(data[name].sum())) for name in _COUNTS))]


TRIAL_HEADINGS = ("parameter", "rendered with", "found", "standard deviation", "off by [σ]")


def trial_rows(trials: Sequence[Trial]) -> list[tuple[str, ...]]:
    """Cells of one calibration."""
    return [
        (
            f"{t.what} [{t.unit}]",
            f"{t.true:.4f}",
            f"{t.found:.4f}",
            f"{t.sigma:.4f}",
            f"{(t.found - t.true) / t.sigma:+.1f}",
        )
        for t in trials
    ]
