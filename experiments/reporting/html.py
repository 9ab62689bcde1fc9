"""Self-contained HTML reports, shared by every study: verdict, evidence, assumptions with sources, how to make it again.

How a study writes one::

    from experiments.reporting.html import Card, Cell, Figures, Report, Section, Table, Text, figure, render
    from experiments.reporting.sections import assumptions, reproduction

    report = Report(
        title=scenario.title,                     # what was looked at
        study="Mantis glare",                     # which study this is; names the files that the page saves
        headline="One sentence: the verdict.",
        passed=True,                              # its colour and mark; None where there is nothing to pass
        cards=(Card("eclipse", "1–10 m", "closes with automatic exposure", ("sampling fails beyond",), True),),
        advice=("Lens: 39 mm closes 20 m.",),     # what follows; a word and a colon at the start are set bold
        evidence=(Section("maps", "Where the Sun may stand", (Text(("…",)), Figures((figure(plot, "map", "caption"),)))),),
        assumptions=tuple(assumptions(scenario)),
        reproduction=tuple(reproduction(scenario, dataset.attrs, "mantis glare --quick")),
    )
    write_text(render(report), out / "report.html")

The order of the four parts is the page's own; a study cannot change it. A study without a scenario makes its last two parts
from any blocks and `report_sections.made_by`. Blocks are `Text`, `Bullets`, `Figures`, `Strip`, `Table`, `Download`, `Code` and
`Details`. Every table can be sorted by a click on a heading and saved as CSV; give numbers as ``Cell(text, order=value)``, so
that both go by the full number. Draw figures with `experiments.reporting.figures` (its palette, its fonts), each axis with quantity and
unit.

A report is plain data; `render` puts it into `templates/report.html`, which escapes every text. Only `svg` fields go in as they
are: they must come from `figure` or from code that escapes for itself.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import ClassVar

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure as Plot

from experiments.reporting.figures import svg_text


@dataclass(frozen=True)
class Text:
    """Paragraphs."""

    kind: ClassVar[str] = "text"
    paragraphs: tuple[str, ...]


@dataclass(frozen=True)
class Bullets:
    """A list."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]


@dataclass(frozen=True)
class Figure:
    """A drawing and what it shows."""

    svg: Markup
    caption: str


@dataclass(frozen=True)
class Figures:
    """Drawings side by side where the page is wide enough, else one below the other, with one caption."""

    kind: ClassVar[str] = "figures"
    figures: tuple[Figure, ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A camera picture with its heading, caption lines and, where it was judged, whether all is well."""

    svg: Markup
    heading: str
    lines: tuple[str, ...]
    passed: bool | None = None


@dataclass(frozen=True)
class Strip:
    """Columns of pictures that scroll sideways."""

    kind: ClassVar[str] = "strip"
    label: str
    columns: tuple[tuple[str, tuple[Picture, ...]], ...]
    legend: Markup


@dataclass(frozen=True)
class Cell:
    """A table cell: text, what to sort by, whether it passes (a mark and a colour) or is not judged, and a style.

    `style` is a class of the template: 'left' (aligned so) or 'flagged' (highlighted).
    """

    text: str
    order: float | str | None = None
    passed: bool | None = None
    style: str = ""


@dataclass(frozen=True)
class Download:
    """A file that the page can save."""

    kind: ClassVar[str] = "download"
    label: str
    filename: str
    text: str


@dataclass(frozen=True)
class Table:
    """Rows under headings; `groups` spans the headings as (text, columns). Saved as CSV, sorted by a click where `sortable`."""

    kind: ClassVar[str] = "table"
    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    groups: tuple[tuple[str, int], ...] = ()
    sortable: bool = True
    compact: bool = False


@dataclass(frozen=True)
class Code:
    """Text to copy, as it is."""

    kind: ClassVar[str] = "code"
    text: str


@dataclass(frozen=True)
class Details:
    """Blocks that a click unfolds; unfolded on paper where `printed`."""

    kind: ClassVar[str] = "details"
    summary: str
    blocks: tuple[Block, ...]
    printed: bool = False


Block = Text | Bullets | Figures | Strip | Download | Table | Code | Details


@dataclass(frozen=True)
class Section:
    """A heading, the anchor it is reached by, and blocks; `wordy` where its tables hold sentences, not numbers."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    wordy: bool = False


@dataclass(frozen=True)
class Card:
    """One part of the verdict: a few large words, lines below them, and further remarks with a heading of their own."""

    title: str
    large: str
    note: str
    lines: tuple[str, ...]
    passed: bool | None
    remarks_title: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """A page: what it is about, one-sentence verdict with cards and advice, evidence, assumptions, how to make it again."""

    title: str
    study: str
    headline: str
    passed: bool | None
    cards: tuple[Card, ...]
    advice: tuple[str, ...]
    evidence: tuple[Section, ...]
    assumptions: tuple[Block, ...]
    reproduction: tuple[Block, ...]
    footer: str = ""


def render(report: Report) -> str:
    """The page as one HTML text that loads nothing from elsewhere; the same for the same report."""
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    source = (files("experiments") / "reporting" / "templates" / "report.html").read_text(encoding="utf-8")
    return environment.from_string(source).render(report=report)


def figure(plot: Plot, key: str, caption: str) -> Figure:
    """A matplotlib figure to stand in a page: scalable, named for screen readers, its ids unlike any other's.

    Args:
        plot: drawn figure.
        key: letters, digits and hyphens, unique in the page.
        caption: what it shows.
    """
    text = svg_text(plot)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{key}-", text)
    text = text.replace("*{", f"#{key} *{{")  # matplotlib's style sheet would else hold for the whole page
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.S)
    head, body = text.split(">", 1)
    head = re.sub(r'\s(?:width|height)="[^"]*"', "", head)
    label = Markup.escape(caption)
    return Figure(Markup(f'{head} id="{key}" role="img" aria-label="{label}">{body}'), caption)


def text_table(rows: Sequence[Sequence[str]], caption: str = "", compact: bool = False) -> Table:
    """A heading and rows of text as a table; columns that do not hold numbers are aligned left."""
    heading, *lines = rows
    numeric = [all(_NUMERIC.match(line[k]) for line in lines) for k in range(len(heading))]
    cells = tuple(
        tuple(Cell(text, style="" if number else "left") for text, number in zip(line, numeric, strict=True))
        for line in lines
    )
    return Table(tuple(heading), cells, caption, compact=compact)


#: A text that begins with a number, or says that there is none.
_NUMERIC = re.compile(r"^(?:[×<>≤≥±~+−-]*\s*\d|[–—]?$|nan$|n/a$)")


def csv_text(columns: Mapping[str, Iterable[object]]) -> str:
    """Columns of equal length as CSV with a heading row."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return buffer.getvalue()
