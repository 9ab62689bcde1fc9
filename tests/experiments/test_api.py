"""The functions for notebooks give what the chain gives, and show themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import api, chain
from experiments.reporting import notebook
from experiments.reporting.files import write_png
from experiments.scenario import Scenario, load_scenario

SCENARIO = load_scenario()


def test_the_closed_form_over_keys_is_the_budget_of_each_case() -> None:
    axes = {"exposure_s": [1e-6, "auto"], "range_m": [3, 9], "leds.count": [20, 100], "illumination": ["sunlit"]}
    found = api.closed_form(SCENARIO, axes)
    assert dict(found.sizes) == {"exposure_s": 2, "range_m": 2, "leds.count": 2, "illumination": 1}
    assert list(found.snr.dims) == list(axes)
    here = SCENARIO.changed("range_m=9", "leds.count=20", "illumination=sunlit")
    budget = chain.link_budget(here, "sunlit")
    for exposure in (1e-6, "auto"):
        seconds = chain.solve_exposure(here, budget, exposure)
        case = found.sel({"exposure_s": str(exposure), "range_m": 9, "leds.count": 20, "illumination": "sunlit"})
        assert float(case.seconds) == seconds
        for name, value in budget.at(seconds).items():
            assert float(case[name]) == value
    assert found.range_m.attrs["units"] == "m"
    assert found.snr.attrs["long_name"]


def test_the_binding_criterion_is_the_one_with_the_smallest_margin() -> None:
    found = api.closed_form(SCENARIO, {"range_m": [4, 20], "exposure_s": [1 / 30, "auto"]})
    assert found.binds.values.tolist() == [["saturation", "saturation"], ["saturation", "sampling"]]
    assert (found.margin < 1).values.tolist() == [[True, False], [True, True]]


def test_a_marker_outside_the_frame_gives_no_figure() -> None:
    narrow = SCENARIO.changed("camera.width_px=64", "camera.height_px=64")
    found = api.closed_form(narrow, {"range_m": [0.05]})
    assert np.isnan(found.margin.values).all()
    assert found.binds.values.tolist() == ["frame"]


def test_an_unknown_axis_is_refused_with_the_nearest_key() -> None:
    with pytest.raises(ValueError, match="did you mean 'range_m'"):
        api.closed_form(SCENARIO, {"range": [1, 2]})


def test_a_shot_is_what_the_command_line_exposes_and_detects(small: Scenario, tmp_path: Path) -> None:
    shot = api.shoot(small)
    basis = chain.transport(small)
    rate = chain.electron_rate(small, basis, small.illumination)
    np.testing.assert_array_equal(shot.frame, chain.expose(small, rate, small.illumination, shot.exposure_s).dn)
    assert shot.detection.features.detected
    assert shot.range_error < 0.01
    write_png(shot.frame, tmp_path / "frame.png")
    again = api.detect(tmp_path / "frame.png", small)
    assert again.pose is not None
    assert shot.detection.pose is not None
    np.testing.assert_array_equal(again.pose.translation_m, shot.detection.pose.translation_m)
    page = notebook.exposure_html(shot)
    assert page.count("<svg") >= 1
    assert "Position" in page


def test_a_scenario_shows_what_was_changed_and_escapes_its_title() -> None:
    page = notebook.scenario_html(api.load(None, "title=<b>bold</b>", "leds.count=20"))
    assert "&lt;b&gt;bold" in page
    assert "leds.count" in page.split("<details>")[0]
    assert "leds.fwhm_nm" not in page.split("<details>")[0]
    assert "leds.fwhm_nm" in page
    assert "px per bit" in notebook.budget_html(chain.link_budget(SCENARIO, "sunlit"))


def test_a_scenario_explains_its_keys() -> None:
    assert SCENARIO.explain("leds.half_angle_deg").startswith("leds.half_angle_deg = 12.0 deg: angle from the axis")
    assert SCENARIO.explain("camera.focus_m").startswith("camera.focus_m = absent: ")
    with pytest.raises(ValueError, match="did you mean"):
        SCENARIO.explain("leds.half_angle")


def test_changes_to_a_scenario_are_those_of_the_command_line() -> None:
    assert SCENARIO.changed("sensor.preset=imx287").digest() == load_scenario(None, ("sensor.preset=imx287",)).digest()
    assert SCENARIO.with_values({"leds.count": 3}).leds.count == 3
