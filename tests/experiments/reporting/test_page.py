"""One page, written and shown in every way: what stands in it is the same in each."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from rich.console import Console

from experiments.reporting.blocks import Cell, Download, Plot, Plots, Section, Strip, Table
from experiments.reporting.figures import new_figure
from experiments.reporting.page import Page


def _page(**changes: object) -> Page:
    figure, axes = new_figure()
    axes[0, 0].plot([1, 2], [3, 4])
    axes[0, 0].set(xlabel="range [m]", ylabel="SNR [–]")
    table = Table(
        ("range [m]", "closed form", "rendered", "closed form"),
        ((Cell("1"), Cell("5"), Cell("6", passed=True), Cell("7", passed=False)),),
        "Every range",
        (("case", 1), ("SNR", 2), ("CNR", 1)),
        key="ranges",
    )
    blocks = (
        Plots((Plot("curve", figure, "a curve"),)),
        table,
        Download("Save all", "all.csv", "a,b\n1,2\n", key="all"),
        Strip("Pictures of the marker", (), ""),
    )
    sections = (Section("evidence", "Evidence", blocks),)
    return Page("study", "A title", "It closes.", True, "mantis study", sections, **changes)


def test_the_folder_holds_what_the_page_links(tmp_path: Path) -> None:
    page = _page()
    page.write(tmp_path)
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    linked = {"figures/study-curve.svg", "data/study-ranges.csv", "data/study-all.csv"}
    assert found == {"report.html", "study.md", *linked}
    text = (tmp_path / "study.md").read_text(encoding="utf-8")
    assert all(f"]({path})" in text for path in linked)
    assert (tmp_path / "data" / "study-all.csv").read_text(encoding="utf-8") == "a,b\n1,2\n"
    assert "Pictures of the marker: see `report.html`." in text


def test_columns_of_one_heading_are_told_apart_by_their_groups() -> None:
    [table] = _page().tables()
    [row] = list(csv.DictReader(io.StringIO(table.csv())))
    assert row == {"range [m]": "1", "SNR: closed form": "5", "rendered": "6", "CNR: closed form": "7"}
    assert _page().record()["tables"] == {"ranges": [row]}


def test_what_was_judged_is_marked_where_there_are_no_colours() -> None:
    text = _page().markdown()
    assert "| 1 | 5 | ✓ 6 | ✗ 7 |" in text


def test_a_figure_is_drawn_once_for_file_and_page(tmp_path: Path) -> None:
    page = _page()
    [plot] = page.plots()
    page.write(tmp_path)
    assert (tmp_path / "figures" / "study-curve.svg").read_text(encoding="utf-8") == plot.svg
    assert plot.svg is plot.svg
    curve = next(line for line in plot.svg.splitlines() if 'd="M' in line)
    assert curve in page.html()


def test_a_study_may_have_a_view_of_its_own_in_the_terminal() -> None:
    console = Console(width=80, record=True, file=io.StringIO())
    for part in _page(screen=("a view of its own",)).terminal():
        console.print(part)
    assert console.export_text() == "a view of its own\n"
    assert "It closes." in str(_page().terminal()[0])
