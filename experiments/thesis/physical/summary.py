"""What the laboratory's frames come to: yaw of each pass, and the failures of thesis section 8.3."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import xarray as xr

from experiments.chain.statistics import root_mean_square
from experiments.reporting.formatting import number
from experiments.scenario import Scenario
from experiments.studies.shared import failures
from experiments.studies.shared.calibrations import CAMERA_PARAMETERS
from experiments.thesis.physical.camera import Calibrated
from experiments.thesis.physical.methods import METHODS
from experiments.thesis.physical.study import NEAR_PHASE_DEG
from experiments.thesis.virtual.summary import FRONTAL_DEG, OUTLIER_DEG, OUTLIER_RANGE

Row = tuple[str, ...]

#: The dimensions of one run's frames.
FRAMES = ("passing", "way", "step")
PASS_HEADINGS: Row = (
    "illumination",
    "frames",
    "method",
    "pass",
    "height [m]",
    "frames in all",
    "found [%]",
    "virtual point [%]",
    "yaw rms [°]",
    "yaw rms, frontal [°]",
    "largest [°]",
    "outliers",
)
ILLUMINATION_NAMES = {"eclipse": "eclipse", "sunlit": "halogen"}


def series(frames: xr.Dataset, illumination: str, scale: str, by: str) -> xr.Dataset:
    """One method's frames of a run, over `FRAMES`."""
    return frames.sel(illumination=illumination, scale=scale, by=by)


def outliers(frames: xr.Dataset) -> xr.DataArray:
    """Whether a frame's pose is off by more than 10° or a twentieth of the range."""
    return (frames.attitude_error_deg > OUTLIER_DEG) | (np.abs(frames.range_error_m) > OUTLIER_RANGE * frames.range_m)


def frontal(frames: xr.Dataset) -> xr.DataArray:
    """Stations whose yaw is within `FRONTAL_DEG` of frontal."""
    return np.abs(frames.true_yaw_deg) <= FRONTAL_DEG


def beside(frames: xr.Dataset) -> xr.DataArray:
    """Stations at which the lamp stands beside the camera."""
    return frames.lamp_phase_deg <= NEAR_PHASE_DEG


def rms(values: xr.DataArray) -> float:
    """Root mean square of what is known; NaN where nothing is."""
    return root_mean_square(values.values)


def mean(values: xr.DataArray, where: xr.DataArray | None = None) -> float:
    """Mean of what is known, of some frames; NaN where nothing is."""
    chosen = values if where is None else values.where(where)
    known = chosen.values[np.isfinite(chosen.values)]
    return float(np.mean(known)) if len(known) else float("nan")


def _cells(frames: xr.Dataset) -> Iterator[tuple[Row, xr.Dataset]]:
    for illumination, scale, by in product(frames.illumination.values, frames.scale.values, frames.by.values):
        here = series(frames, illumination, scale, by)
        if np.isfinite(here.found).any():  # pairs are taken under the lamp alone
            yield (ILLUMINATION_NAMES[str(illumination)], str(scale), METHODS[str(by)]), here


def pass_rows(frames: xr.Dataset) -> list[Row]:
    """`PASS_HEADINGS`, then one row a run, method and pass."""
    rows = [PASS_HEADINGS]
    for names, whole in _cells(frames):
        for passing in whole.passing.values:
            here = whole.sel(passing=passing)
            error = here.yaw_error_deg
            largest = np.abs(error.values[np.isfinite(error.values)])
            rows.append(
                (
                    *names,
                    str(passing),
                    f"{float(here.height_m):g}",
                    str(here.found.size),
                    f"{100 * mean(here.found):.1f}",
                    f"{100 * mean(here.virtual):.1f}",
                    number(rms(error)),
                    number(rms(error.where(frontal(here)))),
                    number(float(largest.max()) if len(largest) else np.nan),
                    str(int(outliers(here).sum())),
                )
            )
    return rows


def failure_rows(frames: xr.Dataset) -> list[Row]:
    """Frames with each failure mode, a row a run and method, and the median errors with and without it."""
    rows: list[Row] = [("illumination", "frames", "method", "frames in all", *failures.HEADINGS)]
    for names, here in _cells(frames):
        failed = {name: None if np.isnan(here[name].values).all() else here[name].values > 0 for name in failures.MODES}
        off = (here.range_error_m / here.range_m).transpose(*here.found.dims)
        rows.append((*names, str(here.found.size), *failures.cells(failed, here.attitude_error_deg.values, off.values)))
    return rows


def camera_rows(camera: Calibrated, scenario: Scenario) -> list[Row]:
    """Intrinsics: true, by listing A.3's steps, and by this project's corners, each with its standard deviation."""
    real = scenario.camera
    truth = [*real.focal_px, *real.principal_point_px, real.k1, real.k2, real.p1, real.p2]
    rows: list[Row] = [("quantity", "unit", "true", "listing A.3", "±", "this project", "±")]
    found = [([*c.focal_px, *c.principal_point_px, *c.distortion[:4]], c.sigma) for c in (camera.listing, camera.found)]
    for k, (name, true) in enumerate(zip(CAMERA_PARAMETERS, truth, strict=True)):
        digits = ".2f" if k < 4 else ".5f"
        cells = [format(float(v), digits) for values, sigma in found for v in (values[k], sigma[k])]
        rows.append((name, "px" if k < 4 else "1", format(float(true), digits), *cells))
    listing, own = f"{camera.listing_rms_px:.3f}", f"{camera.found.rms_px:.3f}"
    rows.append(("corners off their places, rms", "px", "0", listing, "–", own, "–"))
    return rows


def level_rows(levels: xr.Dataset) -> list[Row]:
    """Mean number of blobs found of four over the lamp's level, with the lamp beside the camera and aside."""
    rows: list[Row] = [("level over the lamp's", "lamp", *(METHODS[str(b)] for b in levels.by.values))]
    for level, near in product(levels.level.values, levels.near.values):
        blobs = [float(levels.blobs.sel(level=level, near=near, by=b)) for b in levels.by.values]
        rows.append((f"{level:g}", "beside the camera" if near else "aside", *(f"{b:.2f}" for b in blobs)))
    return rows


def sharpness_rows(sharpness: xr.Dataset) -> list[Row]:
    """Blobs found of four, squarely before the camera, over the lens's point spread."""
    rows: list[Row] = [("point spread [px]", *(METHODS[str(b)] for b in sharpness.by.values))]
    for spread in sharpness.psf_sigma_px.values:
        at = sharpness.blobs.sel(psf_sigma_px=spread)
        rows.append((f"{spread:g}", *(f"{float(at.sel(by=b)):.0f}" for b in sharpness.by.values)))
    return rows
