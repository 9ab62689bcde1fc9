"""A release bumps one place, and the changelog and the citation keep up with it."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
#: Author, short title, university and year of the thesis, as each page gives them.
THESIS = ("Rijlaarsdam", "Relative Navigation for Debris Removal", "Delft University of Technology", "2021")


def test_the_version_stands_in_one_place() -> None:
    """Rationale: what is written twice differs some day; the rest reads the installed package's metadata."""
    others = [ROOT / "CITATION.cff", ROOT / "docs" / "conf.py", *ROOT.glob("*.py"), *ROOT.glob("experiments/**/*.py")]
    assert not [path for path in others if VERSION in path.read_text(encoding="utf-8")]


def test_the_changelog_has_the_version_and_what_is_to_come() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d{2}-\d{2}))?$", text, re.MULTILINE)
    assert headings[0] == ("Unreleased", "")
    assert headings[1][0] == VERSION
    dates = [date for _, date in headings[1:]]
    assert all(dates)
    assert dates == sorted(dates, reverse=True)


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "CITATION.cff"])
def test_the_thesis_is_cited(page: str) -> None:
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    text = " ".join(" ".join(line.removeprefix(">") for line in lines).split())
    assert [part for part in THESIS if part not in text] == []


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*project["dependencies"], *(name for extra in project["optional-dependencies"].values() for name in extra)]
    named = {re.split(r"[\[<>=; ]", requirement)[0] for requirement in asked} - {project["name"]}
    explained = re.findall(
        r"^\| ([\w-]+) \|", (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert named <= set(explained)


def test_the_hooks_run_what_make_lint_runs() -> None:
    hooks = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert re.findall(r"^ +language: (\w+)$", hooks, re.MULTILINE) == ["system"] * 3
    for command in ("ruff check", "ruff format", "mypy"):
        assert f"entry: {command}" in hooks
        assert f".venv/bin/{command}" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_the_wheel_holds_the_module_mantis() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert settings["py-modules"] == ["mantis"]
    found = subprocess.run(
        [sys.executable, "-c", "import mantis; print(mantis.__file__)"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=60,
    )
    assert Path(found.stdout.strip()) == ROOT / "mantis.py", found.stderr
