"""The examples in docstrings run and give what they print."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("radiometry", "materials", "scenes")
WITH_EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


def examples(module: str) -> list[doctest.DocTest]:
    found = doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(module))
    return [test for test in found if test.examples]


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_give_what_they_print(module: str) -> None:
    runner = doctest.DocTestRunner(verbose=False)
    for test in examples(module):
        assert runner.run(test).failed == 0, test.name


def test_ten_of_the_most_used_functions_have_an_example() -> None:
    """Each starts from its own import, so that it can be copied."""
    found = [test for module in WITH_EXAMPLES for test in examples(module)]
    assert len(found) >= 10
    for test in found:
        assert "import" in test.examples[0].source, test.name
