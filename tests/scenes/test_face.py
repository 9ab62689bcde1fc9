"""Faces with several markers: views off the axis, and frames put together from one rendering each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments import chain
from experiments.scenario import Scenario, load_scenario
from scenes.face import PlacedMarker, check_apart, face_view, in_frame, render_face
from scenes.marker import MarkerDesign
from scenes.render.transport import Quality, render_basis

LEFT, RIGHT = PlacedMarker(MarkerDesign(), (-0.09, 0.02)), PlacedMarker(MarkerDesign(identity=1), (0.09, -0.02))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(
        overrides=(
            "range_m=3",
            "camera.width_px=320",
            "camera.height_px=240",
            "target.pitch_deg=20",
            "target.yaw_deg=-10",
            "target.roll_deg=15",
        )
    )


def test_a_marker_at_the_centre_is_seen_as_ever(scenario: Scenario) -> None:
    view = chain.view(scenario)
    seen = face_view(view, PlacedMarker(scenario.marker, (0.0, 0.0)))
    points = scenario.marker.corners_m
    assert seen.to_image(points) == pytest.approx(view.to_image(points))
    assert seen.target == view.target


def test_a_place_on_the_face_is_where_the_face_has_it(scenario: Scenario) -> None:
    view = chain.view(scenario)
    on_face = LEFT.design.corners_m + np.array([*LEFT.centre_m, 0.0])
    seen = face_view(view, LEFT)
    assert seen.to_image(LEFT.design.corners_m) == pytest.approx(view.to_image(on_face))
    # The face itself stays: its centre in the marker's frame is the way back.
    assert seen.target.face_centre_m == (-LEFT.centre_m[0], -LEFT.centre_m[1])
    assert in_frame(view, LEFT)
    assert not in_frame(view, PlacedMarker(MarkerDesign(), (0.3, 0.0)))


def test_markers_that_overlap_and_faces_without_any_are_refused(scenario: Scenario) -> None:
    close = PlacedMarker(MarkerDesign(identity=2), (0.0, 0.0))
    with pytest.raises(ValueError, match=r"overlap by 0\.01 m; expected them apart"):
        check_apart([LEFT, close])
    with pytest.raises(ValueError, match="no marker, expected at least one"):
        render_face(chain.view(scenario), [])


def test_each_marker_stands_in_the_frame_as_it_is_rendered_alone(scenario: Scenario) -> None:
    view, quality = chain.view(scenario), Quality(1, 400_000, 1)
    together = render_face(view, [LEFT, RIGHT], quality)
    alone = render_basis(face_view(view, RIGHT), replace(quality, seed=2))
    middle = face_view(view, RIGHT).to_image(np.zeros((1, 3)))[0].astype(int)
    box = np.s_[:, middle[1] - 20 : middle[1] + 20, middle[0] - 20 : middle[0] + 20]
    assert np.array_equal(together.layers["led"][box], alone.layers["led"][box])

    rate = chain.electron_rate(scenario, together, "eclipse")
    seconds = chain.solve_exposure(scenario, chain.link_budget(scenario, "eclipse"), "auto")
    frame = chain.expose(scenario, rate, "eclipse", seconds).dn
    for placed in (LEFT, RIGHT):
        here = scenario.at(marker=placed.design.model_dump())
        found = chain.detect(here, frame).features
        truth = face_view(view, placed).to_image(placed.design.corners_m)
        assert found.corners_px is not None
        # A tenth of a pixel: some four standard deviations of a corner here.
        assert np.abs(found.corners_px - truth).max() < 0.1
