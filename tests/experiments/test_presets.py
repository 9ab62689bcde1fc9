"""Presets fill a section of a scenario, and what is written beside them wins."""

from __future__ import annotations

import pytest

from detector.sensor.sensor import presets as sensors
from experiments.scenario import Scenario, ScenarioError, json_schema, load_scenario, validate
from experiments.scenario.presets import SECTIONS, presets, table


@pytest.mark.parametrize(("section", "name"), [(s, n) for s in SECTIONS for n in presets(s)])
def test_every_preset_makes_a_valid_scenario_that_survives_a_round_trip(section, name):
    scenario = validate({section: {"preset": name}})
    assert Scenario.model_validate(scenario.model_dump()).digest() == scenario.digest()
    for key, value in presets(section)[name].items():
        assert getattr(getattr(scenario, section), key) == value


def test_keys_beside_a_preset_win():
    scenario = validate({"filter": {"preset": "bp850_25", "transmission": 0.5}})
    assert (scenario.filter.transmission, scenario.filter.low_nm) == (0.5, 837.5)


def test_a_sensor_preset_brings_its_pixel_grid():
    scenario = validate({"sensor": {"preset": "imx287"}, "camera": {"f_number": 4.0}})
    grid = sensors()["imx287"].grid
    assert {key: getattr(scenario.camera, key) for key in grid} == grid
    assert scenario.camera.f_number == 4.0


def test_a_preset_set_on_the_command_line_replaces_what_the_file_says():
    scenario = load_scenario(overrides=("leds.preset=sfh4786s", "leds.count=12", "sensor.preset=cmv4000nir"))
    assert (scenario.leds.centroid_nm, scenario.leds.count) == (810, 12)
    assert scenario.camera.width_px == sensors()["cmv4000nir"].grid["width_px"]


def test_an_unknown_preset_is_refused_with_the_names_there_are():
    with pytest.raises(ScenarioError, match=r"filter\.preset: 'bp' is unknown; expected one of .*bp850_25, .*lp715"):
        load_scenario(overrides=("filter.preset=bp",))


def test_the_schema_offers_presets():
    schema = json_schema()
    assert schema["$defs"]["Bandpass"]["properties"]["preset"]["enum"] == sorted(presets("filter"))


@pytest.mark.parametrize("section", [section for section, place in SECTIONS.items() if place is not None])
def test_every_preset_states_its_source(section):
    data = table(section)
    assert data
    assert all(len(fields["source"]) > 20 for fields in data.values())
