"""Statements of the thesis held against this project: printed, reproduced, right; as rows, CSV, and the page of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure as Plot

from experiments.reporting.figures import save_svg
from experiments.reporting.files import write_netcdf, write_text
from experiments.reporting.formatting import number
from experiments.reporting.html import (
    Block,
    Bullets,
    Cell,
    Figures,
    Report,
    Section,
    Table,
    csv_text,
    figure,
    render,
    text_table,
)
from experiments.reporting.sections import assumptions, made_by, versions_text
from experiments.scenario import Scenario
from scenes.atomic import atomic_write

Rows = Sequence[Sequence[object]]

HEADINGS = ("where", "what", "unit", "printed", "reproduced", "right", "remark")


@dataclass(frozen=True)
class Statement:
    """One thing the thesis states.

    Attributes:
        where: section, equation, table or listing.
        what: the quantity.
        unit: of all three values.
        printed: as printed; empty where the thesis leaves it open.
        reproduced: by the thesis's own recipe; NaN where there is none.
        right: by this project.
        remark: why they differ.
    """

    where: str
    what: str
    unit: str
    printed: str
    reproduced: float
    right: float
    remark: str = ""

    @property
    def agrees(self) -> bool | None:
        """Whether the right value, rounded to the printed digits, gives the printed number; None where it is no number."""
        text = self.printed.replace("−", "-")
        try:
            printed = float(text)
        except ValueError:
            return None
        decimals = len(text.partition(".")[2])
        return bool(abs(printed - self.right) <= 0.5 * 10.0**-decimals * (1 + 1e-9))

    @property
    def cells(self) -> tuple[str, ...]:
        """Texts under `HEADINGS`."""
        values = (number(self.reproduced), number(self.right))
        return (self.where, self.what, self.unit, self.printed or "–", *values, self.remark)


def statement_rows(statements: Sequence[Statement]) -> list[tuple[str, ...]]:
    """Heading, then one row a statement."""
    return [HEADINGS, *(s.cells for s in statements)]


def statement_csv(statements: Sequence[Statement]) -> str:
    """The statements as CSV, numbers with six significant digits."""

    def text(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.6g}"

    columns = {name: [getattr(s, name) for s in statements] for name in ("where", "what", "unit", "printed")}
    return csv_text(
        {
            **columns,
            "reproduced": [text(s.reproduced) for s in statements],
            "right": [text(s.right) for s in statements],
            "remark": [s.remark for s in statements],
        }
    )


def statement_table(statements: Sequence[Statement]) -> Table:
    """The statements as a table of a report; the printed cell is marked where it can be judged."""
    rows = []
    for statement in statements:
        style = {"where": "left", "what": "left", "remark": "left"}
        cells = [Cell(text, style=style.get(name, "")) for name, text in zip(HEADINGS, statement.cells, strict=True)]
        cells[3] = Cell(cells[3].text, passed=statement.agrees)
        rows.append(tuple(cells))
    return Table(HEADINGS, tuple(rows), "Printed, reproduced by the thesis's own recipe, and right")


def markdown_table(rows: Rows) -> str:
    """Heading and rows as a table of Markdown."""
    head, *lines = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *lines))


_STATEMENTS = (
    "*Printed* is what the thesis states, empty where it leaves the number open; *reproduced* follows its own "
    "recipe, *right* is what "
    "this project finds."
)


@dataclass(frozen=True)
class StudyPage:
    """What a study of the thesis hands over to be written.

    Attributes:
        name: of its files: NAME.nc, NAME.md, data/NAME-*.csv, figures/NAME-*.svg.
        title, headline, passed: of the report.
        about: paragraphs that say what is asked and how it is answered, for the page in words.
        answers: what was found, a sentence each.
        statements: printed, reproduced, right.
        tables: heading and rows by the name of their file; those in `short` stand in the page in words, the others are linked.
        table_captions: by the same names.
        plots: figures by the name of their file, without the study's.
        captions: of the figures, by the same names.
        limits: assumptions and what is not modelled.
        command: that makes it again.
        scenario: of the system that is looked at; None where there is none.
    """

    name: str
    title: str
    headline: str
    passed: bool
    answers: Sequence[str]
    statements: Sequence[Statement]
    tables: Mapping[str, Rows]
    table_captions: Mapping[str, str]
    plots: Mapping[str, Plot]
    captions: Mapping[str, str]
    limits: Sequence[str]
    command: str
    scenario: Scenario | None = None
    about: Sequence[str] = ()
    short: Sequence[str] = ()

    def markdown(self) -> str:
        """The page in words: what was found, printed against right, figures, short tables, limits."""
        parts = [f"# {self.title}", *self.about, f"Made by `{self.command}`; every number here comes from that run."]
        parts += [f"**{self.headline}**", "\n".join(f"- {answer}" for answer in self.answers)]
        if self.statements:
            parts += ["## Printed, reproduced, right", _STATEMENTS, markdown_table(statement_rows(self.statements))]
            parts.append(f"The same as a file: [`data/{self.name}.csv`](data/{self.name}.csv).")
        parts.append("## Figures")
        for key in self.plots:
            parts.append(f"![{self.captions[key]}](figures/{self.name}-{key}.svg)")
            parts.append(f"*{self.captions[key]}.*")
        parts.append("## Tables")
        for key, rows in self.tables.items():
            path = f"data/{self.name}-{key}.csv"
            parts.append(f"{self.table_captions[key]}: [`{path}`]({path}).")
            if key in self.short:
                parts.append(markdown_table(rows))
        parts += ["## Assumptions and limits", "\n".join(f"- {limit}" for limit in self.limits)]
        return "\n\n".join(parts) + "\n"

    def html(self) -> str:
        """The page as one HTML text."""
        pictures: list[Block] = [
            Figures((figure(plot, f"{self.name}-{key}", self.captions[key]),), self.captions[key] + ".")
            for key, plot in self.plots.items()
        ]
        tables: list[Block] = [
            text_table([[str(cell) for cell in row] for row in rows], self.table_captions[key])
            for key, rows in self.tables.items()
        ]
        said = statement_table(self.statements)
        evidence = [Section("statements", "Printed, reproduced, right", (said,), wordy=True)] if said.rows else []
        evidence += [
            Section("figures", "Figures", tuple(pictures)),
            Section("tables", "Tables", tuple(tables), wordy=True),
        ]
        versions = versions_text("numpy", "mitsuba", "opencv-python-headless")
        scenario, hashes = self.scenario, {}
        blocks: list[Block] = [Bullets(tuple(self.limits))]
        if scenario is not None:
            blocks += assumptions(scenario)
            hashes = {"Scenario": scenario.digest()}
        again = made_by(self.command, None if scenario is None else scenario.seed, hashes, versions)
        return render(
            Report(
                self.title, f"Mantis {self.name}", self.headline, self.passed, (), tuple(self.answers), tuple(evidence),
                tuple(blocks), tuple(again), versions,
            )
        )  # fmt: skip

    def write(self, out: Path, data: xr.Dataset | xr.DataTree) -> None:
        """Write dataset, page, tables and figures into a folder, each whole or not at all."""
        if isinstance(data, xr.Dataset):
            write_netcdf(data, out / f"{self.name}.nc")
        else:
            with atomic_write(out / f"{self.name}.nc") as temporary:
                data.to_netcdf(temporary, engine="h5netcdf")
        if self.statements:
            write_text(statement_csv(self.statements), out / "data" / f"{self.name}.csv")
        for key, rows in self.tables.items():
            columns = zip(*rows[1:], strict=True)
            text = csv_text(dict(zip(map(str, rows[0]), columns, strict=True)))
            write_text(text, out / "data" / f"{self.name}-{key}.csv")
        for key, plot in self.plots.items():
            save_svg(plot, out / "figures" / f"{self.name}-{key}.svg")
        write_text(self.markdown(), out / f"{self.name}.md")
        write_text(self.html(), out / "report.html")
