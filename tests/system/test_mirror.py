"""Tests stand where their module does: a/b.py is tested by tests/a/test_b.py, and no test file stands for nothing."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MIRRORED = ("radiometry", "materials", "scenes", "detector")


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


@pytest.mark.parametrize("package", MIRRORED)
def test_the_face_of_a_package_lists_its_modules_and_imports_none(package: str) -> None:
    for face in (ROOT / package).rglob("__init__.py"):
        inside = {path.stem for path in face.parent.glob("*.py")} - {"__init__"}
        rooms = {path.parent.name for path in face.parent.glob("*/__init__.py")}
        [*_, listed] = ast.parse(face.read_text(encoding="utf-8")).body
        assert isinstance(listed, ast.Assign), face
        assert ast.literal_eval(listed.value) == sorted(inside | rooms), face
        assert "import " not in face.read_text(encoding="utf-8"), face
