"""docs/performance.md is what the kept tables make, whatever figures a benchmark has added."""

from __future__ import annotations

from benchmarks.__main__ import _modules
from benchmarks.page import page
from benchmarks.rows import PAGE, read


def test_the_page_is_made_of_the_tables_that_are_kept() -> None:
    sections = [(name, module, kept) for name, module in _modules().items() if (kept := read(name)) is not None]
    assert {name for name, _, _ in sections} >= {
        "poses",
        "stock_path",
        "cycles",
        "memory",
        "sensor",
        "sweep",
        "detector",
    }
    assert page(sections) == PAGE.read_text(encoding="utf-8")
