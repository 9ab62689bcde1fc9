"""Rates of the glare study with their intervals, verdicts with the limit that stands in the way, and rows of its tables."""

from __future__ import annotations

import numpy as np
import xarray as xr

from experiments.chain.statistics import wilson_interval
from experiments.scenario import Scenario
from experiments.studies.glare.modes import MODES
from radiometry.closure import Requirement

#: Phase angles for which the target of the study is stated [deg].
TARGET_PHASES_DEG = (5.0, 150.0)
#: Below this phase angle tape returns much of the Sun's light to the camera, more to one side of a marker than the other [deg].
RETRO_DEG = 5.0
#: Pixels per bit below which OpenCV's ArUco finds few markers (`Requirement.px_per_bit_min`).
OPENCV_PX_PER_BIT = 3.0


def summarise(dataset: xr.Dataset, scenario: Scenario) -> xr.Dataset:
    """Rates, intervals, percentiles, biases, `meets` and `limit` over (mode, range_m, phase_deg); azimuths, attitudes pooled."""
    pooled = ("azimuth_deg", "frame")
    trials = dataset.sizes["azimuth_deg"] * dataset.sizes["frame"]
    need = scenario.requirement
    found = dataset.detected.sum(pooled)
    good = (dataset.attitude_error_deg <= need.attitude_error_max_deg) & (dataset.range_error <= need.range_error_max)
    low, high = wilson_interval(found, trials)
    x, y = (_mean(dataset[f"corner_error_{axis}_px"], pooled) for axis in "xy")
    by_sun = _mean(dataset.blob_error_px, ("frame",))
    result = xr.Dataset(
        {
            "detection": found / trials,
            "detection_low": (found.dims, low),
            "detection_high": (found.dims, high),
            "usable": good.sum(pooled) / trials,
            "attitude_p95_deg": _percentile(dataset.attitude_error_deg, pooled),
            "range_p95": _percentile(dataset.range_error, pooled),
            "corner_bias_px": (x**2 + y**2) ** 0.5,
            "blob_bias_px": abs(by_sun).max(("azimuth_deg", "element")),
            "blobs": dataset.blob_error_px.notnull().sum((*pooled, "element")) / found.where(found > 0),
            "false_positive": dataset.false_positive.mean(pooled),
            "saturated_fraction": dataset.saturated_fraction.mean(pooled),
            "cnr": _mean(dataset.cnr, pooled),
            "pulse_s": dataset.pulse_s.mean(pooled),
        }
    ).assign_attrs(trials=trials)
    result["meets"] = (
        (result.detection >= need.detection_min)
        & (result.attitude_p95_deg <= need.attitude_error_max_deg)
        & (result.range_p95 <= need.range_error_max)
    )
    figures = (result[name] for name in ("meets", "px_per_bit", "saturated_fraction", "cnr", "detection"))
    result["limit"] = xr.apply_ufunc(
        _limit, *figures, result.phase_deg, result.mode, kwargs={"need": need}, vectorize=True
    )
    return result


def _limit(
    meets: bool,
    px_per_bit: float,
    saturated: float,
    cnr: float,
    detection: float,
    phase_deg: float,
    mode: str,
    need: Requirement,
) -> str:
    """What most plainly stands in the way of a cell that does not meet the requirement; a diagnosis by these figures."""
    fewest = OPENCV_PX_PER_BIT if MODES[mode].pipeline == "thesis" else need.px_per_bit_min
    if meets:
        return ""
    if saturated > 0.05:
        return "sunlight on the tape fills the well within the exposure"
    if px_per_bit < fewest:
        return "too few pixels per bit"
    if cnr < need.cnr_min:
        return "too little contrast over the noise"
    found = detection >= need.detection_min
    if phase_deg < RETRO_DEG:
        return "the tape's own return of the Sun biases the pose" if found else "the tape returns the Sun, unevenly"
    return "features too coarse for the pose" if found else "the pattern is not recognised"


def _mean(values: xr.DataArray, dims: tuple[str, ...]) -> xr.DataArray:
    """Mean of what is known; NaN where nothing is."""
    known = values.notnull()
    count = known.sum(dims)
    return values.where(known, 0).sum(dims) / count.where(count > 0)


def _percentile(values: xr.DataArray, dims: tuple[str, ...]) -> xr.DataArray:
    """95th percentile of what is known; NaN where nothing is."""
    stacked = values.stack(all=dims).transpose(..., "all")
    table = stacked.values.reshape(-1, stacked.shape[-1])
    known = [row[np.isfinite(row)] for row in table]
    found = np.array([np.percentile(row, 95) if len(row) else np.nan for row in known])
    return stacked.isel(all=0, drop=True).copy(data=found.reshape(stacked.shape[:-1]))


def in_target(summary: xr.Dataset) -> xr.Dataset:
    """The part of a summary for which the target is stated."""
    low, high = TARGET_PHASES_DEG
    return summary.sel(phase_deg=[p for p in summary.phase_deg.values if low <= p <= high])


def verdicts(summary: xr.Dataset, mode: str) -> tuple[bool, list[str]]:
    """Whether a mode meets the requirement at every range and phase of the target, and what fails where, at any phase."""
    lines = [f"{range_m}, phase {phases}: {limit}" for range_m, phases, limit in _shortfalls(summary, mode)]
    return bool(in_target(summary.sel(mode=mode)).meets.all()), lines


SHORTFALL_HEADINGS = ("mode", "range", "phase", "what stands in the way")


def shortfall_rows(summary: xr.Dataset) -> list[tuple[str, ...]]:
    """One row for every mode, range and reason for which it does not meet the requirement, at any phase."""
    return [(str(mode), *row) for mode in summary.mode.values for row in _shortfalls(summary, str(mode))]


def _shortfalls(summary: xr.Dataset, mode: str) -> list[tuple[str, str, str]]:
    cells, rows = summary.sel(mode=mode), []
    for range_m in cells.range_m.values:
        here = cells.sel(range_m=range_m)
        for limit in dict.fromkeys(str(text) for text in here.limit.values if text):
            phases = ", ".join(f"{p:g}°" for p in here.phase_deg.values[here.limit.values == limit])
            rows.append((f"{range_m:g} m", phases, limit))
    return rows


#: Columns of `HEADINGS` that fit a terminal.
TERMINAL = (0, 1, 2, 3, 5, 6, 8, 13)
#: Columns of the table of modes.
HEADINGS = (
    "mode",
    "range [m]",
    "phases",
    "found [%]",
    "95 % [%]",
    "attitude p95 [°]",
    "range p95 [%]",
    "blobs",
    "blob bias [px]",
    "corner bias [px]",
    "false pos. [%]",
    "saturated [%]",
    "CNR",
    "meets",
)


def mode_rows(summary: xr.Dataset) -> list[tuple[str, ...]]:
    """One row for every mode, range and group of phases: the worst phase of each figure."""
    low, high = TARGET_PHASES_DEG
    groups = {f"below {low:g}°": summary.phase_deg < low, f"{low:g}–{high:g}°": summary.phase_deg >= low}
    rows = []
    for mode in summary.mode.values:
        for range_m in summary.range_m.values:
            for name, members in groups.items():
                cells = summary.sel(mode=mode, range_m=range_m).isel(phase_deg=np.flatnonzero(members.values))
                if cells.sizes["phase_deg"]:
                    rows.append((str(mode), f"{range_m:g}", name, *_worst(cells)))
    return rows


def _worst(cells: xr.Dataset) -> tuple[str, ...]:
    worst = cells.isel(phase_deg=int(np.argmin(cells.detection.values)))
    return (
        f"{100 * float(worst.detection):.1f}",
        f"{100 * float(worst.detection_low):.1f}–{100 * float(worst.detection_high):.1f}",
        _text(cells.attitude_p95_deg.max(), ".2f"),
        _text(100 * cells.range_p95.max(), ".2f"),
        _text(cells.blobs.min(), ".2f"),
        _text(cells.blob_bias_px.max(), ".2f"),
        _text(cells.corner_bias_px.max(), ".3f"),
        _text(100 * cells.false_positive.max(), ".1f"),
        _text(100 * cells.saturated_fraction.max(), ".0f"),
        _text(cells.cnr.min(), ".0f"),
        f"{int(cells.meets.sum())} of {cells.sizes['phase_deg']}",
    )


def _text(value: xr.DataArray, form: str) -> str:
    return "–" if np.isnan(float(value)) else format(float(value), form)


WHOLE_HEADINGS = ("mode", "absent markers found", "other identities remarked", "searches", "found at most (95 %)")


def whole_rows(whole: xr.Dataset) -> list[tuple[str, ...]]:
    """Mode, finds, remarks, searches and the upper end of the 95 % interval of finds over searches, on whole frames."""
    rows: list[tuple[str, ...]] = []
    for mode in whole.mode.values:
        here = whole.sel(mode=mode)
        found, searches = int(here.found.sum()), int(here.searches.sum())
        remarked = str(int(here.remarked.sum()))
        rows.append(
            (
                str(mode),
                str(found),
                remarked,
                str(searches),
                f"{100 * float(wilson_interval(found, searches)[1]):.1f} %",
            )
        )
    return rows


def widest_interval(summary: xr.Dataset) -> tuple[float, float]:
    """Largest half width of a detection rate's interval: of cells that reach the required rate, and of all."""
    half = (summary.detection_high - summary.detection_low) / 2
    return float(half.where(summary.detection >= 0.99).max()), float(half.max())
