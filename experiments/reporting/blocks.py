"""What a page is made of: text, tables, figures, pictures, in sections; plain data that knows nothing of HTML or Markdown."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from markupsafe import Markup
from matplotlib.figure import Figure

from experiments.reporting.figures import svg_file


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
class Plot:
    """A drawn figure, what it shows, and the name of its file: ``figures/STUDY-KEY.svg``."""

    key: str
    figure: Figure
    caption: str

    @cached_property
    def svg(self) -> str:
        """The figure as the text of an SVG file; drawn once, which takes most of a page's time."""
        return svg_file(self.figure)


@dataclass(frozen=True)
class Plots:
    """Plots side by side where the page is wide enough, else one below the other, with a caption for all of them."""

    kind: ClassVar[str] = "plots"
    plots: tuple[Plot, ...]
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

    @property
    def marked(self) -> str:
        """The text with a mark where it was judged: '✓ 0.5', '✗ 1.2'."""
        return self.text if self.passed is None else f"{'✓' if self.passed else '✗'} {self.text}".rstrip()


@dataclass(frozen=True)
class Download:
    """A file that the page in the browser can save; with a `key` it is written as ``data/STUDY-KEY.csv`` too, as of a table."""

    kind: ClassVar[str] = "download"
    label: str
    filename: str
    text: str
    key: str | None = None


@dataclass(frozen=True)
class Table:
    """Rows under headings. A page in the browser can sort it and save it as CSV.

    Attributes:
        groups: spans of the headings as (text, columns).
        key: name of the file that the page writes, ``data/STUDY-KEY.csv``; ``data/STUDY.csv`` for an empty key, none for None.
        exact: rows for that file where its numbers have more digits than the page shows; headings stay the same.
        inline: whether the page in Markdown shows the rows; where not, it links the file.
        terminal: whether the terminal shows the rows.
        terminal_columns: those that it shows, by number, where all would be too wide; empty for all.
    """

    kind: ClassVar[str] = "table"
    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    groups: tuple[tuple[str, int], ...] = ()
    sortable: bool = True
    compact: bool = False
    key: str | None = None
    exact: tuple[tuple[object, ...], ...] = ()
    inline: bool = True
    terminal: bool = False
    terminal_columns: tuple[int, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The headings; where two are alike, with the groups that they stand under: 'SNR: closed form'."""
        over = [text for text, columns in self.groups for _ in range(columns)] or [""] * len(self.headings)
        return tuple(
            f"{group}: {text}" if group and self.headings.count(text) > 1 else text
            for group, text in zip(over, self.headings, strict=True)
        )

    def csv(self) -> str:
        """The rows as CSV under their `names`."""
        rows = self.exact or tuple(tuple(cell.text for cell in row) for row in self.rows)
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.names, *rows])
        return buffer.getvalue()


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


Block = Text | Bullets | Plots | Strip | Download | Table | Code | Details


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


def text_table(
    rows: Sequence[Sequence[object]],
    caption: str = "",
    *,
    compact: bool = False,
    key: str | None = None,
    inline: bool = True,
    terminal: bool = False,
    terminal_columns: tuple[int, ...] = (),
) -> Table:
    """A heading and rows of text as a table; columns that do not hold numbers are aligned left. Keywords as in `Table`."""
    heading, *lines = [[str(cell) for cell in row] for row in rows]
    numeric = [all(_NUMERIC.match(line[k]) for line in lines) for k in range(len(heading))]
    cells = tuple(
        tuple(Cell(text, style="" if number else "left") for text, number in zip(line, numeric, strict=True))
        for line in lines
    )
    return Table(
        tuple(heading),
        cells,
        caption,
        compact=compact,
        key=key,
        inline=inline,
        terminal=terminal,
        terminal_columns=terminal_columns,
    )


#: A text that begins with a number, or says that there is none.
_NUMERIC = re.compile(r"^(?:[×<>≤≥±~+−-]*\s*\d|[–—]?$|nan$|n/a$)")


def csv_text(columns: Mapping[str, Iterable[object]]) -> str:
    """Columns of equal length as CSV with a heading row."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return buffer.getvalue()
