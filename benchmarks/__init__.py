"""Figures of speed and memory, with the machine and the peers in one run: ``python -m benchmarks``, or ``make bench``.

A benchmark is a module of this package with TITLE, TEXT (a paragraph for the page) and ``run(quick) -> list[Row]``. What it
measures is kept in docs/data/performance-<module>.csv, and docs/performance.md is written from all of those files, so that one
module can be run again without the others. Rows with a `series` stand side by side in a table whose first column COLUMNS names;
`figure(rows)` may draw them, and ONLY_DRAWN leaves the table out. BY_NAME_ONLY marks one that takes too long to be run with all.
"""
