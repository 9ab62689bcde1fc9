"""Tables on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any, Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table as RichTable
from rich.text import Text

from experiments.reporting.blocks import Table


def plain_table(title: str, header: Sequence[str], *rows: Sequence[object]) -> RichTable:
    """A table of text as it stands: brackets are brackets, not styles."""
    table = RichTable(title=Text(title))
    for heading in header:
        table.add_column(Text(str(heading)))
    for row in rows:
        table.add_row(*(Text(str(cell)) for cell in row))
    return table


def text_table(table: Table) -> RichTable:
    """A table of a page, with the columns that a terminal is to show, its numbers to the right.

    A compact one has no lines, so that more of it fits.
    """
    look: dict[str, Any] = {"box": SIMPLE_HEAD, "padding": (0, 1, 0, 0), "pad_edge": False} if table.compact else {}
    shown = RichTable(title=Text(table.caption), **look)
    columns = table.terminal_columns or range(len(table.headings))
    for k in columns:
        words = any(row[k].style == "left" for row in table.rows)
        width = max((len(row[k].text) for row in table.rows), default=0)
        heading = table.headings[k]
        lines = wrap(heading, max(width, 7), break_long_words=False) if table.compact else [heading]
        justify: Literal["left", "right"] = "left" if words else "right"
        shown.add_column(Text("\n".join(lines)), justify=justify, no_wrap=table.compact and not words)
    for row in table.rows:
        shown.add_row(*(Text(row[k].marked) for k in columns))
    return shown
