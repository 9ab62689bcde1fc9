"""Named presets of scenario sections: ``sensor.preset = "imx287"`` fills the section, keys written beside it win."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from experiments.scenario.errors import nearest

#: Sections that take a preset, and the data file, package and name, of those that are not the sensor's.
SECTIONS = {
    "camera": ("radiometry", "lenses"),
    "filter": ("radiometry", "filters"),
    "leds": ("radiometry", "leds"),
    "marker": ("scenes", "markers"),
    "sensor": None,
}


@cache
def presets(section: str) -> dict[str, dict[str, Any]]:
    """Fields of every preset of a section, by name, without its source."""
    if SECTIONS[section] is None:
        from detector.sensor.sensor import presets as sensors

        return {name: preset.sensor.model_dump() for name, preset in sensors().items()}
    return {name: {k: v for k, v in fields.items() if k != "source"} for name, fields in table(section).items()}


def table(section: str) -> dict[str, dict[str, Any]]:
    """The data file of a section that has one: fields and source of every preset, by name."""
    place = SECTIONS[section]
    assert place is not None
    package, name = place
    return tomllib.loads((files(package) / "data" / f"{name}.toml").read_text(encoding="utf-8"))


def expand(data: dict[str, Any]) -> dict[str, Any]:
    """Scenario data with every ``preset`` replaced by what it stands for.

    A sensor's preset also sets the camera's pixel grid, for the two are one piece of silicon.

    Raises:
        ValueError: when a preset is unknown, naming those there are, or stands where none is taken.
    """
    result = dict(data)
    for section, fields in data.items():
        if section == "preset" or (section not in SECTIONS and isinstance(fields, dict) and "preset" in fields):
            key = section if section == "preset" else f"{section}.preset"
            raise ValueError(f"{key}: unknown key; the sections {', '.join(SECTIONS)} take a preset")
    for section in SECTIONS:
        fields = result.get(section)
        if isinstance(fields, str) and fields in presets(section):
            raise ValueError(
                f"{section}: {fields!r}, expected a section of keys; did you mean {section}.preset = {fields!r}?"
            )
        if not isinstance(fields, dict) or "preset" not in fields:
            continue
        rest = {key: value for key, value in fields.items() if key != "preset"}
        known = presets(section)
        if fields["preset"] not in known:
            near = nearest(str(fields["preset"]), list(known))
            raise ValueError(
                f"{section}.preset: {fields['preset']!r} is unknown; expected one of {', '.join(sorted(known))}"
                + (f"; did you mean {near!r}?" if near else "")
            )
        result[section] = {**known[fields["preset"]], **rest}
        if section == "sensor" and isinstance(camera := result.get("camera", {}), dict):
            result["camera"] = {**_grid(fields["preset"]), **camera}
    return result


def clear_for_preset(data: dict[str, Any], section: str, name: str) -> None:
    """Remove from a file's data what a preset that is set from outside is to replace."""
    for key in presets(section).get(name, {}):
        data.get(section, {}).pop(key, None)
    if section == "sensor" and name in presets(section):
        for key in _grid(name):
            data.get("camera", {}).pop(key, None)


def _grid(sensor: str) -> dict[str, Any]:
    from detector.sensor.sensor import presets as sensors

    return dict(sensors()[sensor].grid)
