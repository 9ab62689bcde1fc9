"""What `mantis validate` prints and writes as text: every cell, agreement by quantity, the drawn noise, and the cross-checks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from rich.table import Table
from scipy import stats

from experiments.studies.validate.crosscheck import Agreement
from experiments.studies.validate.study import (
    COARSE_TOLERANCE,
    CONFIDENCE,
    DIMS,
    FINE_PX_PER_BIT,
    FINE_TOLERANCE,
    QUANTITIES,
)


def tables(dataset: xr.Dataset, checks: list[Agreement], indirect: dict[str, float]) -> list[Table | str]:
    """Tables and lines for the console."""
    facts = summary(dataset)
    by_quantity = Table(title="Largest difference, rendered against closed form")
    by_quantity.add_column("Quantity")
    by_quantity.add_column(f"≥ {FINE_PX_PER_BIT:g} px/bit (allowed {FINE_TOLERANCE:.0%})", justify="right")
    by_quantity.add_column(f"below (allowed {COARSE_TOLERANCE:.0%})", justify="right")
    for name in QUANTITIES:
        by_quantity.add_row(name, *(f"{facts[f'{name}_worst_{side}']:.3%}" for side in ("fine", "coarse")))
    crosschecks = Table(title="Cross-checks")
    for heading in ("Quantity", "By", "Difference", "Uncertainty"):
        crosschecks.add_column(heading, justify="right" if heading[0] in "DU" else "left")
    for check in checks:
        crosschecks.add_row(check.what, check.by, f"{check.difference:+.1e}", f"{check.uncertainty:.0e}")
    for part, gain in indirect.items():
        crosschecks.add_row(f"indirect light, {part}", "Mitsuba path, 4 against 2 segments", f"{gain:+.1e}", "")
    cells = facts["validated"]
    lines = [
        f"{cells - facts['outside']:.0f} of {cells:.0f} cells agree ({facts['cells'] - cells:.0f} are not in the frame).",
        f"What facets and sub-pixels do not explain: {facts['signal_unexplained']:.2%} of the signal, "
        f"{facts['background_unexplained']:.2%} of the background at most.",
    ]
    if cells:
        lines.append(
            f"Noise: variance over {dataset.attrs['draws']} draws is {facts['noise_pooled_ratio']:.4f} ± "
            f"{facts['noise_pooled_uncertainty']:.4f} times the closed form's; "
            f"worst cell at {facts['noise_worst_sigma']:.1f} sigma, all held together at {CONFIDENCE:.1%}."
        )
    return [by_quantity, *lines, *list(outside(dataset))[:10], crosschecks]


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
