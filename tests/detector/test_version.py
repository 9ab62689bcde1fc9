"""The detector's version: a hash that changes with the code and with nothing else."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import pytest

from detector import version
from detector.version import code_version


def test_the_version_is_sixteen_hexadecimal_digits() -> None:
    assert len(code_version()) == 16
    assert int(code_version(), 16) >= 0


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package that the version is taken of."""
    folder = tmp_path / "detector"
    shutil.copytree(Path(str(files("detector"))), folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(version, "files", lambda package: folder)
    assert code_version.__wrapped__() == code_version()
    return folder


def append_to_a_module(folder: Path) -> None:
    with (folder / "pose" / "pose.py").open("a", encoding="utf-8") as module:
        module.write("#\n")


def rename_a_module(folder: Path) -> None:
    (folder / "pose" / "pose.py").rename(folder / "pose" / "place.py")


def move_a_module(folder: Path) -> None:
    (folder / "pose" / "pose.py").rename(folder / "pose.py")


@pytest.mark.parametrize("change", [append_to_a_module, rename_a_module, move_a_module])
def test_a_change_of_any_module_is_another_version(copy: Path, change: Callable[[Path], None]) -> None:
    change(copy)
    assert code_version.__wrapped__() != code_version()


def test_what_is_no_code_leaves_the_version(copy: Path) -> None:
    (copy / "data" / "more.toml").write_text("a = 1\n", encoding="utf-8")
    (copy / "pose" / "notes.txt").write_text("pose\n", encoding="utf-8")
    assert code_version.__wrapped__() == code_version()
