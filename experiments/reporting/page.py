"""The page of a study: one object that every study hands over, which is shown in many ways and written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from experiments.reporting.blocks import Block, Bullets, Card, Details, Download, Plot, Plots, Section, Table
from experiments.reporting.files import write_netcdf, write_text
from experiments.reporting.html import render
from experiments.reporting.markdown import escaped, markdown, table_file
from experiments.reporting.plain import plain
from experiments.reporting.sections import assumptions, footer, made_by, reproduction, versions_text
from experiments.scenario import Scenario

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True)
class Page:
    """What a study says: headline, findings, sections of blocks, limits, and what made it.

    Attributes:
        study: the verb that makes it, say 'glare'.
        title: what was looked at.
        headline: the answer in one sentence.
        passed: its colour and mark; None where there is nothing to pass.
        command: the command line that makes it again.
        sections: the evidence, in the order in which it is read.
        findings: what was found or would help, a sentence each; a word and a colon at the start are set bold.
        findings_title: their heading in the browser.
        cards: parts of the verdict in a few large words.
        about: paragraphs that say what is asked and how it is answered.
        limits: assumptions and what is not modelled.
        scenario: of the system that is looked at; None where there is none.
        data: the labelled result, written as ``STEM.nc``; its attributes say what made it, and with which seed.
        stem: name of the files; default the study's.
        unmet: for each `--require` condition that the result does not meet, why.
        extra: further plain data for `--json`.
        files: further text files, by path within the folder.
        screen: what the terminal shows instead of headline, findings and tables, where a study has a view of its own.
    """

    study: str
    title: str
    headline: str
    passed: bool | None
    command: str
    sections: tuple[Section, ...]
    findings: tuple[str, ...] = ()
    findings_title: str = "Findings"
    cards: tuple[Card, ...] = ()
    about: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    scenario: Scenario | None = None
    data: xr.Dataset | xr.DataTree | None = None
    stem: str = ""
    unmet: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    screen: tuple[RenderableType, ...] = ()

    @property
    def name(self) -> str:
        """Name of the page's files."""
        return self.stem or self.study

    def blocks(self) -> Iterator[Block]:
        """Every block of the sections, those that a click unfolds included."""
        for section in self.sections:
            yield from _unfolded(section.blocks)

    def tables(self) -> Iterator[Table]:
        """Tables that are written to files of their own."""
        yield from (block for block in self.blocks() if isinstance(block, Table) and block.key is not None)

    def plots(self) -> Iterator[Plot]:
        """Every plot."""
        yield from (plot for block in self.blocks() if isinstance(block, Plots) for plot in block.plots)

    def terminal(self) -> list[RenderableType]:
        """Headline, findings and the tables meant for it, for a `rich` console."""
        from rich.text import Text

        from experiments.reporting.terminal import text_table

        if self.screen:
            return list(self.screen)
        lines: list[RenderableType] = [Text(self.headline, style="bold")]
        lines += [Text(f"→ {finding}") for finding in self.findings]
        return lines + [text_table(block) for block in self.blocks() if isinstance(block, Table) and block.terminal]

    def record(self) -> dict[str, Any]:
        """Headline, findings and tables as plain data for `--json`."""
        tables = {
            table.key or self.name: [
                dict(zip(table.names, (cell.text for cell in row), strict=True)) for row in table.rows
            ]
            for table in self.tables()
        }
        record = {"headline": self.headline, "passed": self.passed, "findings": list(self.findings), "tables": tables}
        return plain({**record, **self.extra})

    def markdown(self) -> str:
        """The page as Markdown; figures and long tables are linked as `write` names them."""
        parts = [f"# {escaped(self.title)}", f"**{escaped(self.headline)}**"]
        parts += ["\n".join(f"- {escaped(finding)}" for finding in self.findings)] if self.findings else []
        parts += [*map(escaped, self.about), f"Made by `{self.command}`; every number here comes from that run."]
        for section in self.sections:
            shown = [text for block in section.blocks for text in markdown(block, self.name)]
            parts += [f"## {escaped(section.title)}", *shown] if shown else []
        if self.limits:
            parts += ["## Assumptions and limits", "\n".join(f"- {escaped(limit)}" for limit in self.limits)]
        return "\n\n".join(parts) + "\n"

    def html(self) -> str:
        """The page as one HTML text that loads nothing from elsewhere; the same for the same page."""
        attributes = {} if self.data is None else {str(key): value for key, value in self.data.attrs.items()}
        versions = versions_text("numpy", "mitsuba", "opencv-python-headless")
        blocks: list[Block] = [Bullets(self.limits)] if self.limits else []
        if self.scenario is not None:
            blocks += assumptions(self.scenario)
        if self.scenario is not None and "scenario_hash" in attributes:
            again, foot = list(reproduction(self.scenario, attributes, self.command)), footer(attributes)
        else:
            hashes = {} if self.scenario is None else {"Scenario": self.scenario.digest()}
            seed = int(float(attributes["seed"])) if "seed" in attributes else None
            seed = seed if self.scenario is None else self.scenario.seed
            again, foot = list(made_by(self.command, seed, hashes, versions)), versions
        return render(self, blocks, again, foot)

    def write(self, out: Path) -> None:
        """Write dataset, tables, figures and pages into a folder, each whole or not at all."""
        if self.data is not None:
            write_netcdf(self.data, out / f"{self.name}.nc")
        for table in self.tables():
            write_text(table.csv(), out / table_file(table, self.name))
        for plot in self.plots():
            write_text(plot.svg, out / "figures" / f"{self.name}-{plot.key}.svg")
        for download in self.blocks():
            if isinstance(download, Download) and download.key is not None:
                write_text(download.text, out / table_file(download, self.name))
        for path, text in self.files.items():
            write_text(text, out / path)
        write_text(self.markdown(), out / f"{self.name}.md")
        write_text(self.html(), out / "report.html")


def _unfolded(blocks: tuple[Block, ...]) -> Iterator[Block]:
    for block in blocks:
        yield block
        if isinstance(block, Details):
            yield from _unfolded(block.blocks)
