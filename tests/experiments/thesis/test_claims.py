"""Statements of the thesis: what agrees, and what a page of a study writes."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.reporting.claims import HEADINGS, Statement, StudyPage, statement_rows
from experiments.reporting.figures import new_figure


def statement(printed: str, right: float) -> Statement:
    return Statement("eq. 1", "a length", "m", printed, float("nan"), right, "for once")


@pytest.mark.parametrize(
    ("printed", "right", "agrees"),
    [("1.2", 1.19, True), ("1.2", 1.26, False), ("26.6", 26.565, True), ("26.6", 26.549, False), ("8", 0.0, False),
     ("−3", -3.2, True), ("", 1.0, None), ("about 3", 3.0, None)],
)  # fmt: skip
def test_a_number_agrees_when_it_rounds_to_the_printed_digits(printed: str, right: float, agrees: bool | None) -> None:
    assert statement(printed, right).agrees is agrees


def test_rows_have_a_cell_for_every_heading() -> None:
    header, row = statement_rows([statement("", 1234.5)])
    assert header == HEADINGS
    assert row == ("eq. 1", "a length", "m", "–", "–", "1,230", "for once")


def test_a_page_writes_its_files_and_marks_what_differs(tmp_path: Path) -> None:
    plot, axes = new_figure()
    axes[0, 0].plot([0, 1], [0, 1])
    page = StudyPage(
        "probe", "A <title>", "One of two agrees.", False, ["So it is."], [statement("1.2", 1.19), statement("2", 3.0)],
        {"rows": [("a", "b"), ("1", "x, y")]}, {"rows": "Rows"}, {"line": plot}, {"line": "A line"}, ["none"], "mantis probe",
    )  # fmt: skip
    page.write(tmp_path, xr.Dataset({"value": ("x", np.arange(3.0))}))
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in html
    assert html.count("✗") >= 1
    assert html.count("✓") >= 1
    with (tmp_path / "data" / "probe-rows.csv").open(encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["a", "b"], ["1", "x, y"]]
    assert (tmp_path / "figures" / "probe-line.svg").stat().st_size > 0
    with xr.open_dataset(tmp_path / "probe.nc", engine="h5netcdf") as stored:
        assert stored.value.values.tolist() == [0, 1, 2]
    tree = xr.DataTree.from_dict({"part": xr.Dataset({"value": ("x", np.arange(2.0))})})
    page.write(tmp_path / "tree", tree)
    with xr.open_datatree(tmp_path / "tree" / "probe.nc", engine="h5netcdf") as stored_tree:
        assert stored_tree["part"].value.values.tolist() == [0, 1]
