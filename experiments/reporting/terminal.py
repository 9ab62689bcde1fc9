"""Tables on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

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
    """A table of a page, with the columns that a terminal is to show."""
    columns = table.terminal_columns or range(len(table.headings))
    rows = ([row[k].text for k in columns] for row in table.rows)
    return plain_table(table.caption, [table.headings[k] for k in columns], *rows)
