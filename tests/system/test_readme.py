"""What README.md and docs/ tell people to type works: Python blocks run, `mantis` and `make` lines name what there is."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from experiments import cli
from experiments.close.constraints import load_constraints
from experiments.scenario import load_scenario
from experiments.verbs import stages, studies, thesis, tools

ROOT = Path(__file__).parents[2]
PAGES = [path for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) if path.is_file()]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(*languages: str) -> Iterator[tuple[str, str]]:
    """Name and text of every fenced block in one of the languages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in _FENCE.finditer(text):
            if match[1] in languages:
                yield f"{page.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}", match[2]


def lines(command: str) -> list[tuple[str, list[str]]]:
    """Place and words of every shell line that starts with a command; comments are dropped, continued lines joined."""
    found = []
    for name, text in blocks("sh", "console", "bash", ""):
        for line in text.replace("\\\n", " ").splitlines():
            words = line.strip().removeprefix("$ ")
            if words.split(" ")[0].removeprefix(".venv/bin/") == command:
                found.append((f"{name} {words}", shlex.split(words, comments=True)[1:]))
    return found


@pytest.fixture(scope="module")
def mantis() -> click.Group:
    for verb in (*stages.VERBS, *studies.VERBS, *thesis.VERBS, *tools.VERBS):
        cli.mantis.add_command(verb)
    return cli.mantis


MANTIS_LINES, PYTHON_BLOCKS, MAKE_LINES = lines("mantis"), list(blocks("python")), lines("make")


@pytest.mark.skipif(not PAGES, reason="no README.md here")
def test_the_readme_shows_what_can_be_typed() -> None:
    assert MANTIS_LINES
    assert MAKE_LINES


@pytest.mark.parametrize("words", [w for _, w in MANTIS_LINES], ids=[name for name, _ in MANTIS_LINES])
def test_mantis_lines_parse(
    mantis: click.Group, words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Verb, options and arguments exist, and `--set` keys are those of a scenario; nothing is run."""
    monkeypatch.chdir(tmp_path)
    command: click.Command = mantis
    context = click.Context(mantis, info_name="mantis")
    while isinstance(command, click.Group):
        name, found, words = command.resolve_command(context, words)
        assert found is not None, f"no verb {name}"
        command, context = found, click.Context(found, context, info_name=name)
    if set(words) & {"--help", "-h"}:
        return
    parsed = command.make_context(command.name, list(words), parent=context.parent)
    overrides = tuple(parsed.params.get("overrides") or ())
    if command.name == "close":
        load_constraints(None, overrides)  # keys of its own, beside the scenario's
        overrides = tuple(o for o in overrides if not o.startswith("close."))
    if overrides and "plan" not in parsed.params:
        load_scenario(overrides=overrides)


@pytest.mark.parametrize("code", [c for _, c in PYTHON_BLOCKS], ids=[name for name, _ in PYTHON_BLOCKS])
def test_python_blocks_run(code: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "<block>", "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("words", [w for _, w in MAKE_LINES], ids=[name for name, _ in MAKE_LINES])
def test_make_lines_name_targets(words: list[str]) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert {word for word in words if "=" not in word} <= targets
