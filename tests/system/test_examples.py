"""The examples in docstrings run and print what they say."""

from __future__ import annotations

import doctest
import importlib
from importlib.resources import files
from pathlib import Path

import pytest

PACKAGES = ("radiometry", "materials", "scenes", "detector", "experiments")
ROOT = Path(str(files("radiometry"))).parent
#: Functions with an example, at least.
LEAST = 10


def modules_with_examples() -> list[str]:
    """Dotted names of the modules whose text holds a prompt."""
    return [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        if ">>> " in path.read_text(encoding="utf-8")
    ]


def examples(module: str) -> list[doctest.DocTest]:
    """Docstrings of a module that hold examples."""
    found = doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(module))
    return [test for test in found if test.examples]


CASES = [pytest.param(test, id=test.name) for module in modules_with_examples() for test in examples(module)]


def test_the_most_used_functions_have_an_example() -> None:
    assert len(CASES) >= LEAST


@pytest.mark.parametrize("example", CASES)
def test_an_example_prints_what_it_says(
    example: doctest.DocTest, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    example.globs["getfixture"] = request.getfixturevalue  # a folder to write to
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(example)
    assert result.failed == 0, capsys.readouterr().out
