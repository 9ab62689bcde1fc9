"""What the README and docs/ tell people to type works.

README.md, CONTRIBUTING.md and the pages in the folders of docs/ are walked through as a reader would, in one folder a page,
block by block:
`mantis` lines are run in this process with few rays and noise draws, Python blocks share their names, TOML blocks are read.
Comments before a block say more of it:

* `<!-- file: NAME -->` saves it;
* `<!-- exits: N -->` is the exit status of its lines;
* `<!-- refused: WHY -->` is a file that must be refused;
* `<!-- not run: WHY -->` has its lines parsed only.

Pages of studies, directly in docs/, state commands that take minutes: their lines are parsed, and `make quick` runs the short
form of each; their Python and TOML blocks are run and read.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import shlex
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import dedent
from typing import Any

import click
import pytest

from experiments.cli import main as cli
from experiments.reporting.page import Page
from experiments.scenario import load_scenario
from experiments.studies.close.constraints import load_problem
from experiments.studies.sweep.study import load_sweep
from materials import library

ROOT = Path(__file__).parents[2]
README, DOCS = ROOT / "README.md", ROOT / "docs"
WALKED = [README, ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*/*.md"))]
STUDIES = sorted(DOCS.glob("*.md"))
SHELL = ("sh", "console", "bash")
_FENCE = re.compile(r"^( *)```([\w{}-]*)[ ]*\n(.*?)^\1```[ ]*$", re.MULTILINE | re.DOTALL)
_COMMENTS = re.compile(r"(?:<!-- [^\n]* -->\n)+\Z")
#: Few rays and noise draws, for what is tested is that the words are right; a later `--set` wins.
QUICK = {"render.marker_rays": "100_000", "render.frame_samples": "1"}
QUICK_BUDGET = {
    **QUICK,
    "budget.ranges_m": "[3, 20]",
    "budget.trials": "2",
    "budget.exposures_s": '["auto"]',
    "camera.width_px": "240",
    "camera.height_px": "240",
}

Mantis = Callable[..., tuple[int, str, str]]


@dataclass(frozen=True)
class Block:
    """One fenced block of a page, with what the comments before it say."""

    page: Path
    line: int
    language: str
    text: str
    said: dict[str, str] = field(default_factory=dict)

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def commands(self, *names: str) -> list[str]:
        """Its lines that begin with one of some commands, continued lines joined; all lines without a name."""
        if self.language not in (*SHELL, ""):
            return []
        lines = (line.strip().removeprefix("$ ") for line in self.text.replace("\\\n", " ").splitlines())
        found = (line.removeprefix(".venv/bin/") for line in lines if line and not line.startswith("#"))
        return [line for line in found if not names or line.split(" ")[0] in names]


def blocks(page: Path) -> list[Block]:
    """Every fenced block of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _FENCE.finditer(text):
        before = _COMMENTS.search(text[: match.start()])
        said = dict(re.findall(r"<!-- ([\w ]+): (.*?) -->", before[0] if before else ""))
        found.append(Block(page, text.count("\n", 0, match.start()) + 1, match[2], dedent(match[3]), said))
    return found


ALL_BLOCKS = [block for page in (*WALKED, *STUDIES) for block in blocks(page)]
PARSED = [(b, line) for b in ALL_BLOCKS for line in b.commands("mantis")]
MADE = [(b, line) for b in ALL_BLOCKS for line in b.commands("make")]


def names(page: Path) -> str:
    return str(page.relative_to(ROOT))


def ids(cases: list[tuple[Block, str]]) -> list[str]:
    return [f"{block.place} {line}" for block, line in cases]


def test_the_pages_show_what_can_be_typed() -> None:
    assert PARSED
    assert MADE


@pytest.mark.parametrize(("block", "line"), PARSED, ids=ids(PARSED))
def test_mantis_lines_parse(block: Block, line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Verb, options and arguments exist, and `--set` keys are those of a scenario; nothing is run, no file need be there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(click.Path, "convert", lambda self, value, *_: self.coerce_path_result(value))
    words = shlex.split(line, comments=True)[1:]
    command: click.Command = cli.with_verbs()
    context = click.Context(command, info_name="mantis")
    while isinstance(command, click.Group) and words and words[0] not in ("--help", "-h", "--version"):
        name, found, words = command.resolve_command(context, words)
        assert found is not None, f"no verb {name}"
        command, context = found, click.Context(found, context, info_name=name)
    if not words or set(words) & {"--help", "-h", "--version"}:
        return
    parsed = command.make_context(command.name, list(words), parent=context.parent)
    overrides = tuple(parsed.params.get("overrides") or ())
    if command.name == "close":
        load_problem(None, overrides)  # keys of its own, beside the scenario's
        overrides = tuple(o for o in overrides if not o.startswith("close."))
    if overrides and "plan" not in parsed.params and "exits" not in block.said:
        load_scenario(overrides=tuple(o for o in overrides if ".toml" not in o))


def test_the_help_lists_every_verb() -> None:
    group = cli.with_verbs()
    text = group.get_help(click.Context(group, info_name="mantis"))
    assert all(re.search(rf"^  {name} ", text, re.MULTILINE) for name in group.commands)


@pytest.mark.parametrize(("block", "line"), MADE, ids=ids(MADE))
def test_make_lines_name_targets(block: Block, line: str) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    words = shlex.split(line, comments=True)[1:]
    assert {word for word in words if "=" not in word} <= targets, block.place


@pytest.fixture
def one_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A study's figures and page are drawn once, for that takes most of the time; other tests are about their content."""
    monkeypatch.setattr(Page, "html", _first_html)
    monkeypatch.setattr(Page, "plots", lambda page: () if page.study in _drawn else _plots(page))


_drawn: dict[str, str] = {}
_html, _plots = Page.html, Page.plots


def _first_html(page: Page) -> str:
    if page.study not in _drawn:
        _drawn[page.study] = _html(page)
    return _drawn[page.study]


@pytest.mark.usefixtures("one_report")
@pytest.mark.parametrize("page", WALKED, ids=names)
def test_a_page_works_from_top_to_bottom(
    page: Path, mantis: Mantis, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: a reader starts at the top and types what stands there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    shared: dict[str, Any] = {"__name__": "__main__"}
    told = ""
    for block in blocks(page):
        if "not run" in block.said:
            assert len(block.said["not run"]) > 10, f"{block.place}: say why it is not run"
        elif block.language in SHELL:
            told = _type(block, mantis)
        elif block.language == "toml":
            _read(block, tmp_path)
        elif block.language == "python":
            exec(compile(block.text, block.place, "exec"), shared)
        elif block.language == "text":  # what the block before it prints, but for the figures
            assert set(_without_figures(block.text)) <= set(_without_figures(told)), f"{block.place}: prints {told}"
        else:
            assert block.language.startswith("{"), f"{block.place}: in which language?"


@pytest.mark.parametrize("page", STUDIES, ids=names)
def test_what_a_study_shows_of_files_and_python_works(
    page: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    shared: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if "not run" in block.said:
            continue
        if block.language == "toml":
            _read(block, tmp_path)
        elif block.language == "python":
            exec(compile(block.text, block.place, "exec"), shared)


def _without_figures(text: str) -> list[str]:
    return [re.sub(r"-?\d[\d.]*(?:e[-+]?\d+)?", "#", line).strip() for line in text.splitlines()]


def _type(block: Block, mantis: Mantis) -> str:
    """Run a block's lines; returns what they print."""
    told = ""
    for line in block.commands():
        words = shlex.split(line, comments=True)
        if words[0] == "make":
            continue  # set-up, tests and studies of CI itself
        assert words[0] == "mantis", f"{block.place}: {words[0]} is not run here; say so in a comment before the block"
        status, out, error = mantis(*_quickly(words[1:]))
        told += out + error
        assert status == int(block.said.get("exits", 0)), f"{block.place}: {line}: {error}"
    return told


def _quickly(words: list[str]) -> list[str]:
    """A command line with few rays and noise draws, where its verb takes a scenario and does not set them itself."""
    settings = {"budget": QUICK_BUDGET, "render": QUICK, "sweep": QUICK}.get(words[0], {})
    chosen = {word.split("=")[0] for word in words}
    short = [part for key, value in settings.items() if key not in chosen for part in ("--set", f"{key}={value}")]
    return [
        *words,
        *short,
        *(["--workers", "1"] if words[0] in ("budget", "sweep") and "--workers" not in words else []),
    ]


def _read(block: Block, folder: Path) -> None:
    path = folder / block.said.get("file", "block.toml")
    path.write_text(re.sub(r"^trials = \d+", "trials = 2", block.text, flags=re.MULTILINE), encoding="utf-8")
    keys = set(tomllib.loads(block.text))
    reader: Callable[[Any], object] = load_scenario
    if keys & {"grid", "list", "sample"}:
        reader = load_sweep
    elif keys & {"diffuse", "gloss", "retro"}:
        reader = lambda p: library.load(str(p))  # noqa: E731
    if "refused" in block.said:
        with pytest.raises(ValueError, match="returns"):
            reader(path)
    else:
        reader(path)


@pytest.mark.parametrize("page", [*WALKED, *STUDIES], ids=names)
def test_links_lead_somewhere(page: Path) -> None:
    """Rationale: the pages are read on a code host as well as on the site, which has its own check."""
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not re.match(r"\w+:", target):
            assert (page.parent / target).exists(), f"{target} is not there"


_PACKAGES = "radiometry|materials|scenes|detector|experiments|mantis"
_DOTTED = re.compile(rf"`((?:{_PACKAGES})(?:\.\w+)+)`")
_PATHS = re.compile(r"`((?:radiometry|materials|scenes|detector|experiments|tests|docs|benchmarks)/[\w./-]*)`")


@pytest.mark.parametrize("page", WALKED, ids=names)
def test_modules_functions_and_files_that_pages_name_are_there(page: Path) -> None:
    """Rationale: a reader who looks for what a page names must find it, also after a move."""
    text = page.read_text(encoding="utf-8")
    missing = [name for name in _DOTTED.findall(text) if not name.endswith((".py", ".toml")) and not _is_there(name)]
    missing += [path for path in _PATHS.findall(text) if not (ROOT / path).exists()]
    assert missing == []


def _is_there(dotted: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        try:
            for name in parts[cut:]:
                found = getattr(found, name)
        except AttributeError:
            return False
        return True
    return False


def _module(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, DOCS / "_ext" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkey = pytest.MonkeyPatch()
    monkey.setitem(__import__("sys").modules, name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    monkey.undo()
    return module


def test_every_figure_stands_on_a_page_that_says_which_command_made_it() -> None:
    pages = _module("figures").by_page(DOCS)
    shown = {figure.path for page in pages for figure in page.figures if page.command}
    shown |= {
        target.removeprefix("docs/") for target in re.findall(r"\]\((docs/[^)]+)\)", README.read_text(encoding="utf-8"))
    }
    kept = {str(p.relative_to(DOCS)) for p in (DOCS / "figures").glob("*.svg")}
    kept |= {str(p.relative_to(DOCS)) for p in (DOCS / "figures").glob("*.png")}
    assert kept
    assert kept <= shown


def test_the_notebook_is_kept_without_outputs() -> None:
    """Rationale: it is run whenever the site is built; kept outputs would only grow old."""
    notebooks = list((DOCS / "notebooks").glob("*.ipynb"))
    assert notebooks
    for path in notebooks:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs"), f"{path.name}: strip the outputs"
            assert cell.get("execution_count") is None
