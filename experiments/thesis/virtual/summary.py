"""What the frames of the virtual experiment come to: errors, rates and failures of each series, and the targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from experiments.reporting.formatting import number
from experiments.studies.shared import failures
from experiments.studies.shared.judge import FAILURES
from experiments.studies.shared.trackers import METHODS
from experiments.thesis.virtual.targets import table
from radiometry.geometry import FloatArray

#: An outlier is off by more than this in attitude [deg] or, over range, in range.
OUTLIER_DEG, OUTLIER_RANGE = 10.0, 0.05
#: Targets of Mantis by range [m]: rms of the pitch [deg]; and of the range, everywhere [m]. No outlier at any.
PITCH_TARGET_DEG = {1.3: 0.1, 2.3: 0.25, 3.3: 0.25}
RANGE_TARGET_M = 0.005
#: Nearer to frontal than this is where planar markers are weak [deg].
FRONTAL_DEG = 10.0

#: Statistics of a series: unit and long name.
STATISTICS: dict[str, tuple[str, str]] = {
    "frames": ("1", "frames"),
    "detection": ("1", "share of frames in which the target is found"),
    "pitch_rms_deg": ("degree", "rms pitch error, outliers included"),
    "pitch_bias_deg": ("degree", "mean pitch error, outliers left out"),
    "pitch_inlier_rms_deg": ("degree", "rms pitch error, outliers left out"),
    "pitch_frontal_rms_deg": ("degree", f"rms pitch error within {FRONTAL_DEG:g} deg of frontal, outliers included"),
    "range_rms_m": ("m", "rms range error, outliers included"),
    "range_bias_m": ("m", "mean range error, outliers left out"),
    "range_inlier_rms_m": ("m", "rms range error, outliers left out"),
    "outliers": ("1", f"frames off by more than {OUTLIER_DEG:g} deg in attitude or {100 * OUTLIER_RANGE:g} % in range"),
    "failed": ("1", "frames with any of the five failures"),
}

HEADINGS = (
    "test",
    "target",
    "method",
    "range [m]",
    "turned",
    "frames",
    "found [%]",
    "pitch rms [°]",
    "bias [°]",
    "rms, outliers out [°]",
    "rms, frontal [°]",
    "range rms [mm]",
    "bias [mm]",
    "outliers",
)
#: Columns of `rows` for a terminal.
TERMINAL = (0, 1, 2, 3, 6, 7, 10, 11, 13)
FAILURE_HEADINGS = (*HEADINGS[:6], *failures.MODES.values())


def outliers(dataset: xr.Dataset) -> xr.DataArray:
    """Whether a frame's pose is off by more than `OUTLIER_DEG` or `OUTLIER_RANGE` of the range."""
    far = np.abs(dataset.range_error_m) > OUTLIER_RANGE * dataset.range_m
    return (dataset.attitude_error_deg > OUTLIER_DEG) | far


def summarise(dataset: xr.Dataset) -> xr.Dataset:
    """`STATISTICS`, and how many frames have each failure (`FAILURES`), of every series; NaN where a target cannot fail so."""
    shown = np.isfinite(dataset.pitch_deg)
    wild = outliers(dataset)
    frontal = np.abs(dataset.pitch_deg) <= FRONTAL_DEG
    pitch, distance = dataset.pitch_error_deg, dataset.range_error_m
    any_failure = xr.concat([dataset[name] > 0 for name in FAILURES], "mode").any("mode")
    values = {
        "frames": shown.sum("frame"),
        "detection": dataset.found.where(shown).mean("frame"),
        "pitch_rms_deg": _rms(pitch),
        "pitch_bias_deg": pitch.where(~wild).mean("frame"),
        "pitch_inlier_rms_deg": _rms(pitch.where(~wild)),
        "pitch_frontal_rms_deg": _rms(pitch.where(frontal)),
        "range_rms_m": _rms(distance),
        "range_bias_m": distance.where(~wild).mean("frame"),
        "range_inlier_rms_m": _rms(distance.where(~wild)),
        "outliers": wild.sum("frame"),
        "failed": any_failure.sum("frame"),
    }
    result = xr.Dataset(
        {k: v.assign_attrs(zip(("units", "long_name"), STATISTICS[k], strict=True)) for k, v in values.items()}
    )
    for name in FAILURES:
        count = dataset[name].sum("frame", min_count=1)
        result[name] = count.assign_attrs(units="1", long_name=f"frames with {dataset[name].attrs['long_name']}")
    return result


def _rms(values: xr.DataArray) -> xr.DataArray:
    return (values**2).mean("frame") ** 0.5


def find(summary: xr.Dataset, method: str, *, test: int | None = None, **where: object) -> xr.Dataset | None:
    """The series of a method by its test, or by target, range_m and rotation; None where it was not run."""
    chosen = summary.method.values == method
    for key, value in where.items() | ({"test": test}.items() if test is not None else set()):
        chosen &= summary[key].values == value
    index = np.flatnonzero(chosen)
    return summary.isel(series=int(index[0])) if len(index) else None


def missed(summary: xr.Dataset) -> list[str]:
    """Targets that this project's detector misses, a line each; empty where it meets all."""
    lines = []
    for s in range(summary.sizes["series"]):
        here = summary.isel(series=s)
        limit = PITCH_TARGET_DEG.get(float(here.range_m))
        own = str(here.method.values) == "mantis" and str(here.target.values) != "misplaced"
        if not own or limit is None:
            continue
        name = title(here)
        if not float(here.pitch_rms_deg) <= limit:
            lines.append(f"{name}: pitch rms {number(float(here.pitch_rms_deg))}°, target {limit:g}°")
        if not float(here.range_rms_m) <= RANGE_TARGET_M:
            lines.append(
                f"{name}: range rms {number(1e3 * float(here.range_rms_m))} mm, target {1e3 * RANGE_TARGET_M:g} mm"
            )
        if int(here.outliers):
            lines.append(f"{name}: {int(here.outliers)} outliers, target none")
        if float(here.detection) < 1:
            lines.append(f"{name}: found in {100 * float(here.detection):.2f} % of the frames")
    return lines


def title(series: xr.Dataset) -> str:
    """Say 'test 1 (Mantis Marker, 3.3 m)'."""
    told = (
        f"{target_title(series)}, {float(series.range_m):g} m{', pitch and yaw' if series.rotation == 'both' else ''}"
    )
    return f"test {int(series.test)} ({told})" if int(series.test) else told


def target_title(series: xr.Dataset) -> str:
    """What a series' target is called."""
    return str(table()["target"][str(series.target.values)]["title"])


def method_title(method: str) -> str:
    """What a method is called."""
    return METHODS[method][1]


def _start(series: xr.Dataset) -> list[str]:
    turned = "pitch" if series.rotation == "pitch" else "pitch, yaw"
    return [
        str(int(series.test)) if int(series.test) else "–",
        target_title(series),
        method_title(str(series.method.values)),
        f"{float(series.range_m):g}",
        turned,
        str(int(series.frames)),
    ]


def rows(summary: xr.Dataset) -> list[tuple[str, ...]]:
    """`HEADINGS`, then one row a series, in the order of table 8.1."""
    lines: list[tuple[str, ...]] = [HEADINGS]
    for s in _order(summary):
        here = summary.isel(series=s)
        values = {name: float(here[name]) for name in STATISTICS}
        degrees = [number(values[f"pitch_{k}_deg"]) for k in ("rms", "bias", "inlier_rms", "frontal_rms")]
        millimetres = [number(1e3 * values[name]) for name in ("range_rms_m", "range_bias_m")]
        found = f"{100 * values['detection']:.1f}"
        lines.append((*_start(here), found, *degrees, *millimetres, f"{values['outliers']:.0f}"))
    return lines


def failure_rows(summary: xr.Dataset) -> list[tuple[str, ...]]:
    """`FAILURE_HEADINGS`, then one row a series of a marker with a pattern; '–' where it cannot fail so."""
    lines: list[tuple[str, ...]] = [FAILURE_HEADINGS]
    for s in _order(summary):
        here = summary.isel(series=s)
        if str(here.target.values) == "svms":
            continue
        counts = [float(here[name]) for name in FAILURES]
        lines.append((*_start(here), *("–" if np.isnan(c) else f"{c:.0f}" for c in counts)))
    return lines


def _order(summary: xr.Dataset) -> Sequence[int]:
    test = summary.test.values
    return [int(k) for k in np.argsort(np.where(test > 0, test, 99), kind="stable")]


def rolling(values: FloatArray, angles: FloatArray, half_width_deg: float = 1.0) -> FloatArray:
    """Mean of values (n,) within a half width of each angle (n,), NaN left out."""
    near = np.abs(angles[:, None] - angles) <= half_width_deg + 1e-9
    known = np.isfinite(values)
    return (near[:, known] @ values[known]) / np.maximum(near[:, known].sum(axis=1), 1)
