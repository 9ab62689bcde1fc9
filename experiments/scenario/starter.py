"""A commented scenario file to begin with: every key with its default, unit, bounds and meaning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from experiments.scenario.keys import Key, KeySection, scenario_keys, sections
from experiments.scenario.presets import expand
from experiments.scenario.toml import toml_text

#: Name of the schema that is written beside a starter file, where its first line tells an editor to look.
SCHEMA_FILE = "mantis-scenario.schema.json"
#: Top keys that are written out even at their defaults, for they are the first to be changed.
_ALWAYS = ("title", "range_m", "illumination", "exposure_s", "seed")
_HEAD = f"""\
#:schema ./{SCHEMA_FILE}
# A Mantis scenario. A line that begins with "# " shows a key and what holds while it stays so: delete the "# " and
# change the value. `mantis presets` lists what can be named; angles are in degrees, all else in SI units and nm.
"""
_COLUMN = 46


def starter(data: Mapping[str, Any]) -> str:
    """TOML text of a scenario: what `data` says is written out, every other key stands commented out at its default.

    Args:
        data: nested plain data as `scenario.load_data` gives it, presets not expanded; valid.
    """
    full = expand(dict(data))
    lines = [_HEAD]
    lines += [_line(key, data.get(key.name), key.name in data or key.name in _ALWAYS) for key in _keys("")]
    # A section that is absent by default comes last: its keys, uncommented without its heading, must not fill another.
    for section in sorted(sections(), key=lambda s: not s.present):
        written, filled = data.get(section.name), full.get(section.name) or {}
        lines += ["", f"# {section.about}", f"{'' if section.present or written is not None else '# '}[{section.name}]"]
        values = written if isinstance(written, Mapping) else {}
        if section.presets:
            lines.append(_preset_line(section, values.get("preset")))
        lines += [_line(key, filled.get(key.name), key.name in values) for key in _keys(section.name)]
    return "\n".join(lines) + "\n"


def _keys(section: str) -> list[Key]:
    return [key for key in scenario_keys() if key.section == section]


def _preset_line(section: KeySection, chosen: str | None) -> str:
    text = f'preset = "{chosen}"' if chosen else f'# preset = "{section.presets[0]}"'
    return f"{text:<{_COLUMN}} # {' | '.join(section.presets)}: fills the section; keys written beside it win"


def _line(key: Key, value: Any, written: bool) -> str:
    shown = value if value is not None else key.default
    text = f"{key.name} =" if shown is None else toml_text({key.name: _short(shown)}).strip()
    default = f"default {_default(key)}; " if written and value is not None and value != key.default else ""
    parts = [key.unit and f"[{key.unit}]", f"{default}{key.meaning}", _takes(key)]
    return f"{text if written else f'# {text}':<{_COLUMN}} # {' '.join(filter(None, parts))}"


def _default(key: Key) -> str:
    return "none" if key.default is None else toml_text({"x": _short(key.default)}).strip().removeprefix("x = ")


def _takes(key: Key) -> str:
    """Bounds, and the kind where the default does not show it."""
    kind = key.kind if " or " in key.kind or key.default in (None, []) else ""
    told = ", ".join(filter(None, (kind, key.bounds)))
    return f"({told})" if told else ""


def _short(value: Any) -> Any:
    """Whole numbers without their '.0', also within lists."""
    if isinstance(value, (list, tuple)):
        return [_short(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 1e9 else value
