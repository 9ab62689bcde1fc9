"""Every key of a scenario file, read from its JSON schema: type, default, bounds, unit and meaning."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from experiments.scenario.errors import nearest
from experiments.scenario.schema import json_schema

Schema = dict[str, Any]

_TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
#: A unit in a description: "[m]", "[W/sr]"; not a list of names.
_UNIT = re.compile(r"\s*\[([^\],]+)\]")


@dataclass(frozen=True)
class Key:
    """One key of a scenario file.

    Attributes:
        section: the table it stands in; empty at the top.
        name: within its section.
        kind: what it takes, in words.
        default: plain data; None where there is none, which stands for the key's absence.
        bounds: such as '0 to 1' or '> 0'; empty without any.
        unit: empty where the value is a bare number or a word, or a table whose columns have units of their own.
        meaning: one line, without the unit.
    """

    section: str
    name: str
    kind: str
    default: Any
    bounds: str
    unit: str
    meaning: str

    @property
    def dotted(self) -> str:
        """The key as `--set` takes it, say leds.count."""
        return f"{self.section}.{self.name}" if self.section else self.name


@dataclass(frozen=True)
class KeySection:
    """A table of a scenario file: its name, what it describes, whether it is there by default, and its presets."""

    name: str
    about: str
    present: bool
    presets: tuple[str, ...]


@cache
def scenario_keys() -> tuple[Key, ...]:
    """Every key, those of the top first, then section by section as in the model."""
    schema = json_schema()
    own, nested = [], []
    for name, part in schema["properties"].items():
        section = _section(schema, part)
        if section is None:
            own.append(_key("", name, part))
        else:
            nested += [_key(name, leaf, p) for leaf, p in section["properties"].items() if leaf != "preset"]
    return (*own, *nested)


@cache
def sections() -> tuple[KeySection, ...]:
    """Every section, in the order of the model."""
    schema, found = json_schema(), []
    for name, part in schema["properties"].items():
        section = _section(schema, part)
        if section is not None:
            preset = section["properties"].get("preset", {}).get("enum", [])
            about = section.get("description", "").split("\n\n")[0].replace("\n", " ")
            found.append(KeySection(name, about, part.get("default") is not None or "anyOf" not in part, tuple(preset)))
    return tuple(found)


def find(dotted: str) -> Key:
    """One key by its dotted name.

    Raises:
        ValueError: when there is none, naming the nearest.
    """
    known = {key.dotted: key for key in scenario_keys()}
    if dotted not in known:
        near = nearest(dotted, list(known))
        raise ValueError(f"{dotted}: unknown key" + (f"; did you mean {near!r}?" if near else ""))
    return known[dotted]


def explained(dotted: str, scenario: object) -> str:
    """What a key means, takes, is by default, and is in a scenario, in one line.

    Raises:
        ValueError: when there is no such key, naming the nearest.
    """
    told, value = find(dotted), scenario
    for part in dotted.split("."):
        value = getattr(value, part, None)
    here, default = (
        "absent" if v is None else f"{v} {told.unit}" if told.unit and v != "auto" else str(v)
        for v in (value, told.default)
    )
    takes = ", ".join(filter(None, (told.kind, told.bounds)))
    return f"{dotted} = {here}: {told.meaning} ({takes}; default {default})"


def _section(schema: Schema, part: Schema) -> Schema | None:
    """The schema of a section that a property refers to, also where it may be absent; None of a plain value."""
    for option in (part, *part.get("allOf", []), *part.get("anyOf", [])):
        if "$ref" in option:
            return schema["$defs"][option["$ref"].rsplit("/", 1)[1]]
    return None


def _key(section: str, name: str, part: Schema) -> Key:
    options = [option for option in part.get("anyOf", [part]) if option.get("type") != "null"]
    kinds = list(dict.fromkeys(_kind(option) for option in options))
    description = part.get("description", "")
    unit = _UNIT.search(description)
    tabular = all(kind.startswith("rows") for kind in kinds)
    bare = unit is None or tabular or unit[1] == "-"
    return Key(
        section=section,
        name=name,
        kind=" or ".join(kinds),
        default=part.get("default"),
        bounds=next((text for text in map(_bounds, options) if text), ""),
        unit="" if unit is None or bare else unit[1],
        meaning=description if tabular else _UNIT.sub("", description),
    )


def _kind(part: Schema) -> str:
    if len(part.get("enum", [])) > 6:
        return f"one of {len(part['enum'])} names"
    if "enum" in part:
        return " or ".join(f'"{value}"' for value in part["enum"])
    if part.get("pattern", "").startswith(r"\.toml"):
        return "path of a .toml file"
    if "const" in part:
        return f'"{part["const"]}"'
    if part.get("type") == "array":
        inner = part.get("items") or (part.get("prefixItems") or [{}])[0]
        if inner.get("type") == "array":
            return "rows of numbers"
        length = f"{part['maxItems']} " if part.get("minItems") == part.get("maxItems") != None else ""  # noqa: E711
        return f"list of {length}" + " or ".join(_plural(_kind(option)) for option in inner.get("anyOf", [inner]))
    return _TYPES.get(part.get("type", ""), "text")


def _plural(kind: str) -> str:
    return kind if '"' in kind else f"{kind}s"


def _bounds(part: Schema) -> str:
    """Bounds of a number, or of a list's numbers, in words."""
    if part.get("type") == "array":
        items = part.get("items", {})
        return next((text for text in map(_bounds, items.get("anyOf", [items])) if text), "")
    low, high = part.get("minimum"), part.get("maximum")
    above, below = part.get("exclusiveMinimum"), part.get("exclusiveMaximum")
    step = f", multiple of {part['multipleOf']:g}" if "multipleOf" in part else ""
    if low is not None and high is not None:
        return f"{low:g} to {high:g}{step}"
    texts = [
        f"{sign} {value:g}"
        for sign, value in ((">", above), ("≥", low), ("<", below), ("≤", high))
        if value is not None
    ]
    return ", ".join(texts) + step
