"""A validation in few numbers: how many cells agree, the worst differences, the drawn noise, and which cells are outside."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from scipy import stats

from experiments.studies.validate.cells import QUANTITIES
from experiments.studies.validate.study import DIMS, FINE_PX_PER_BIT


def cells_csv(dataset: xr.Dataset) -> str:
    """One line a cell."""
    columns = [f"{name}_{how}" for name in QUANTITIES for how in ("analytic", "rendered", "difference")]
    columns = ["px_per_bit", "exposure_s", *columns, "noise_variance_ratio", "noise_mean_z", "agrees", "reason"]
    frame = dataset[columns].drop_vars("phase_deg").to_dataframe(dim_order=list(DIMS))
    return frame[columns].to_csv(float_format="%.5g", lineterminator="\n")


def outside(dataset: xr.Dataset) -> Iterator[str]:
    """Cells that do not agree, one line each."""
    for index in np.argwhere(~dataset.agrees.values):
        cell = dataset.isel(dict(zip(DIMS, index, strict=True)))
        what = f"differs by {float(cell.worst_difference):.2%}" if cell.noise_agrees else "drawn noise off"
        yield (
            f"{float(cell.range_m):g} m, {float(cell.size_m) * 100:g} cm, {float(cell.tilt_deg):g} deg, "
            f"{cell.illumination.item()}, {cell.sensor.item()}: {what}"
        )


def summary(dataset: xr.Dataset) -> dict[str, float]:
    """How many cells agree, the worst differences on either side of `FINE_PX_PER_BIT`, and the noise against its limits."""
    validated = np.isfinite(dataset.signal_difference)
    result = {"cells": validated.size, "validated": int(validated.sum()), "outside": int((~dataset.agrees).sum())}
    fine = dataset.px_per_bit >= FINE_PX_PER_BIT
    for name in QUANTITIES:
        size = abs(dataset[f"{name}_difference"])
        result[f"{name}_worst_fine"], result[f"{name}_worst_coarse"] = (
            float(size.where(side).max()) for side in (fine, ~fine)
        )
    for quantity in ("signal", "background"):
        known = dataset.remainder.sel(quantity=quantity, source="facets")
        result[f"{quantity}_unexplained"] = float(abs(dataset[f"{quantity}_difference"] - known).max())
    # The variances' scores as a normal variable would have them; pooled over all cells their ratio is 1.
    freedom = dataset.noise_freedom.values
    chi2 = dataset.noise_variance_ratio.values * freedom
    score = stats.norm.isf(np.minimum(stats.chi2.sf(chi2, freedom), stats.chi2.cdf(chi2, freedom)))
    if validated.any():
        result["noise_worst_sigma"] = float(np.nanmax(score))
        result["noise_pooled_ratio"] = float(np.nansum(chi2) / np.nansum(freedom))
        result["noise_pooled_uncertainty"] = float(np.sqrt(2 / np.nansum(freedom)))
    return result
