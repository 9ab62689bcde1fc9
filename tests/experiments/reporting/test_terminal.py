"""Tables of a page on a terminal."""

from __future__ import annotations

import io

from rich.console import Console

from experiments.reporting.blocks import Table, text_table
from experiments.reporting.terminal import text_table as shown

ROWS = [
    ("step of the chain", "a long heading over numbers", "b"),
    ("as printed", "3.47×10⁶", "[1]"),
    ("full", "12", "9"),
]


def printed(table: Table, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, highlight=False)
    console.print(shown(table))
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


def test_compact_tables_break_headings_and_never_numbers() -> None:
    text = printed(text_table(ROWS, compact=True), 40)
    assert "3.47×10⁶" in text
    assert "a long heading over numbers" not in text
    assert all(len(line.rstrip()) <= 40 for line in text.splitlines())


def test_numbers_stand_to_the_right_and_brackets_are_brackets() -> None:
    lines = printed(text_table(ROWS), 80).splitlines()
    first, last = (next(line for line in lines if word in line) for word in ("3.47×10⁶", "full"))
    assert first.index("3.47×10⁶") + len("3.47×10⁶") == last.index("12") + 2
    assert "[1]" in first


def test_a_table_may_name_the_columns_that_are_shown() -> None:
    text = printed(text_table(ROWS, terminal_columns=(0, 2)), 80)
    assert "full" in text
    assert "3.47×10⁶" not in text
