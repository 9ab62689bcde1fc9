"""A starter scenario says what holds, stays true line by line, and names to choose from can be listed."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from experiments.scenario import MATERIAL_KEYS, load_data, load_scenario, validate
from experiments.scenario.catalogue import SHOWN, catalogue, row, section_of
from experiments.scenario.keys import find, scenario_keys, sections
from experiments.scenario.presets import SECTIONS
from experiments.scenario.starter import SCHEMA_FILE, starter
from materials import library

Mantis = Callable[..., tuple[int, str, str]]


def uncommented(text: str) -> str:
    """Every key that stands commented out with a value, switched on, but presets, which other keys would contradict."""
    lines = text.splitlines()
    keys = (re.sub(r"^# (?=[a-z_0-9]+ = [^ ])", "", line) for line in lines if not line.startswith("# preset"))
    return "\n".join(re.sub(r"^# (?=\[)", "", line) for line in keys)


@pytest.mark.parametrize("overrides", [(), ("sensor.preset=imx287", "leds.count=20"), ("earth.albedo=0.4",)])
def test_a_starter_is_the_scenario_it_was_made_from(overrides: tuple[str, ...]) -> None:
    data = load_data(None, overrides)
    written = validate(tomllib.loads(starter(data)))
    assert written.digest() == load_scenario(None, overrides).digest()


@pytest.mark.parametrize("overrides", [(), ("sensor.preset=imx287",), ("filter.preset=bp850_25", "earth.albedo=0.4")])
def test_a_line_shows_what_holds_while_it_is_commented_out(overrides: tuple[str, ...]) -> None:
    data = load_data(None, overrides)
    text = uncommented(starter(data))
    text = re.sub(r"^preset = .*$", "", text, flags=re.MULTILINE)
    expected = load_scenario(None, overrides)
    if expected.earth is None:
        text = text[: text.index("[earth]")]
    assert validate(tomllib.loads(text)) == expected


def test_every_key_stands_in_the_starter_with_its_meaning_unit_and_default() -> None:
    text = starter({})
    section = ""
    shown = {}
    for line in text.splitlines():
        if heading := re.fullmatch(r"(?:# )?\[(\w+)\]", line):
            section = heading[1] + "."
        if match := re.match(r"(?:# )?(\w+) =(.*?) # (.*)", line):
            shown[section + match[1]] = match[3]
    for key in scenario_keys():
        assert key.meaning in shown[key.dotted]
        assert not key.unit or shown[key.dotted].startswith(f"[{key.unit}]")
    assert {f"{s}.preset" for s in SECTIONS} == set(shown) - {key.dotted for key in scenario_keys()}


def test_an_absent_section_comes_last_so_that_its_keys_cannot_fill_another() -> None:
    """Rationale: `phase_deg`, uncommented without its `[earth]`, would else move the Sun."""
    absent = [section.name for section in sections() if not section.present]
    headings = re.findall(r"^(?:# )?\[(\w+)\]$", starter({}), re.MULTILINE)
    assert absent
    assert headings[-len(absent) :] == absent


def test_new_writes_file_and_schema_and_leaves_a_file_alone(mantis: Mantis, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    status, out, error = mantis("new", "-o", path, "--set", "leds.count=7", "--seed", "5")
    assert (status, error) == (0, "")
    assert "mantis budget" in out
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"#:schema ./{SCHEMA_FILE}\n")
    assert (load_scenario(path).leds.count, load_scenario(path).seed) == (7, 5)
    schema = json.loads((tmp_path / SCHEMA_FILE).read_text(encoding="utf-8"))
    assert set(tomllib.loads(text)) <= set(schema["properties"])
    status, _, error = mantis("new", "-o", path)
    assert (status, "exists" in error) == (2, True)
    assert path.read_text(encoding="utf-8") == text
    assert mantis("new", "--from", path)[1] == text
    assert mantis("new", "--set", "leds.cuont=7")[0] == 2


def test_a_preset_written_into_a_new_file_takes_effect(mantis: Mantis, tmp_path: Path) -> None:
    """Rationale: keys beside a preset win, so a new file may write none out that nobody asked for."""
    path = tmp_path / "mine.toml"
    assert mantis("new", "-o", path)[0] == 0
    text = path.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if "imx287" in line)
    path.write_text(text.replace(line, 'preset = "imx287"'), encoding="utf-8")
    chosen = load_scenario(None, ("sensor.preset=imx287",))
    assert load_scenario(path).sensor == chosen.sensor
    assert load_scenario(path).camera == chosen.camera


def test_the_schema_knows_materials_and_sweeps(mantis: Mantis) -> None:
    target = json.loads(mantis("schema")[1])["$defs"]["Target"]["properties"]
    assert all(target[key]["anyOf"][0]["enum"] == list(library.available()) for key in MATERIAL_KEYS)
    assert "grid" in json.loads(mantis("schema", "sweep")[1])["properties"]


@pytest.mark.parametrize("section", SHOWN)
def test_whatever_is_listed_can_be_set(section: str) -> None:
    heading, columns = SHOWN[section]
    entries = catalogue(section)
    assert heading
    assert len(entries) >= 3
    for entry in entries:
        assert load_scenario(None, (entry.setting,))
        assert len(row(section, entry)) == 1 + len(columns)
        assert len(entry.source) > 20
    assert section_of(heading.split(",")[0]) == section


def test_presets_are_listed_with_their_sources(mantis: Mantis) -> None:
    listed = json.loads(mantis("presets", "--json")[1])
    assert set(listed) == set(SHOWN)
    assert {entry["name"] for entry in listed["sensor"]} >= {"imx287", "gt4096nir"}
    assert "[1/sr]" not in mantis("presets")[1]  # square brackets are markup of the terminal's tables
    assert "thesis table 3.1" in mantis("presets", "lenses")[1].replace("\n", " ")
    status, _, error = mantis("presets", "cammera")
    assert (status, "expected one of" in error) == (2, True)


#: What somebody may type -> what the one line must suggest.
SUGGESTIONS = {
    "focal_length_m=0.03": "did you mean 'camera.focal_length_m'",
    "leds.exposure_s=1": "did you mean 'exposure_s'",
    "exposure_ms=3": "did you mean 'exposure_s' (exposure and LED pulse [s], or 'auto')?",
    "earth.albdo=0.2": "did you mean 'earth.albedo'",
    "cammera.f_number=2": "did you mean 'camera'?",
    "tape=x": "did you mean 'target.tape_material'",
    "filter=bp850_25": "did you mean filter.preset = 'bp850_25'?",
    "filter.preset=bp850_52": "did you mean 'bp850_50'?",
    "target.preset=x": "the sections camera, filter, leds, marker, sensor take a preset",
    "preset=imx287": "the sections camera, filter, leds, marker, sensor take a preset",
    "camera=5": "expected a section of keys, say camera.width_px",
    "earth=none": "expected a section of keys, say earth.phase_deg",
    "budget.ranges_m=5": "expected a list in square brackets (ranges [m], increasing)",
    "marker.dictionary=4x4_50": "marker.dictionary: '4x4_50' is not one of OpenCV's",
}


@pytest.mark.parametrize("override", SUGGESTIONS)
def test_a_mistake_is_answered_with_what_was_meant(override: str) -> None:
    with pytest.raises(ValueError, match=re.escape(SUGGESTIONS[override])):
        load_scenario(None, (override,))


def test_a_key_can_be_looked_up() -> None:
    assert find("leds.half_angle_deg").unit == "deg"
    assert find("camera.psf_sigma_px").bounds == "0 to 20"
    with pytest.raises(ValueError, match=r"did you mean 'leds\.count'"):
        find("leds.cuont")
