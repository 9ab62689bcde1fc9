"""Figures of pages: drawn, not empty, with quantity and unit; and the check of them notices where they are not.

The check itself (`drawn.check_figure`) runs on every page that any test of experiments/ writes, see conftest.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn import check_figure

from experiments.reporting.figures import new_figure
from experiments.studies.budget.page import page as budget_page
from experiments.thesis.tradeoff import figures as tradeoff_figures
from experiments.thesis.tradeoff.problem import load as load_problem
from experiments.thesis.tradeoff.study import run as run_tradeoff


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"found": 0.0},
        {"budget": {"ranges_m": (3.0,), "illuminations": ("sunlit",), "exposures_s": (1e-3,)}},
        {"budget": {"ranges_m": (1.0, 20.0), "exposures_s": (1 / 30, 1e-3, 1e-5, 1e-6, "auto")}},
    ],
    ids=["plain", "never found", "one of each", "many exposures"],
)
def test_every_figure_of_a_budget_is_drawn_and_labelled(make_budget, case):
    plots = list(budget_page(make_budget(**case)).plots())
    assert len(plots) >= 8
    assert len({plot.key for plot in plots}) == len(plots)
    for plot in plots:
        check_figure(plot.figure, plot.key)
        assert plot.caption


def test_every_figure_of_a_tradeoff_is_drawn_and_labelled():
    found = run_tradeoff(load_problem()).dataset
    for figure in (tradeoff_figures.score_figure(found), tradeoff_figures.weight_figure(found)):
        check_figure(figure)


def _figure(label="range [m]", values=(1.0, 2.0)):
    figure, [[axes]] = new_figure()
    axes.set(xlabel=label, ylabel="SNR [–]")
    if len(values):
        axes.plot(np.arange(len(values)), values)
    return figure


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        (_figure(values=()), "empty"),
        (_figure(values=(np.nan, np.nan)), "empty"),
        (_figure(label="range"), "x axis .* without a unit"),
    ],
    ids=["nothing", "nothing known", "no unit"],
)
def test_a_figure_that_shows_or_says_nothing_is_noticed(figure, said):
    check_figure(_figure())
    with pytest.raises(AssertionError, match=said):
        check_figure(figure, "a figure")


def test_words_along_an_axis_need_no_unit():
    figure, [[axes]] = new_figure()
    axes.bar(["saturation", "smear"], [1.0, 2.0])
    axes.set_ylabel("margin [–]")
    check_figure(figure)


def test_pages_that_tests_write_are_checked(make_budget, tmp_path: Path, monkeypatch):
    page = budget_page(make_budget())
    next(page.plots()).figure.axes[0].set_xlabel("range")
    with pytest.raises(AssertionError, match="budget-snr-eclipse"):
        page.write(tmp_path)
    assert not list(tmp_path.iterdir())
