"""What the site adds to Sphinx: generated reference pages, the gallery, Markdown in docstrings, formulas as MathML.

A page asks for generated text by a comment, `<!-- insert: NAME ARGUMENTS -->`, which other readers of the page do not see.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path

import click
from docutils import nodes
from latex2mathml.converter import convert
from pydantic import BaseModel
from sphinx.application import Sphinx

_INSERT = re.compile(r"^<!-- insert: (\w+) ?(.*?) -->$", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)*)([\w-]+)\.md\)")


#: The packages of the project.
_PACKAGES = ("radiometry", "materials", "scenes", "detector", "experiments")
#: Options of every verb, which the page tells once.
_SHARED = ("out", "seed", "as_json", "quiet", "overrides")


def commands(_: Path) -> str:
    """Every verb with its usage, text, arguments and options, from click itself."""
    from experiments.cli.main import with_verbs

    mantis, text = with_verbs(), list[str]()
    for name, command in sorted(mantis.commands.items()):
        text += _command(name, command, click.Context(mantis, info_name="mantis"))
    return "\n".join(text)


def _command(name: str, command: click.Command, above: click.Context) -> Iterator[str]:
    context = click.Context(command, info_name=name, parent=above)
    yield f"\n## `{context.command_path}`\n"
    yield f"```text\n{command.get_usage(context).removeprefix('Usage: ')}\n```\n"
    yield inspect.cleandoc(command.help or "") + "\n"
    rows = [
        option.get_help_record(context)
        for option in command.params
        if isinstance(option, click.Option) and option.name not in _SHARED
    ]
    if rows:
        yield "| option | what it does |\n|---|---|"
        yield from (f"| `{_cell(form)}` | {_cell(what)} |" for form, what in filter(None, rows))
        yield ""
    if isinstance(command, click.Group):
        for inner, found in sorted(command.commands.items()):
            yield from _command(inner, found, context)


def scenario_keys(_: Path) -> str:
    """A table of keys for each section of a scenario file, from its JSON schema."""
    from experiments.scenario.keys import KeySection, scenario_keys, sections

    text = []
    for section in (KeySection("", "", True, ()), *sections()):
        text.append(f"\n## `[{section.name}]`\n" if section.name else "\n## Top of the file\n")
        if section.about:
            text.append(f"{section.about}{'' if section.present else ' Absent by default.'}\n")
        if section.presets:
            text.append(f"`preset`: {', '.join(f'`{name}`' for name in section.presets)}.\n")
        text.append("| key | takes | default | unit | meaning |\n|---|---|---|---|---|")
        for key in scenario_keys():
            if key.section == section.name:
                takes = ", ".join(filter(None, (key.kind, key.bounds)))
                default = "absent" if key.default is None else f"`{_shown(key.default)}`"
                text.append(f"| `{key.name}` | {_cell(takes)} | {default} | {key.unit} | {_cell(key.meaning)} |")
    return "\n".join(text)


#: Pages directly in docs/ in the order in which they are listed; a study's page that is not named here follows.
_TOOLS = ("explore", "sweeps", "clusters", "performance")
_STUDIES = (
    "closure",
    "glare",
    "thesis-errata",
    "validation",
    "virtual",
    "physical",
    "risk",
    "features",
    "materials",
    "montecarlo",
    "tradeoff",
)
_RECORDS = ("requirements", "new-user", "dependencies")


def pages(docs: Path) -> str:
    """The part of the navigation that other hands fill: whatever pages there are directly in docs/."""
    there = [path.stem for path in sorted(docs.glob("*.md")) if path.stem != "index"]
    more = tuple(name for name in there if name not in (*_TOOLS, *_STUDIES, *_RECORDS))
    text = []
    for caption, names in (("Explore and sweep", _TOOLS), ("Studies and records", (*_STUDIES, *more, *_RECORDS))):
        listed = [name for name in names if name in there]
        text += ["```{toctree}", f":caption: {caption}", ":hidden:", "", *listed, "```", ""] if listed else []
    return "\n".join(text)


def preset_tables(_: Path) -> str:
    """Sensors, lenses, LEDs, filters and tapes with their main figures."""
    from experiments.scenario.catalogue import SHOWN, catalogue, row

    text = []
    for section, (heading, columns) in SHOWN.items():
        entries = catalogue(section)
        text.append(f"\n### {heading}: `{entries[0].key}`\n\n| name | {' | '.join(columns)} |")
        text.append("|---" * (1 + len(columns)) + "|")
        text += [f"| `{cells[0]}` | {' | '.join(cells[1:])} |" for cells in (row(section, e) for e in entries)]
    return "\n".join(text)


def python_package(_: Path, package: str) -> str:
    """Every public module of a package, by autodoc: those on its own level first, then room by room."""
    folder = Path(str(files(package)))
    paths = [path.relative_to(folder) for path in sorted(folder.rglob("*.py")) if not path.stem.startswith("__")]
    names = [".".join(path.with_suffix("").parts) for path in paths if _shown_in_reference(package, path)]
    names.sort(key=lambda name: (name.count(".") > 0, name))
    # What a module hands on from another is described there alone, so that a reference finds one.
    own = "   :ignore-module-all:\n"
    return "\n".join(
        f"## `{package}.{name}`\n\n```{{eval-rst}}\n.. automodule:: {package}.{name}\n   :members:\n{own}```\n"
        for name in names
    )


#: Rooms of `experiments` whose modules the reference lists; of a study it lists what is varied and what is run.
_ROOMS, _OF_A_STUDY = ("scenario", "chain", "reporting"), ("plan", "study")


def _shown_in_reference(package: str, path: Path) -> bool:
    if package != "experiments":
        return True
    return path.parts[0] in _ROOMS or (path.parts[0] in ("studies", "thesis") and path.stem in _OF_A_STUDY)


def python_module(_: Path, module: str) -> str:
    """One module, by autodoc."""
    return f"```{{eval-rst}}\n.. automodule:: {module}\n   :members:\n```\n"


def gallery(docs: Path) -> str:
    """Every figure of every page, under the page's title, with the command that the page states."""
    from figures import by_page

    text = []
    for page in by_page(docs):
        text.append(f"\n## [{page.title}](../{page.path})\n\n`{page.command}`\n")
        for figure in page.figures:
            text.append(f"[![{figure.caption}](../{figure.path})](../{page.path})\n\n*{figure.caption}*\n")
    return "\n".join(text)


_GENERATORS: dict[str, Callable[..., str]] = {
    "commands": commands,
    "keys": scenario_keys,
    "presets": preset_tables,
    "package": python_package,
    "module": python_module,
    "gallery": gallery,
    "pages": pages,
}


def _cell(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")


def _shown(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_shown(v) for v in value)}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def insert(app: Sphinx, _: str, source: list[str]) -> None:
    """Put generated text where a page asks for it; a link to a study's page that is not written yet is plain text."""

    def generated(match: re.Match[str]) -> str:
        return _GENERATORS[match[1]](Path(app.srcdir), *match[2].split())

    def linked(match: re.Match[str]) -> str:
        absent = match[3] in (*_TOOLS, *_STUDIES, *_RECORDS) and not (Path(app.srcdir) / f"{match[3]}.md").exists()
        return match[1] if absent else match[0]

    source[0] = _LINK.sub(linked, _INSERT.sub(generated, source[0]))


_ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?[\w.]+(?:\[~?[\w.]+\])?\]\]"
)
#: Several names of one entry, which Sphinx would take for a type and a name.
_NAMES = re.compile(r"^( +\w+(?:, \w+)+)(?=:)", re.MULTILINE)
#: Code in a docstring, which may run on in the next line of its paragraph.
_CODE = re.compile(r"(`+(?:[^`\n]|\n(?!\s*\n))+`+)")


def from_markdown(_app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Docstrings are Markdown with Google's sections: outside code, reStructuredText's signs are plain characters."""
    text = re.sub(r"^(.+)\n-{3,}$", r"@\1@\n", "\n".join(lines), flags=re.MULTILINE)  # a heading would be the page's
    text = _NAMES.sub(lambda match: match[1].replace(", ", ","), text)
    parts = _CODE.split(text)
    parts[::2] = [re.sub(r"([*|\\])|_(?=\W|$)", lambda m: "\\" + m[0], part) for part in parts[::2]]
    # Beside a letter or a sign such as ², reStructuredText ends code only at an escaped space.
    parts[1::2] = [
        f"``{' '.join(part.strip('`').split())}``" + ("\\ " if re.match(r"[^\s.,;:!?)\]'\"-]", after) else "")
        for part, after in zip(parts[1::2], parts[2::2], strict=True)
    ]
    lines[:] = re.sub("^@(.+)@$", r"**\1**", "".join(parts), flags=re.MULTILINE).split("\n")


#: A type's bare name in a signature, neither part of a dotted name nor a default that is made by a call.
_TYPE = re.compile(r"(?<![\w.~])[A-Z][a-z]\w*\b(?![.(])")


def short_signature(
    _app: Sphinx, what: str, _name: str, obj: object, _options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Arrays without their dtype's class; a parameter model without its fields, which the scenario reference lists.

    A name that only type checkers import reaches Sphinx bare, and several modules may have one like it. So it is led to its own.
    """
    if what == "class" and isinstance(obj, type) and issubclass(obj, BaseModel):
        return "(**fields)", None
    homes = _homes(getattr(obj, "__module__", None) or "")

    def led(match: re.Match[str]) -> str:
        return f"~{homes[match[0]]}" if match[0] in homes else match[0]

    signature, returns = (text and _TYPE.sub(led, _ARRAY.sub("ndarray", text)) for text in (signature, returns))
    return signature, returns


@cache
def _homes(module: str) -> dict[str, str]:
    """Names that a module's annotations use -> their full names where they are described; empty for other people's modules."""
    if module.split(".")[0] not in _PACKAGES:
        return {}
    tree, found = ast.parse(inspect.getsource(importlib.import_module(module))), dict[str, str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in _PACKAGES:
            for alias in node.names:
                value = getattr(importlib.import_module(str(node.module)), alias.name, None)
                home = value.__module__ if inspect.isclass(value) else node.module
                found[alias.asname or alias.name] = f"{home}.{alias.name}"
    for statement in tree.body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            found[statement.target.id] = f"{module}.{statement.target.id}"
        elif isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            found[statement.targets[0].id] = f"{module}.{statement.targets[0].id}"
        elif isinstance(statement, ast.ClassDef):
            found[statement.name] = f"{module}.{statement.name}"
    return found


def skip(_app: Sphinx, _what: str, name: str, _obj: object, skipped: bool, _options: object) -> bool:
    """Leave out what pydantic adds to every model."""
    return skipped or name in ("model_config", "model_post_init")


def _mathml(writer: object, node: nodes.math | nodes.math_block, display: str) -> None:
    writer.body.append(convert(node.astext(), display=display))  # type: ignore[attr-defined]
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_html_math_renderer(
        "mathml", (lambda w, n: _mathml(w, n, "inline"), None), (lambda w, n: _mathml(w, n, "block"), None)
    )
    app.connect("source-read", insert)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-docstring", from_markdown, priority=400)  # before napoleon reads the sections
    return {"parallel_read_safe": True, "parallel_write_safe": True}
