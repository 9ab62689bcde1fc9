"""Layouts on faces: rules, what is in view, and one pose from several rendered markers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.scenario import load_scenario
from experiments.thesis.layout import page, study
from experiments.thesis.layout.placement import (
    AREA_SHARE_MAX,
    FARTHEST_M,
    LAYOUTS,
    SIDE_SHARE_MAX,
    THESIS_LAYOUTS,
    THICKNESS_MAX_M,
    in_view,
    layout,
    most_markers,
    random_attitudes,
    seen_share,
    smallest_face_m,
)
from experiments.thesis.layout.plan import Plan, RenderedCase
from radiometry.geometry import attitude_matrix
from radiometry.optics import Camera
from scenes.face import check_apart, face_view, in_frame

SOME = settings(deadline=None, derandomize=True, max_examples=30)


@given(face_m=st.floats(1, 10), name=st.sampled_from(sorted(LAYOUTS)))
@SOME
def test_every_layout_keeps_the_footprint_rules_and_fits_its_face(face_m: float, name: str) -> None:
    kind, sizing = LAYOUTS[name]
    lay = layout(kind, face_m, sizing)
    check_apart(lay.placed)
    assert lay.side_share <= SIDE_SHARE_MAX * (1 + 1e-9)
    assert lay.area_share <= AREA_SHARE_MAX * (1 + 1e-9)
    reach = max(abs(v) + p.half_m for p in lay.placed for v in p.centre_m)
    assert reach <= face_m / 2
    assert len({p.design.identity for p in lay.placed}) == len(lay.placed)
    if kind == "nested":
        assert max(p.design.thickness_m for p in lay.placed) <= THICKNESS_MAX_M


def test_the_thesiss_layouts_use_all_that_the_requirement_allows_and_twice_what_the_text_does() -> None:
    for kind in ("wide", "narrow"):
        assert layout(kind, 1.0).area_m2 == pytest.approx(0.05)
    assert most_markers(0.1) == 5
    assert most_markers(0.1, 0.025) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("round", 1.0), "expected wide, narrow or nested"),
        (("wide", 0.5, "fixed"), r"face_m: 0\.5 m, expected at least 1 m"),
    ],
)
def test_layouts_that_do_not_exist_are_refused(arguments: tuple, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        layout(*arguments)


def test_in_view_is_what_the_views_of_the_single_markers_say() -> None:
    scenario = load_scenario(overrides=("range_m=3",))
    placed = layout("wide", 1.0).placed
    attitudes = random_attitudes(12, np.random.default_rng(1))
    seen = in_view(placed, scenario.camera, 3.0, attitudes, 2.0)
    from experiments import chain

    for angles, whole in zip(attitudes, seen.whole, strict=True):
        pitch, yaw, roll = np.degrees(angles)
        turned = scenario.at(
            target={**scenario.target.model_dump(), "pitch_deg": pitch, "yaw_deg": yaw, "roll_deg": roll}
        )
        view = chain.view(turned)
        assert view.rotation == pytest.approx(attitude_matrix(*angles))
        assert [in_frame(view, one) for one in placed] == whole.tolist()
        assert face_view(view, placed[0]).rotation == pytest.approx(view.rotation)


def test_a_marker_is_usable_up_to_the_range_at_which_its_bits_have_the_pixels() -> None:
    camera, px = Camera(), 2.0
    lay = layout("wide", 1.0)
    square = np.zeros((1, 3))
    reach = lay.placed[0].design.bit_m * min(camera.focal_px) / px
    for factor, usable in ((0.999, True), (1.001, False)):
        seen = in_view(lay.placed[:1], camera, factor * reach, square, px)
        assert seen.whole.all()
        assert bool(seen.usable.all()) is usable
    assert smallest_face_m(reach, camera, lay.placed[0].design, px) == pytest.approx(1.0)


def test_a_marker_turned_away_or_behind_the_camera_is_not_usable() -> None:
    lay = layout("wide", 1.0)
    away = in_view(lay.placed, Camera(), 6.0, np.array([[np.pi, 0.0, 0.0]]), 0.01)
    assert away.whole.any()
    assert not away.usable.any()
    assert not in_view(lay.placed, Camera(), 0.1, np.array([[1.4, 0.0, 0.0]]), 0.01).whole[0, :4].any()


@pytest.mark.parametrize("faces", [2, 4, 6])
def test_share_of_directions_within_sight_of_a_marked_face(faces: int) -> None:
    """Against directions drawn at random; five standard errors of a share."""
    draws = 40_000
    towards = np.random.default_rng(faces).standard_normal((draws, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normals = np.concatenate([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]][:faces]
    counted = np.mean((towards @ normals.T).max(axis=1) >= np.cos(np.radians(45)))
    share = seen_share(faces)
    assert share == pytest.approx(counted, abs=5 * np.sqrt(share * (1 - share) / draws))
    with pytest.raises(ValueError, match="expected 0 to 6 faces and at most 45 deg"):
        seen_share(4, 50.0)


def test_nested_rings_cover_what_no_layout_of_the_thesis_does() -> None:
    scenario = load_scenario()
    attitudes = random_attitudes(60, np.random.default_rng(2))

    def covered(name: str, face_m: float) -> bool:
        kind, sizing = LAYOUTS[name]
        placed = layout(kind, face_m, sizing).placed
        ranges = np.arange(1.0, FARTHEST_M + 1)
        return all(in_view(placed, scenario.camera, r, attitudes, 2.0).usable.any(axis=1).all() for r in ranges)

    assert covered("nested", 5.0)
    assert covered("nested", 10.0)
    for name in THESIS_LAYOUTS:
        assert not any(covered(name, face_m) for face_m in (1.0, 2.0, 5.0, 10.0)), name


def test_one_pose_from_all_rendered_markers_beats_the_surest_alone() -> None:
    scenario = load_scenario()
    cases = (RenderedCase("wide", 1.0, (5.0,)),)
    plan = Plan(faces_m=(1.0,), ranges_m=(1.0,), attitudes=2, cases=cases, poses=1, draws=4, rays=60_000)
    rendered = study.rendered(scenario, plan, np.random.default_rng(4))
    assert rendered.sizes["frame"] == 4
    assert (rendered.found >= 4).all()
    medians = rendered.attitude_deg.median("frame")
    assert float(medians.sel(solver="one marker")) > 4 * float(medians.sel(solver="all markers"))
    rows = page.pose_rows(rendered)
    assert len(rows) == 2
    assert len(rows[0]) == len(rows[1])
