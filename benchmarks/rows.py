"""What a benchmark hands over, and how it is kept."""

from __future__ import annotations

import csv
import io
import operator
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

ROOT = Path(__file__).parents[1]
DATA, FIGURES, PAGE = ROOT / "docs" / "data", ROOT / "docs" / "figures", ROOT / "docs" / "performance.md"

_COMPARISONS = {"≥": operator.ge, "≤": operator.le}


@dataclass(frozen=True)
class Row:
    """One measured figure.

    Attributes:
        figure: what was measured.
        value: NaN where it could not be.
        unit: of the value; empty for a ratio.
        target: such as "≥ 30", or empty.
        note: circumstances, or why there is no value.
        series: groups rows into columns of a table, or points of a curve.
    """

    figure: str
    value: float
    unit: str = ""
    target: str = ""
    note: str = ""
    series: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if not self.target:
            return None
        sign, number = self.target.split()
        return bool(_COMPARISONS[sign](self.value, float(number)))


@dataclass(frozen=True)
class Kept:
    """Rows of a module with where and when they were measured."""

    rows: list[Row]
    machine: str
    date: str


def path_of(module: str) -> Path:
    return DATA / f"performance-{module}.csv"


def write(module: str, rows: list[Row]) -> None:
    """Keep a module's rows, whole or not at all."""
    from experiments.reporting.files import write_text

    names = [field.name for field in fields(Row)]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*names, "machine", "date"])
    for row in rows:
        values = [f"{v:.6g}" if isinstance(v, float) else v for v in (getattr(row, name) for name in names)]
        table.writerow([*values, machine(), time.strftime("%Y-%m-%d")])
    write_text(text.getvalue(), path_of(module))


def read(module: str) -> Kept | None:
    """What was kept of a module, or None."""
    if not path_of(module).is_file():
        return None
    with path_of(module).open(encoding="utf-8", newline="") as file:
        records = list(csv.DictReader(file))
    names = [field.name for field in fields(Row)]
    rows = [Row(**{**{n: r[n] for n in names}, "value": float(r["value"])}) for r in records]  # type: ignore[arg-type]
    return Kept(rows, records[0]["machine"], records[0]["date"]) if records else None


def machine() -> str:
    """Processor, cores and Python of this machine, in one line."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text(encoding="utf-8").splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    return f"{name}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def best_seconds(work: Callable[[], object], repeats: int = 3) -> float:
    """Shortest of some runs, after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)
