"""docs/performance.md from what all benchmarks have kept."""

from __future__ import annotations

import math
from types import ModuleType

from benchmarks.rows import FIGURES, Kept, Row

_HEAD = """# Performance

How fast, how noisy, how large: measured. Made by `make bench` (all of it, some minutes on an idle machine) or
`python -m benchmarks NAME …` (sections by name, in brackets below); tables are kept in `docs/data/performance-*.csv`.
Ratios are of figures measured in one run on one machine; absolute figures move with the machine and with what else it
does.
"""


def page(sections: list[tuple[str, ModuleType, Kept]]) -> str:
    """The page as Markdown; a section is a module's name, the module, and what it has kept."""
    targets = [(row, name) for name, _, kept in sections for row in kept.rows if row.target]
    parts = [_HEAD, "## Against the targets\n"]
    parts.append(
        _table(["figure", "measured", "target", "met", "section"], [_target(row, name) for row, name in targets])
    )
    for name, module, kept in sections:
        parts.append(f"## {module.TITLE} [`{name}`]\n")
        parts.append(f"{module.TEXT.strip()}\n")
        parts.append(_rows(module, kept))
        if (FIGURES / f"performance-{name}.svg").is_file() and hasattr(module, "figure"):
            parts.append(f"![{module.TITLE}](figures/performance-{name}.svg)\n")
        parts.append(f"Measured {kept.date} on {kept.machine}.\n")
    return "\n".join(parts)


def shown(value: float) -> str:
    """Three significant digits, without an exponent where there is no need of one."""
    if math.isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        digits = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
        return f"{value:,.{digits}f}".replace(",", " ")
    return f"{value:.2e}"


def _target(row: Row, name: str) -> list[str]:
    met = {True: "yes", False: "no", None: ""}[row.met]
    return [row.figure, f"{shown(row.value)} {row.unit}".strip(), f"{row.target} {row.unit}".strip(), met, f"`{name}`"]


def _rows(module: ModuleType, kept: Kept) -> str:
    series = list(dict.fromkeys(row.series for row in kept.rows if row.series))
    single = [row for row in kept.rows if not row.series]
    text = ""
    if single:
        lines = [[row.figure, shown(row.value), row.unit, row.note] for row in single]
        text += _table(["figure", "value", "unit", "note"], lines)
    if series and not getattr(module, "ONLY_DRAWN", False):
        figures = list(dict.fromkeys(row.figure for row in kept.rows if row.series))
        found = {(row.figure, row.series): row for row in kept.rows if row.series}
        units = {row.figure: row.unit for row in kept.rows if row.series}
        alike = len(set(units.values())) == 1
        names = {f: f if alike or not units[f] else f"{f} [{units[f]}]" for f in figures}
        lines = [[names[f], *(shown(found[f, s].value) if (f, s) in found else "–" for s in series)] for f in figures]
        unit = units[figures[0]] if alike else ""
        text += "\n" + _table([f"{module.COLUMNS} [{unit}]" if unit else module.COLUMNS, *series], lines)
    return text


def _table(head: list[str], lines: list[list[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"
