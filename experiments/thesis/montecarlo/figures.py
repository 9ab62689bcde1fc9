"""Tables and figures of the Monte Carlo study, in the axes of the thesis's figures 3.6, 3.9 to 3.11 and 8.18 to 8.20."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter
from scipy.stats import expon, halfnorm

from experiments.chain.statistics import wilson_interval
from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure, save_svg
from experiments.reporting.files import write_text
from experiments.thesis.montecarlo.errors import QUANTITIES

Rows = list[tuple[str, ...]]
_LISTING = {"recipe": "listing", "solver": "thesis EPnP"}
_RIGHT = {"recipe": "right", "solver": "two-start"}
_THESIS_FIGURE = {"random": "3.6", "wide": "8.18", "narrow": "8.19", "flat": "8.20"}


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
        for choice in (_LISTING, _RIGHT):
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
        for choice in (_LISTING, _RIGHT)
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


def summary_rows(tree: Mapping[str, Any]) -> Rows:
    """The rows for a terminal: outliers of every recipe, layout and solver."""
    return outlier_rows(tree["performance"])


def write_tables(parts: Mapping[str, xr.Dataset], out_dir: Path) -> None:
    """Every table as montecarlo-<name>.csv."""
    tables = {
        "outliers": outlier_rows(parts["performance"]),
        "accuracy": accuracy_rows(parts["performance"]),
        "tried": tried_rows(parts["tried"]),
        "single": single_rows(parts["single"]),
        "noise": noise_rows(parts["noise"]),
    }
    for name, rows in tables.items():
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        write_text(text.getvalue(), out_dir / f"montecarlo-{name}.csv")


def performance_figure(performance: xr.Dataset, layout: str) -> Any:
    """Mean and standard deviation of the five errors and the outlier rate over range, listing beside right."""
    figure, axes = new_figure(2, 3, (7.4, 4.6), sharex=True)
    styles = ((_LISTING, VERMILION, "o", "as listed, thesis EPnP"), (_RIGHT, BLUE, "s", "as meant, two-start"))
    for choice, colour, marker, label in styles:
        at = performance.sel({"layout": layout, **choice})
        for axis, (quantity, unit) in zip(axes.flat, QUANTITIES.items(), strict=False):
            axis.plot(at.range_m, at[f"mean_{quantity}"], color=colour, marker=marker, label=f"{label}: mean")
            axis.plot(at.range_m, at[f"std_{quantity}"], color=colour, ls="--", lw=1, label=f"{label}: st. dev.")
            axis.set_ylabel(f"{quantity} error [{unit}]")
        _rate_line(axes[1, 2], at.range_m.values, at.outliers.values, at.scenes.values, colour, marker, label)
    axes[1, 2].set_ylabel("outliers [%]")
    for axis in axes.flat:
        axis.set_ylim(bottom=0)
    for axis in axes[1]:
        axis.set_xlabel("range [m]")
        axis.set_xticks([1, 5, 10, 15, 20])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    figure.suptitle(f"{layout} points (thesis figure {_THESIS_FIGURE[layout]})", fontsize=9)
    return figure


def _rate_line(
    axis: Any, x: Any, count: Any, total: Any, colour: str, marker: str, label: str, line: str = "-"
) -> None:
    low, high = wilson_interval(count, total)
    percent = 100 * count / total
    bars = np.maximum([percent - 100 * low, 100 * high - percent], 0)
    axis.errorbar(x, percent, yerr=bars, color=colour, marker=marker, ls=line, lw=1.2, elinewidth=0.8, label=label)


def convergence_figure(convergence: xr.Dataset) -> Any:
    """Running mean with ± twice its standard error, and outlier count, over the number of scenes."""
    figure, axes = new_figure(2, 3, (7.4, 4.6), sharex=True)
    number = convergence.scene.values
    for case, colour in zip(convergence.case.values, (VERMILION, BLUE), strict=True):
        at = convergence.sel(case=case)
        kept = np.cumsum(~at.outlier.values)
        for axis, (quantity, unit) in zip(axes.flat, QUANTITIES.items(), strict=False):
            values = np.nan_to_num(at[f"error_{quantity}"].values)
            mean = np.cumsum(values) / np.maximum(kept, 1)
            spread = np.sqrt(np.maximum(np.cumsum(values**2) / np.maximum(kept, 1) - mean**2, 0) / np.maximum(kept, 1))
            # A hundred points are as many as a panel this wide can show.
            thin = slice(20, None, max(len(number) // 100, 1))
            axis.fill_between(
                number[thin], (mean - 2 * spread)[thin], (mean + 2 * spread)[thin], color=colour, alpha=0.2, lw=0
            )
            axis.plot(number[thin], mean[thin], color=colour, label=case)
            axis.set_ylabel(f"mean {quantity} error [{unit}]")
        found = number[at.outlier.values]
        axes[1, 2].step([0, *found, number[-1]], [*range(len(found) + 1), len(found)], where="post", color=colour)
    axes[1, 2].set_ylabel("outliers so far [1]")
    for axis in axes[1]:
        axis.set_xlabel("scenes n [1]")
    for axis in axes[0, 0], axes[0, 1], axes[0, 2]:
        axis.set_ylim(bottom=0)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    figure.suptitle("random points at 20 m, band: ± 2 standard errors (thesis figures 3.9 and 3.10)", fontsize=9)
    return figure


def validation_figure(convergence: xr.Dataset, far: xr.Dataset) -> Any:
    """Distribution of the pitch error at one range, with two laws of the same mean; mean errors out to 100 m."""
    figure, axes = new_figure(1, 2, (7.4, 3.2))
    left, right = axes[0]
    errors = convergence.error_pitch.values[-1]
    errors = errors[~np.isnan(errors)]
    edge = np.linspace(0, np.quantile(errors, 0.995), 41)
    left.hist(errors, edge, density=True, color=BLUE, alpha=0.35, label="as meant, two-start")
    x = np.linspace(0, edge[-1], 200)
    left.plot(x, expon(scale=errors.mean()).pdf(x), color=VERMILION, ls="--", label="exponential, same mean")
    left.plot(x, halfnorm(scale=errors.mean() * np.sqrt(np.pi / 2)).pdf(x), color=BLACK, label="half-normal, same mean")
    left.set_xlabel("absolute pitch error at 20 m [deg]")
    left.set_ylabel("probability density [1/deg]")
    left.legend(fontsize=8)
    for choice, colour, marker in ((_LISTING, VERMILION, "o"), (_RIGHT, BLUE, "s")):
        at = far.sel({"layout": "random", **choice})
        right.loglog(at.range_m, at.mean_pitch, color=colour, marker=marker, label=f"pitch [deg], {choice['solver']}")
        right.loglog(
            at.range_m,
            at.mean_range,
            color=colour,
            marker=marker,
            mfc="none",
            ls="--",
            label=f"range [m], {choice['solver']}",
        )
    right.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100]))
    right.xaxis.set_minor_locator(NullLocator())
    right.xaxis.set_major_formatter(ScalarFormatter())
    right.set_xlabel("range [m]")
    right.set_ylabel("mean error, outliers left out [deg or m]")
    right.legend(fontsize=8)
    return figure


def outlier_figure(performance: xr.Dataset) -> Any:
    """The flat layout's wrong poses: over range, and by the side of the face that is seen."""
    figure, axes = new_figure(1, 2, (7.4, 3.4), gridspec_kw={"width_ratios": [1, 1.25]})
    left, right = axes[0]
    lines = (
        ("listing", "thesis EPnP", "outliers", "as listed, as the listing counts", VERMILION, "o", "-"),
        ("listing", "thesis EPnP", "wrong", "as listed, truly wrong", ORANGE, "^", "--"),
        ("listing", "closed", "wrong", "the same without Gauss-Newton", PURPLE, "v", "-."),
        ("right", "EPnP", "outliers", "as meant, EPnP of the paper (beneath)", GREEN, "D", ":"),
        ("right", "two-start", "outliers", "as meant, two-start", BLUE, "s", "-"),
    )
    for recipe, solver, count, label, colour, marker, style in lines:
        at = performance.sel(recipe=recipe, layout="flat", solver=solver)
        _rate_line(left, at.range_m.values, at[count].values, at.scenes.values, colour, marker, label, style)
    left.axhline(47, color=BLACK, lw=0.8, ls=":")
    left.annotate("printed: 47 %", (1, 41), fontsize=7)
    left.set(xlabel="range [m]", ylabel="poses [%]", ylim=(-3, 103), xticks=[1, 5, 10, 15, 20])
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7)
    solvers = [str(s) for s in performance.solver.values]
    at = performance.sel(recipe="order", layout="flat").sum("range_m")
    place = np.arange(len(solvers))
    front = at.scenes - at.scenes_back
    for shift, count, total, label, colour in (
        (-0.2, at.wrong - at.wrong_back, front, "front seen", BLUE),
        (0.2, at.wrong_back, at.scenes_back, "back seen", ORANGE),
    ):
        percent = (100 * count / total).values
        right.barh(place + shift, percent, 0.38, color=colour, label=label)
        for y, value in zip(place + shift, percent, strict=True):
            right.text(value + 1, y, f"{value:.2f}", va="center", fontsize=7)
    right.set_yticks(place, ["thesis EPnP,\nclosed form" if s == "closed" else s for s in solvers])
    right.invert_yaxis()
    right.grid(axis="y", visible=False)
    right.set(xlabel="wrong poses, the listing's angle order [%]", xlim=(0, 118))
    right.legend(fontsize=8, loc="lower right")
    return figure


def single_figure(single: xr.Dataset) -> Any:
    """Wrong attitudes and median error of one marker over range, by its number of virtual points."""
    figure, axes = new_figure(1, 2, (7.4, 3.2))
    for points, colour, marker in zip(single.virtual_points.values, (VERMILION, BLUE, GREEN), "os^", strict=True):
        for sigma, style in zip(single.sigma_px.values, ("-", "--"), strict=True):
            at = single.sel(virtual_points=points, sigma_px=sigma)
            label = f"{points} virtual, σ = {sigma:g} px"
            total = np.full(len(at.range_m), single.attrs["scenes"])
            _rate_line(axes[0, 0], at.range_m.values, at.wrong.values, total, colour, marker, label, style)
            axes[0, 1].plot(at.range_m, at.median_attitude_deg, color=colour, marker=marker, ls=style, label=label)
    axes[0, 0].set(xlabel="range [m]", ylabel="attitude off by more than 10° [%]")
    axes[0, 1].set(xlabel="range [m]", ylabel="median attitude error [deg]", yscale="log")
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def figures(parts: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    """Every figure by name."""
    drawn = {
        str(layout): performance_figure(parts["performance"], str(layout))
        for layout in parts["performance"].layout.values
    }
    return drawn | {
        "convergence": convergence_figure(parts["convergence"]),
        "validation": validation_figure(parts["convergence"], parts["far"]),
        "outliers": outlier_figure(parts["performance"]),
        "single": single_figure(parts["single"]),
    }


def write_figures(parts: Mapping[str, xr.Dataset], out_dir: Path) -> None:
    """Every figure as montecarlo-<name>.svg."""
    for name, figure in figures(parts).items():
        save_svg(figure, out_dir / f"montecarlo-{name}.svg")
