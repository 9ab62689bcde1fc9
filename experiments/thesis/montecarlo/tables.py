"""Tables of the Monte Carlo study."""

from __future__ import annotations

import numpy as np
import xarray as xr

from experiments.chain.statistics import wilson_interval
from experiments.thesis.montecarlo.errors import QUANTITIES

Rows = list[tuple[str, ...]]
#: The thesis's recipe with its solver, and the study's own.
LISTING = {"recipe": "listing", "solver": "thesis EPnP"}
RIGHT = {"recipe": "right", "solver": "two-start"}


def rate(count: float, total: float) -> str:
    """A proportion in per cent with its 95 % Wilson interval."""
    low, high = wilson_interval(count, total)
    return f"{100 * count / total:.2f} [{100 * float(low):.2f}, {100 * float(high):.2f}]"


def outlier_rows(performance: xr.Dataset) -> Rows:
    """Header, then one row a recipe, layout and solver: outliers over all ranges and at the last, wrong poses by side."""
    header = (
        "recipe",
        "layout",
        "solver",
        "outliers [%], 95 %",
        "at the last range [%]",
        "wrong, front [%]",
        "wrong, back [%]",
        "solves",
        "s",
    )
    rows: Rows = [header]
    for recipe in performance.recipe.values:
        for layout in performance.layout.values:
            for solver in performance.solver.values:
                at = performance.sel(recipe=recipe, layout=layout, solver=solver)
                if np.isnan(at.outliers).all():
                    continue
                total = {
                    name: float(at[name].sum())
                    for name in ("scenes", "scenes_back", "outliers", "wrong", "wrong_back", "seconds")
                }
                last, front = at.isel(range_m=-1), total["scenes"] - total["scenes_back"]
                rows.append(
                    (
                        str(recipe),
                        str(layout),
                        str(solver),
                        rate(total["outliers"], total["scenes"]),
                        rate(float(last.outliers), float(last.scenes)),
                        rate(total["wrong"] - total["wrong_back"], front),
                        rate(total["wrong_back"], total["scenes_back"]) if total["scenes_back"] else "",
                        f"{total['scenes']:.0f}",
                        f"{total['seconds']:.1f}",
                    )
                )
    return rows


def accuracy_rows(performance: xr.Dataset) -> Rows:
    """Header, then mean ± standard deviation of the five errors for each layout, recipe and range."""
    rows: Rows = [("layout", "recipe", "solver", "range [m]", *(f"{q} [{unit}]" for q, unit in QUANTITIES.items()))]
    for layout in performance.layout.values:
        for choice in (LISTING, RIGHT):
            for range_m in performance.range_m.values:
                at = performance.sel({"layout": layout, "range_m": range_m, **choice})
                values = [f"{float(at[f'mean_{q}']):.4f} ± {float(at[f'std_{q}']):.4f}" for q in QUANTITIES]
                rows.append((str(layout), choice["recipe"], choice["solver"], f"{range_m:g}", *values))
    return rows


def tried_rows(tried: xr.Dataset) -> Rows:
    """Header, then each solver's wrong poses of all, and median attitude error, for each layout at both ranges."""
    ranges = tried.range_m.values
    rows: Rows = [("solver", *(f"{layout}, {r:g} m" for layout in tried.layout.values for r in ranges), "µs a solve")]
    for solver in tried.solver.values:
        at = tried.sel(solver=solver)
        cells = []
        for layout in tried.layout.values:
            for r in ranges:
                cell = at.sel(layout=layout, range_m=r)
                known = not np.isnan(cell.wrong)
                cells.append(f"{int(cell.wrong)} / {float(cell.median_attitude_deg):.2f}°" if known else "")
        rows.append((str(solver), *cells, f"{1e6 * float(at.seconds_per_scene.median()):.0f}"))
    return rows


def single_rows(single: xr.Dataset) -> Rows:
    """Header, then for each noise and number of virtual points: wrong poses [%] and median error by range."""
    rows: Rows = [("σ [px]", "virtual points", *(f"{r:g} m" for r in single.range_m.values))]
    for sigma in single.sigma_px.values:
        for points in single.virtual_points.values:
            at = single.sel(sigma_px=sigma, virtual_points=points)
            cells = [
                f"{100 * w / single.attrs['scenes']:.1f} % / {m:.2f}°"
                for w, m in zip(at.wrong.values, at.median_attitude_deg.values, strict=True)
            ]
            rows.append((f"{sigma:g}", str(points), *cells))
    return rows


def noise_rows(noise: xr.Dataset) -> Rows:
    """Header, then outliers of both noise laws at each range [%]."""
    chosen = [
        (law, layout, choice)
        for law in noise.noise.values
        for layout in noise.layout.values
        for choice in (LISTING, RIGHT)
    ]
    rows: Rows = [("noise", "layout", "solver", *(f"{r:g} m" for r in noise.range_m.values))]
    rows += [
        (str(law), "σ [px]", "", *(f"{s:.3f}" for s in noise.sigma_px.sel(noise=law).values))
        for law in noise.noise.values
    ]
    for law, layout, choice in chosen:
        at = noise.sel({"noise": law, "layout": layout, **choice})
        rows.append(
            (str(law), str(layout), choice["solver"], *(f"{v:.2f}" for v in 100 * (at.outliers / at.scenes).values))
        )
    return rows
