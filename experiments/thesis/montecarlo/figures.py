"""Figures of the Monte Carlo study, in the axes of the thesis's figures 3.6, 3.9 to 3.11 and 8.18 to 8.20."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter
from scipy.stats import expon, halfnorm

from experiments.chain.statistics import wilson_interval
from experiments.reporting.figures import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure
from experiments.thesis.montecarlo.errors import QUANTITIES
from experiments.thesis.montecarlo.tables import LISTING, RIGHT

_THESIS_FIGURE = {"random": "3.6", "wide": "8.18", "narrow": "8.19", "flat": "8.20"}


def performance_figure(performance: xr.Dataset, layout: str) -> Any:
    """Mean and standard deviation of the five errors and the outlier rate over range, listing beside right."""
    figure, axes = new_figure(2, 3, (7.4, 4.6), sharex=True)
    styles = ((LISTING, VERMILION, "o", "as listed, thesis EPnP"), (RIGHT, BLUE, "s", "as meant, two-start"))
    for choice, colour, marker, label in styles:
        at = performance.sel({"layout": layout, **choice})
        for axis, (quantity, unit) in zip(axes.flat, QUANTITIES.items(), strict=False):
            axis.plot(at.range_m, at[f"mean_{quantity}"], color=colour, marker=marker, label=f"{label}: mean")
            axis.plot(at.range_m, at[f"std_{quantity}"], color=colour, ls="--", lw=1, label=f"{label}: st. dev.")
            axis.set_ylabel(f"{quantity} error [{unit}]")
        _rate_line(
            axes[1, 2],
            at.range_m.values,
            count=at.outliers.values,
            total=at.scenes.values,
            colour=colour,
            marker=marker,
            label=label,
        )
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
    axis: Any, x: Any, count: Any, total: Any, *, colour: str, marker: str, label: str, line: str = "-"
) -> None:
    """Percentage of counts with its interval over x."""
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
    for choice, colour, marker in ((LISTING, VERMILION, "o"), (RIGHT, BLUE, "s")):
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
        _rate_line(
            left,
            at.range_m.values,
            count=at[count].values,
            total=at.scenes.values,
            colour=colour,
            marker=marker,
            label=label,
            line=style,
        )
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
            _rate_line(
                axes[0, 0],
                at.range_m.values,
                count=at.wrong.values,
                total=total,
                colour=colour,
                marker=marker,
                label=label,
                line=style,
            )
            axes[0, 1].plot(at.range_m, at.median_attitude_deg, color=colour, marker=marker, ls=style, label=label)
    axes[0, 0].set(xlabel="range [m]", ylabel="attitude off by more than 10° [%]")
    axes[0, 1].set(xlabel="range [m]", ylabel="median attitude error [deg]", yscale="log")
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure
