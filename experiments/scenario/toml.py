"""Scenarios as TOML text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def toml_text(data: Mapping[str, object]) -> str:
    """Nested plain data as TOML: keys of the top level first, then a table for each mapping; None is left out."""
    lines = [
        f"{key} = {_toml_value(value)}"
        for key, value in data.items()
        if not isinstance(value, Mapping) and value is not None
    ]
    for key, value in data.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{key}]", toml_text(value).rstrip("\n")]
    return "\n".join(lines) + "\n"


def _toml_value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(_toml_value(v) for v in value)}]"
    escaped = "".join(_escape(c) for c in str(value))
    return f'"{escaped}"'


def _escape(character: str) -> str:
    """TOML's escapes of a basic string."""
    if character in '"\\':
        return f"\\{character}"
    return character if character >= " " and character != "\x7f" else f"\\u{ord(character):04x}"
