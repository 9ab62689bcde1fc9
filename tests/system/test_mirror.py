"""Tests stand where their module does: a/b.py is tested by tests/a/test_b.py, and no test file stands for nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MIRRORED = ("radiometry", "materials", "scenes")


def modules(package: str) -> set[Path]:
    """Modules of a package, relative to it, without the faces of packages."""
    paths = (path.relative_to(ROOT / package) for path in (ROOT / package).rglob("*.py"))
    return {path for path in paths if path.name != "__init__.py"}


def stood_for(package: str) -> set[Path]:
    """Modules that the names of a package's test files stand for."""
    paths = (path.relative_to(ROOT / "tests" / package) for path in (ROOT / "tests" / package).rglob("test_*.py"))
    return {path.with_name(path.name.removeprefix("test_")) for path in paths}


@pytest.mark.parametrize("package", MIRRORED)
def test_every_module_has_its_test_file_and_every_test_file_its_module(package: str) -> None:
    assert stood_for(package) == modules(package)
