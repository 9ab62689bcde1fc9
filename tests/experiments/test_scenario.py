"""Scenario files: what they say, what they refuse, and a digest that follows the physics alone."""

from __future__ import annotations

import json
import random
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from experiments.scenario import Scenario, ScenarioError, json_schema, load_scenario, shipped_scenarios, validate

DEFAULT = load_scenario()

#: Unit that a field's name ends with -> how its description writes it. Counts (columns, pixels per bit) need none.
UNITS = {
    "_w_m2": "[W/m²]",
    "_w_sr": "[W/sr]",
    "_deg_s": "[deg/s]",
    "_electrons_per_s": "[e-/s]",
    "_electrons_per_dn": "[e-/DN]",
    "_electrons": "[e-]",
    "_dn": "[DN]",
    "_deg": "[deg]",
    "_nm": "[nm]",
    "_au": "[au]",
    "_c": "[deg C]",
    "_k": "[K]",
    "_m": "[m]",
    "_s": "[s]",
    "_w": "[W]",
}


def leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted name and field of everything in a model that is a value."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from leaves(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field


LEAVES = dict(leaves(Scenario))


def value_of(scenario: Scenario, key: str) -> Any:
    value: Any = scenario
    for part in key.split("."):
        value = getattr(value, part)
    return value


@pytest.mark.parametrize("key", LEAVES)
def test_every_field_is_described_with_its_unit(key: str) -> None:
    description = LEAVES[key].description
    assert description, key
    suffix = next((s for s in UNITS if key.endswith(s)), None)
    if suffix is not None:
        assert UNITS[suffix] in description or "or 'auto'" in description, f"{key}: {description}"


def test_the_default_file_says_what_the_models_say() -> None:
    assert validate({"title": DEFAULT.title}) == DEFAULT
    text = (files("experiments") / "scenarios" / "default.toml").read_text(encoding="utf-8")
    written = {f"{a}.{b}" for a, section in tomllib.loads(text).items() if isinstance(section, dict) for b in section}
    assert written <= set(LEAVES)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_by_name_and_keep_their_digest_when_written_out(name: str) -> None:
    scenario = load_scenario(name)
    assert validate(scenario.model_dump()).digest() == scenario.digest()
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


#: Values other than the default where a small change of it would not be valid.
OTHERS: dict[str, Any] = {
    "illumination": "sunlit",
    "exposure_s": 1e-3,
    "title": "another",
    "marker.dictionary": "4X4_100",
    "filter.effective_index": 2.0,
    "target.face_material": "diffuse_reference",
    "target.tape_material": "tape_type_ix",
    "render.wavelength_nodes": 8,
    "target.absorber_material": "diffuse_reference",
    "budget.illuminations": ("sunlit",),
    "camera.focus_m": 3.0,
    "camera.point_source_transmittance": ((20.0, 1e-5), (60.0, 1e-7)),
    "target.edge_radius_m": 0.01,
    "target.edge_material": "white_paint",
}


def another(key: str) -> Any:
    """A valid value other than the default's."""
    value = value_of(DEFAULT, key)
    if key in OTHERS:
        return OTHERS[key]
    if key in ("marker.element_offsets_m", "target.face_centre_m"):  # of a fixed length
        return tuple(v + 1e-3 for v in value)
    if isinstance(value, tuple):
        return value[:-1]
    if isinstance(value, int):
        return value + 1
    assert isinstance(value, float), key
    return value * 0.99 if value else 0.25


def test_the_digest_changes_with_an_optional_section() -> None:
    lit, brighter = load_scenario(overrides=("earth.albedo=0.3",)), load_scenario(overrides=("earth.albedo=0.4",))
    assert len({DEFAULT.digest(), lit.digest(), brighter.digest()}) == 3


@pytest.mark.parametrize("key", [key for key in LEAVES if value_of(DEFAULT, key) is not None or key in OTHERS])
def test_the_digest_changes_with_every_key(key: str) -> None:
    value = another(key)
    text = json.dumps(list(value) if isinstance(value, tuple) else value)
    changed = load_scenario(overrides=(f"{key}={text}",))
    assert value_of(changed, key) == value
    assert changed.digest() != DEFAULT.digest()


def test_the_digest_does_not_depend_on_how_the_file_is_written(tmp_path: Path) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text("range_m = 3\n[leds]\ncount = 50\nfwhm_nm = 2\n[camera]\nf_number = 4\n")
    second.write_text("# the same\nrange_m = 3.0\ncamera.f_number = 4e0\n\n[leds]\nfwhm_nm = 2.0\ncount = 5_0\n")
    scenario = load_scenario(first)
    assert load_scenario(second) == scenario
    assert load_scenario(second).digest() == scenario.digest()
    assert len(scenario.digest()) == 16
    spelled_out = Scenario.model_validate(dict(reversed(scenario.model_dump().items())))
    assert spelled_out.digest() == scenario.digest()


NUMBERS = {
    "range_m": st.floats(0.05, 1000),
    "seed": st.integers(0, 2**63 - 1),
    "exposure_s": st.floats(1e-9, 100) | st.just("auto"),
    "illumination": st.sampled_from(["eclipse", "sunlit"]),
    "title": st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), max_size=40),
    "camera.f_number": st.floats(0.5, 64),
    "camera.width_px": st.integers(16, 16384),
    "camera.psf_sigma_px": st.floats(0, 20),
    "filter.low_nm": st.floats(300, 840),
    "filter.high_nm": st.floats(900, 1200),
    "sensor.quantum_efficiency": st.floats(0, 1),
    "sensor.bits": st.integers(8, 16),
    "leds.count": st.integers(1, 100_000),
    "leds.fwhm_nm": st.floats(0.1, 200),
    "sun.phase_deg": st.floats(0, 180),
    "target.yaw_deg": st.floats(-80, 80),
    "marker.size_m": st.floats(1e-3, 1),
    "budget.ranges_m": st.lists(st.floats(0.05, 1000), min_size=1, max_size=5, unique=True).map(sorted),
    "budget.exposures_s": st.lists(st.floats(1e-9, 100) | st.just("auto"), min_size=1, max_size=3, unique=True),
}


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.fixed_dictionaries({}, optional=NUMBERS), st.randoms(use_true_random=False))
def test_a_scenario_survives_being_written_and_read(values: dict[str, Any], order: random.Random) -> None:
    overrides = [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in values.items()]
    scenario = load_scenario(overrides=tuple(overrides))
    for key, value in values.items():
        assert value_of(scenario, key) == (tuple(value) if isinstance(value, list) else value)
    assert validate(scenario.model_dump()) == scenario
    assert validate(json.loads(scenario.model_dump_json())) == scenario
    order.shuffle(overrides)
    again = load_scenario(overrides=tuple(overrides))
    assert (again, again.digest()) == (scenario, scenario.digest())
    assert (scenario.digest() == DEFAULT.digest()) == (scenario == DEFAULT)


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("leds.count=50", "leds.count", 50),
        ("exposure_s=1e-3", "exposure_s", 1e-3),
        ("exposure_s=auto", "exposure_s", "auto"),
        ('exposure_s="auto"', "exposure_s", "auto"),
        (" range_m = 7 ", "range_m", 7.0),
        ("title=two words", "title", "two words"),
        ("title=a=b", "title", "a=b"),
        ("budget.ranges_m=[1, 2.5]", "budget.ranges_m", (1.0, 2.5)),
        ('budget.exposures_s=[1e-3, "auto"]', "budget.exposures_s", (1e-3, "auto")),
        (
            "sensor.quantum_efficiency=[[800, 0.3], [900, 0.2]]",
            "sensor.quantum_efficiency",
            ((800.0, 0.3), (900.0, 0.2)),
        ),
        ("leds={count = 7}", "leds.count", 7),
    ],
)
def test_overrides_are_toml_and_bare_words_are_strings(override: str, key: str, value: object) -> None:
    assert value_of(load_scenario(overrides=(override,)), key) == value


def test_later_overrides_win() -> None:
    assert load_scenario(overrides=("range_m=3", "range_m=5")).range_m == 5
    assert load_scenario(overrides=("leds.count=3", "leds={fwhm_nm = 2}")).leds.count == DEFAULT.leds.count


def test_of_several_mistakes_the_first_is_told_and_the_others_counted() -> None:
    with pytest.raises(ScenarioError, match=r"^range_m: -1, .* \(and 1 more\)$"):
        validate({"range_m": -1, "leds": {"count": 0}})
    with pytest.raises(ScenarioError) as one:  # one mistake, though neither a number nor 'auto' takes it
        validate({"exposure_s": -1})
    assert "more)" not in str(one.value)


def test_a_copy_with_changes_is_validated_anew() -> None:
    assert DEFAULT.at(range_m=7).range_m == 7
    with pytest.raises(ValueError, match="range_m"):
        DEFAULT.at(range_m=-1)
    with pytest.raises(ValueError, match="frozen"):
        DEFAULT.range_m = 3  # type: ignore[misc]


def test_the_schema_describes_every_key() -> None:
    schema = json_schema()
    for key in LEAVES:
        node = schema
        for part in key.split("."):
            reference = node.get("$ref") or node.get("allOf", [{}])[0].get("$ref")
            node = schema["$defs"][reference.rsplit("/", 1)[1]] if reference else node
            node = node["properties"][part]
        assert node["description"] == LEAVES[key].description


@pytest.mark.parametrize(("key", "now"), [("light", "illumination"), ("budget.lights", "budget.illuminations")])
def test_a_key_of_an_earlier_version_is_told_its_name_of_today(key: str, now: str) -> None:
    with pytest.raises(ScenarioError, match=f"^{key}: unknown key; it is '{now}' now") as caught:
        load_scenario(None, (f'{key}="sun"',))
    assert "\n" not in str(caught.value)
