"""Claims of the thesis: what agrees, and what a page that holds them writes."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.figures import new_figure
from experiments.reporting.page import Page
from experiments.thesis.claims import HEADINGS, Claim, claims_section, claims_table


def claim(printed: str, right: float) -> Claim:
    return Claim(
        where="eq. 1",
        what="a length",
        unit="m",
        printed=printed,
        reproduced=float("nan"),
        right=right,
        remark="for once",
    )


@pytest.mark.parametrize(
    ("printed", "right", "agrees"),
    [
        ("1.2", 1.19, True),
        ("1.2", 1.26, False),
        ("26.6", 26.565, True),
        ("26.6", 26.549, False),
        ("8", 0.0, False),
        ("−3", -3.2, True),
        ("", 1.0, None),
        ("about 3", 3.0, None),
    ],
)
def test_a_number_agrees_when_it_rounds_to_the_printed_digits(printed: str, right: float, agrees: bool | None) -> None:
    assert claim(printed, right).agrees is agrees


def test_rows_have_a_cell_for_every_heading() -> None:
    table = claims_table([claim("", 1234.5)])
    assert table.headings == HEADINGS
    assert tuple(cell.text for cell in table.rows[0]) == ("eq. 1", "a length", "m", "–", "–", "1,230", "for once")


def test_a_page_writes_its_files_and_marks_what_differs(tmp_path: Path) -> None:
    plot, axes = new_figure()
    axes[0, 0].plot([0, 1], [0, 1])
    axes[0, 0].set(xlabel="place [m]", ylabel="height [m]")
    sections = (
        claims_section([claim("1.2", 1.19), claim("2", 3.0)]),
        Section("line", "A line", (Plots((Plot("line", plot, "A line"),)),)),
        Section("rows", "Rows", (text_table([("a", "b"), ("1", "x, y")], "Rows", key="rows"),)),
    )

    def page(data: xr.Dataset | xr.DataTree) -> Page:
        return Page(
            study="probe",
            title="A <title>",
            headline="One of two agrees.",
            passed=False,
            command="mantis probe",
            sections=sections,
            findings=("So it is.",),
            limits=("none",),
            data=data,
        )

    page(xr.Dataset({"value": ("x", np.arange(3.0))})).write(tmp_path)
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "A &lt;title&gt;" in html
    assert html.count("✗") >= 1
    assert html.count("✓") >= 1
    with (tmp_path / "data" / "probe-rows.csv").open(encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["a", "b"], ["1", "x, y"]]
    with (tmp_path / "data" / "probe.csv").open(encoding="utf-8") as file:
        header, first, second = list(csv.reader(file))
    assert tuple(header) == HEADINGS
    assert first == ["eq. 1", "a length", "m", "1.2", "", "1.19", "for once"]
    assert second[5] == "3"
    assert (tmp_path / "figures" / "probe-line.svg").stat().st_size > 0
    with xr.open_dataset(tmp_path / "probe.nc", engine="h5netcdf") as stored:
        assert stored.value.values.tolist() == [0, 1, 2]
    tree = xr.DataTree.from_dict({"part": xr.Dataset({"value": ("x", np.arange(2.0))})})
    page(tree).write(tmp_path / "tree")
    with xr.open_datatree(tmp_path / "tree" / "probe.nc", engine="h5netcdf") as stored_tree:
        assert stored_tree["part"].value.values.tolist() == [0, 1]
