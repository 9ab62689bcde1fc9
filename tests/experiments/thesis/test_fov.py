"""The field of view by closed form against rendered frames."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.scenario import load_scenario
from experiments.thesis.fov import closed_form, figures, page, study
from experiments.thesis.fov.plan import Plan
from scenes.marker import MarkerDesign

PLAN = Plan((2.0,), (-30.0, 0.0, 30.0), 1, (-40.0, -20.0, 0.0, 30.0, 50.0, 70.0), 300_000)
SMALL = Plan((2.0,), (-30.0, 0.0, 30.0), 1, (-30.0, 0.0, 30.0), 100_000)


def test_limits_of_the_design_are_those_of_the_thesis_without_a_margin() -> None:
    found = closed_form.limits(MarkerDesign())
    assert np.degrees(found.sides) == pytest.approx([26.57, 56.31], abs=0.01)
    assert np.degrees(found.printed_marker) == pytest.approx(76.62, abs=0.01)
    assert found.whole.far < found.found.far < found.sides.far
    assert found.half_base_m == pytest.approx(0.16 * MarkerDesign().element_length_m)


def test_fields_of_opposite_elements_are_mirror_images() -> None:
    found = closed_form.limits(MarkerDesign())
    pitch, yaw = np.meshgrid(np.radians(np.linspace(-70, 70, 57)), np.radians(np.linspace(-70, 70, 57)), indexing="ij")
    for one, other in (("top", "bottom"), ("left", "right")):
        for seen in (
            lambda n: closed_form.seen(found, n, pitch, yaw),
            lambda n: closed_form.in_ellipse(found, n, pitch, yaw, True),
        ):
            assert np.array_equal(seen(one), seen(other)[::-1, ::-1])
            assert seen(one).any()
    # The top element's far end lies at −x: a positive yaw, which turns the camera there, shows it longest.
    assert closed_form.seen(found, "top", np.array(0.0), np.radians(50.0))
    assert not closed_form.seen(found, "top", np.array(0.0), np.radians(-50.0))


def test_rendered_light_follows_the_slit_model_and_blobs_are_found_within_the_limits() -> None:
    scenario = load_scenario()
    cut = study.cut_of(scenario, PLAN)
    along, across = figures.expected_light(scenario.marker, 2.0, scenario.leds.ring_radius_m, cut.yaw_deg.values)
    found = closed_form.limits(scenario.marker)
    yaw = np.radians(cut.yaw_deg.values)
    for name, model in (("top", along), ("right", across)):
        seen = closed_form.seen(found, name, np.zeros(len(yaw)), yaw)
        light = cut.light.sel(element=name).values
        # What the model leaves out: fall-off of the tape within the cavity, point spread beyond the opening.
        assert light[seen] == pytest.approx(model[seen], abs=0.015)
        if name == "top":
            assert np.array_equal(cut.found.sel(element=name).values == 1, seen)
            dark = np.isin(cut.yaw_deg.values, [-40.0, 70.0])
            assert (light[dark] < 0.02 * light[seen].min()).all()


def test_the_page_holds_claims_and_tables_of_a_small_run() -> None:
    result = study.run(load_scenario(), SMALL)
    tree, said = result.data, page.claims(result)
    printed = {s.what: s for s in said if s.printed}
    assert printed["field of an element"].agrees
    assert printed["longitudinal field of the marker"].agrees is False
    assert all(np.isnan(s.reproduced) or s.where for s in said)
    rows = page.cone_rows(tree["map"].to_dataset())
    assert {len(row) for row in rows} == {len(rows[0])}
    centre = tree["map"].sel(pitch_deg=0.0, yaw_deg=0.0)
    assert float(centre.virtual.values[0]) == 1
    assert centre.blob.values[0].tolist() == [1, 1, 1, 1]
    assert np.degrees(page.measured_sides(tree["cut"].to_dataset()).far) == pytest.approx(30)
