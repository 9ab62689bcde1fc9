"""What is wrong with a model's data, in one line: key, value, what was expected, and the nearest key that there is."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

#: Pydantic's words for types, and those of a TOML file.
_WORDS = {"a valid tuple": "a list in square brackets", "a valid list": "a list in square brackets"}


#: Keys of earlier versions, and what they are called now.
RENAMED = {"light": "illumination", "budget.lights": "budget.illuminations"}


def explain(error: ValidationError, root: type[BaseModel]) -> str:
    """One line about the first thing wrong with a model's data, and how many more there are."""
    # A misspelt key is also a missing one: name the misspelling.
    first, *rest = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    location = _location(first["loc"])
    key = ".".join(str(part) for part in location) or "scenario"
    others = {tuple(_location(e["loc"])) for e in rest} - {tuple(location)}
    more = f" (and {len(others)} more)" if others else ""
    if first["type"] == "extra_forbidden":
        return f"{key}: unknown key{_suggestion(location, root)}{more}"
    if first["type"] == "value_error":
        message = str(first["ctx"]["error"]) if "ctx" in first else first["msg"]
        model = _model_at(location, root)
        named = model is not None and message.partition(":")[0] in model.model_fields
        return (message if not location else f"{key}{'.' if named else ': '}{message}") + more
    if first["type"] in ("model_type", "dict_type") and (section := _model_at(location, root)) is not None:
        some = list(section.model_fields)[:2]
        return f"{key}: {first['input']!r}, expected a section of keys, say {key}.{some[0]} and {key}.{some[1]}{more}"
    about = describe(location, root)
    if first["type"] == "missing":
        return f"{key}: missing{f' ({about})' if about else ''}{more}"
    if first["type"] == "too_short" and first["ctx"]["min_length"] == 1:
        return f"{key}: {first['input']!r}, expected at least one value{f' ({about})' if about else ''}{more}"
    expected = first["msg"].replace("Input should be", "expected").split(", unable")[0]
    for theirs, ours in _WORDS.items():
        expected = expected.replace(theirs, ours)
    return f"{key}: {first['input']!r}, {expected}{f' ({about})' if about else ''}{more}"


def describe(location: list[Any], root: type[BaseModel]) -> str:
    """Description of the innermost known key of a location; empty where there is none."""
    names = [part for part in location if isinstance(part, str)]
    while names:
        model = _model_at(names[:-1], root)
        if model is not None and names[-1] in model.model_fields:
            return model.model_fields[names[-1]].description or ""
        names.pop()
    return ""


def nearest(word: str, words: list[str]) -> str | None:
    """The one of some words that a mistyped word was most likely meant to be; None where none is close."""
    found = difflib.get_close_matches(word, words, n=1, cutoff=0.6)
    return found[0] if found else None


def _location(loc: tuple[int | str, ...]) -> list[int | str]:
    """Keys and indices alone: members of a union (a number or 'auto') are named by their type at the location's end."""
    return [part for part in loc if isinstance(part, int) or part.isidentifier()]


def _model_at(location: list[Any], root: type[BaseModel]) -> type[BaseModel] | None:
    model: Any = root
    for part in location:
        field = model.model_fields.get(part) if isinstance(model, type) and issubclass(model, BaseModel) else None
        if field is None:
            return None
        # A section that may be absent is a union with None.
        kinds = [kind for kind in get_args(field.annotation) if kind is not type(None)]
        model = kinds[0] if len(kinds) == 1 else field.annotation
    return model if isinstance(model, type) and issubclass(model, BaseModel) else None


def _every_key(root: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name in root.model_fields:
        yield (*above, name)
        section = _model_at([name], root)
        if section is not None:
            yield from _every_key(section, (*above, name))


def _suggestion(location: list[Any], root: type[BaseModel]) -> str:
    """'; did you mean …?' of the nearest key, beside the unknown one or in another section; empty where none is near."""
    *parents, wrong = map(str, location)
    renamed = RENAMED.get(".".join((*parents, wrong)))
    if renamed is not None:
        return f"; it is {renamed!r} now, with 'eclipse' or 'sunlit'"

    def likeness(key: tuple[str, ...]) -> float:
        score = difflib.SequenceMatcher(None, wrong, key[-1]).ratio()
        score += 0.3 if key[-1].startswith(wrong) and len(wrong) > 2 else 0.0
        return score + (0.1 if list(key[:-1]) == parents else 0.0)

    best = max(_every_key(root), key=likeness)
    if likeness(best) < 0.7:
        return ""
    about = describe(list(best), root)
    return f"; did you mean {'.'.join(best)!r}{f' ({about})' if about else ''}?"
