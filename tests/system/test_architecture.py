"""The rules of the house: which package and room may import which, what stays out of start-up, where randomness comes from,
and how calls are written.

Imports count wherever they stand: at the top of a module, inside a function, or under TYPE_CHECKING.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path

import pytest

PACKAGES = ("radiometry", "materials", "scenes", "detector", "experiments")
#: Package -> what of this project it may import. A module's name allows that module alone.
ALLOWED = {
    "radiometry": ("radiometry",),
    "materials": ("materials", "radiometry"),
    "scenes": ("scenes", "materials", "radiometry"),
    "detector": ("detector", "radiometry", "scenes.marker"),
    "experiments": PACKAGES,
}
RENDERER = ("mitsuba", "drjit")
#: What a command line that only parses must not load.
HEAVY = (*RENDERER, "scipy", "cv2", "matplotlib", "xarray", "numpy", "pydantic", "rich", "colour", "OpenEXR")
ROOT = Path(str(files("radiometry"))).parent


@cache
def modules(package: str) -> dict[str, ast.Module]:
    """Syntax trees of a package's modules by dotted name."""
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def imported(module: str) -> Iterator[str]:
    """Dotted names that a module imports anywhere in its text, `from a import b` as a.b where that is a module."""
    for node in ast.walk(modules(module.split(".")[0])[module]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}, line {node.lineno}: imports are written with the package's name"
            base = node.module or ""
            names = [f"{base}.{alias.name}" for alias in node.names]
            inside = base.split(".")[0] in PACKAGES
            yield from (n if inside and n in modules(n.split(".")[0]) else base for n in names)


ALL = [(package, module) for package in PACKAGES for module in modules(package)]

#: Rooms of a package from the ground up. A room may import the rooms before it and itself, none after it. A room is a folder
#: or, where a module stands on the package's own level, that module. The two packages without folders have no rooms.
ROOMS = {
    "scenes": (
        *("atomic", "llvm"),
        *("marker", "target", "view", "tags"),
        "projection",
        "render",
        *("face", "chessboard"),
        "files",
    ),
    "detector": (
        *("version", "compiled"),
        "sensor",
        "pattern",
        "elements",
        *("features", "rectify"),
        "pose",
        "detect",
        "calibration",
        "pnp",
    ),
    "experiments": ("scenario", "chain", "reporting", "studies", "api", "thesis", "explore", "cli"),
}
#: Room -> rooms that may import it, where the order alone would allow more.
ONLY_FOR = {
    "experiments.thesis": ("experiments.explore", "experiments.cli"),
    "experiments.api": (),  # for users; inside, each function is taken from where it stands
    **dict.fromkeys(
        ("radiometry.thesis", "radiometry.corrections", "radiometry.extensions"),
        ("radiometry.corrections", "radiometry.extensions", "experiments.thesis"),
    ),
}


def room(module: str) -> str | None:
    """Package and room of a module; None of a package itself."""
    parts = module.split(".")
    return ".".join(parts[:2]) if len(parts) > 1 else None


@cache
def imports() -> dict[str, frozenset[str]]:
    """Every module of the project -> the modules of the project that it imports, wherever the import stands."""
    known = {module for _, module in ALL}
    return {module: frozenset(set(imported(module)) & known - {module}) for module in known}


def breaks_the_rooms(importer: str, module: str) -> bool:
    """Whether an import goes up, or into a room that is kept from the importer."""
    from_room, to_room = room(importer), room(module)
    if from_room is None or to_room is None or from_room == to_room:
        return False
    if to_room in ONLY_FOR and from_room not in ONLY_FOR[to_room]:
        return True
    package, own = from_room.split(".")
    if to_room.split(".")[0] != package or package not in ROOMS:
        return False  # between packages: `test_imports_go_one_way`
    order = ROOMS[package]
    return order.index(to_room.split(".")[1]) > order.index(own)


def breaking() -> set[tuple[str, str]]:
    """Every import that breaks a rule of the rooms, importer first."""
    return {(m, name) for m, names in imports().items() for name in names if breaks_the_rooms(m, name)}


def circles() -> list[list[str]]:
    """Groups of modules that import one another in a circle."""
    order = {m: set(names) for m, names in imports().items()}
    # What imports nothing that is left, or is imported by nothing that is left, stands in no circle.
    while loose := {m for m, names in order.items() if not names or not any(m in other for other in order.values())}:
        order = {m: names - loose for m, names in order.items() if m not in loose}
    groups: list[set[str]] = []
    for module in order:
        reached = _reached(order, module)
        group = {other for other in reached if module in _reached(order, other)}
        if group and group not in groups:
            groups.append(group)
    return [sorted(group) for group in groups]


def _reached(order: dict[str, set[str]], start: str) -> set[str]:
    """Modules that a module imports, and those that these import, and so on."""
    found: set[str] = set()
    todo = set(order[start])
    while todo:
        module = todo.pop()
        found.add(module)
        todo |= order[module] - found
    return found


@pytest.mark.parametrize("package", ROOMS)
def test_every_room_has_its_place(package: str) -> None:
    found = {room(module) for module in modules(package)} - {None}
    assert found == {f"{package}.{name}" for name in ROOMS[package]}, "ROOMS says from the ground up what there is"


def test_rooms_import_what_stands_before_them() -> None:
    wrong = sorted(breaking())
    assert not wrong, "\n".join(f"{importer} imports {module}" for importer, module in wrong)


def test_the_pose_solvers_of_others_stand_apart() -> None:
    """Rationale: they are what the detector is compared with, so neither may lean on the other."""
    for module in modules("detector"):
        if room(module) == "detector.pnp":
            rooms = {room(name) for name in imports()[module] if name.startswith("detector")}
            assert rooms <= {"detector.pnp"}, module


def test_no_modules_import_one_another_in_a_circle() -> None:
    assert circles() == []


def test_a_deferred_import_counts_for_rooms_and_circles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: an import inside a function starts without an error and still ties two modules together."""
    upward = ast.parse("def later():\n    from experiments.cli import main\n")
    monkeypatch.setitem(modules("experiments"), "experiments.scenario.toml", upward)
    imports.cache_clear()
    try:
        assert ("experiments.scenario.toml", "experiments.cli.main") in breaking()
        assert any("experiments.scenario.toml" in group for group in circles())
    finally:
        imports.cache_clear()


@pytest.mark.parametrize(("package", "module"), ALL, ids=[module for _, module in ALL])
def test_imports_go_one_way(package: str, module: str) -> None:
    for name in imported(module):
        if name.split(".")[0] in PACKAGES:
            may = any(name == allowed or name.startswith(f"{allowed}.") for allowed in ALLOWED[package])
            assert may, f"{module} imports {name}; {package} may import {', '.join(ALLOWED[package])}"


@pytest.mark.parametrize("package", ["radiometry", "detector"])
def test_closed_form_and_detector_know_no_renderer_by_name(package: str) -> None:
    for module in modules(package):
        assert not {name.split(".")[0] for name in imported(module)} & set(RENDERER), module


def loaded(code: str) -> set[str]:
    """Top-level modules in a fresh interpreter after it ran some code."""
    code += "\nimport json, sys\nprint('\\n' + json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert run.returncode == 0, run.stderr
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_closed_form_and_detector_load_no_renderer_through_others() -> None:
    names = [*modules("radiometry"), *modules("detector")]
    found = loaded(f"import importlib\nfor name in {names!r}: importlib.import_module(name)")
    assert "detector" in found
    assert not found & {*RENDERER, "OpenEXR", "materials", "experiments"}


def test_command_line_starts_without_anything_heavy() -> None:
    """Rationale: `mantis --help` must answer at once, so parsing may load neither renderer nor numerics."""
    found = loaded(
        "from experiments.cli import main as cli\n"
        "assert cli.main(['--help']) == 0\n"
        "for verb in list(cli.mantis.commands): assert cli.main([verb, '--help']) == 0, verb"
    )
    assert "experiments" in found
    assert not found & set(HEAVY)


GENERATORS = ("default_rng", "Generator", "SeedSequence", "BitGenerator", "PCG64", "Philox")
#: Together, in one function, they lend numpy's global state to a library that draws from it, and give it back.
LENT = {"get_state", "seed", "set_state"}


def global_draws(tree: ast.AST) -> set[str]:
    """Names of `np.random` in a piece of code that are not explicit generators."""
    found = (node for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    names = {node.attr for node in found if ast.unparse(node.value) in ("np.random", "numpy.random")}
    return names - set(GENERATORS)


@pytest.mark.parametrize(("package", "module"), ALL, ids=[module for _, module in ALL])
def test_randomness_comes_from_a_generator_that_was_handed_in(package: str, module: str) -> None:
    tree = modules(package)[module]
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    outside = [node for node in tree.body if node not in functions]
    for code in (*functions, *outside):
        assert global_draws(code) in (set(), LENT), f"{module}, line {code.lineno}: numpy's global generator"
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("default_rng"):
            assert node.args or node.keywords, f"{module}, line {node.lineno}: default_rng() without a seed"
    assert "random" not in set(imported(module)), f"{module}: the standard library's generator is global"


@pytest.mark.parametrize(("package", "module"), ALL, ids=[module for _, module in ALL])
def test_data_is_read_from_the_installed_packages_alone(package: str, module: str) -> None:
    """Rationale: a wheel has no repository around it, so no module may look beside or above its own package."""
    for node in ast.walk(modules(package)[module]):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            assert ".." not in Path(node.value).parts, f"{module}, line {node.lineno}: {node.value} leaves the package"
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "files" and node.args:
            source = node.args[0]
            if isinstance(source, ast.Constant):
                allowed = {name.split(".")[0] for name in ALLOWED[package]}
                assert source.value in allowed, f"{module}, line {node.lineno}: reads data of {source.value}"
        if isinstance(node, (ast.Subscript, ast.Attribute)) and "__file__" in ast.unparse(node):
            text = ast.unparse(node)
            climbs = ".parents" in text or text.count(".parent") > 1
            assert not climbs, f"{module}, line {node.lineno}: {text} leaves the package"


@pytest.mark.parametrize(("package", "module"), ALL, ids=[module for _, module in ALL])
def test_modules_say_what_they_are_for(package: str, module: str) -> None:
    assert ast.get_docstring(modules(package)[module]), module


#: Packages whose calls name their arguments and whose layout is the formatter's alone.
PLAIN = ("radiometry", "materials", "scenes", "detector", "experiments")
#: More arguments than this by position and a reader has to count them.
MOST_POSITIONAL = 6
PLAIN_MODULES = [module for package, module in ALL if package in PLAIN]


def long_calls(tree: ast.AST) -> list[str]:
    """Line and function of each call with too many positional arguments; starred ones do not count."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    counts = ((call, sum(not isinstance(value, ast.Starred) for value in call.args)) for call in calls)
    return [f"line {call.lineno}: {ast.unparse(call.func)}" for call, count in counts if count > MOST_POSITIONAL]


@pytest.mark.parametrize("module", PLAIN_MODULES)
def test_calls_with_many_arguments_name_them(module: str) -> None:
    assert long_calls(modules(module.split(".")[0])[module]) == [], module


def test_positional_arguments_are_counted_as_the_rule_says() -> None:
    assert long_calls(ast.parse("f(1, 2, 3, 4, 5, 6, *rest, g=7)")) == []
    assert long_calls(ast.parse("x = a.f(1, 2, 3, 4, 5, 6, 7)")) == ["line 1: a.f"]


@pytest.mark.parametrize("package", PLAIN)
def test_the_formatter_lays_out_every_line(package: str) -> None:
    for path in sorted((ROOT / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"# *fmt: *(skip|off)", text), path.relative_to(ROOT)
