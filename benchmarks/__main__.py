"""Run benchmarks by name, or all: prints their figures and writes docs/performance.md."""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from benchmarks.page import page, shown
from benchmarks.rows import FIGURES, PAGE, ROOT, Row, machine, read, write

#: Benchmarks in the order of the page.
MODULES = ("poses", "stock_path", "cycles", "memory", "sensor", "startup", "variants", "sweep", "detector")


def main(arguments: list[str] | None = None) -> int:
    """Exit status 0, or 1 where a benchmark could not be run."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    modules = _modules()
    usual = [name for name, module in modules.items() if not getattr(module, "BY_NAME_ONLY", False)]
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"some of {', '.join(modules)}; default {', '.join(usual)}"
    )
    parser.add_argument("--quick", action="store_true", help="a first look; nothing is written")
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.names) - set(modules):
        parser.error(f"{', '.join(sorted(unknown))}: expected some of {', '.join(modules)}")
    print(machine())
    failed = []
    for name in chosen.names or usual:
        module = modules[name]
        print(f"\n{module.TITLE}", flush=True)
        start = time.perf_counter()
        try:
            rows = module.run(chosen.quick)
        except Exception as error:  # the others are still worth having
            failed.append(name)
            print(f"  failed: {type(error).__name__}: {error}")
            continue
        print("\n".join(f"  {_line(row)}" for row in rows))
        print(f"  ({time.perf_counter() - start:.0f} s)", flush=True)
        if not chosen.quick:
            write(name, rows)
            if hasattr(module, "figure"):
                from experiments.reporting.figures import save_svg

                save_svg(module.figure(rows), FIGURES / f"performance-{name}.svg")
    if not chosen.quick:
        _write_page(modules)
    return 1 if failed else 0


def _modules() -> dict[str, ModuleType]:
    """The benchmarks there are, by name."""
    there = [name for name in MODULES if find_spec(f"benchmarks.{name}")]
    modules = {name: importlib.import_module(f"benchmarks.{name}") for name in there}
    return {name: module for name, module in modules.items() if hasattr(module, "TITLE") and hasattr(module, "run")}


def _write_page(modules: dict[str, ModuleType]) -> None:
    from experiments.reporting.files import write_text

    sections = [(name, module, kept) for name, module in modules.items() if (kept := read(name)) is not None]
    write_text(page(sections), PAGE)
    print(f"\n{PAGE.relative_to(ROOT)}")


def _line(row: Row) -> str:
    name = f"{row.figure}, {row.series}" if row.series else row.figure
    verdict = {True: f"  meets {row.target}", False: f"  MISSES {row.target}", None: ""}[row.met]
    note = f"  ({row.note})" if row.note else ""
    return f"{name:62} {shown(row.value):>10} {row.unit}{verdict}{note}"


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    sys.exit(main())
