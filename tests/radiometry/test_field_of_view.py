"""Equations 5.17 to 5.20: the thesis's digits, and the right forms against the marker's geometry and the slit model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.elements.slits import Slits
from radiometry import field_of_view as fov
from radiometry.geometry import attitude_matrix
from scenes.marker import MarkerDesign

SOME = settings(deadline=None, derandomize=True, max_examples=40)
#: Thesis section 5.6: d = 0.25 w and V = 2 d.
PRINTED = fov.element_sides(1.0, 0.25, 0.5)


def test_the_thesiss_numbers_come_out() -> None:
    assert np.degrees(PRINTED) == pytest.approx([26.6, 56.3], abs=0.05)
    assert np.degrees(sum(PRINTED)) == pytest.approx(82.9, abs=0.05)
    less = fov.with_margin(PRINTED, np.radians(18))
    assert np.degrees(sum(less)) == pytest.approx(46.9, abs=0.05)
    assert np.degrees(fov.combined_field(less)) == pytest.approx(76.6, abs=0.05)


def test_equal_angles_lie_on_the_ellipse() -> None:
    for lateral, expected in ((100.0, 35.8), (50.0, 30.4)):
        angle = fov.equal_angles(np.radians(lateral), np.radians(38.31))
        assert np.degrees(angle) == pytest.approx(expected, abs=0.05)
        assert fov.ellipse(angle, angle, np.radians(lateral), np.radians(38.31)) == pytest.approx(1)


@given(length=st.floats(0.01, 1), ratio=st.floats(0.1, 5))
@SOME
def test_the_one_sided_field_is_the_field_with_the_line_under_an_end(length: float, ratio: float) -> None:
    depth = ratio * length
    assert fov.one_sided_field(length, depth) == pytest.approx(sum(fov.element_sides(length, 0.0, depth)))
    assert fov.centred_field(length, depth) == pytest.approx(sum(fov.element_sides(length, length / 2, depth)))


@given(pitch=st.floats(-1.2, 1.2), yaw=st.floats(-1.2, 1.2), roll=st.floats(-3, 3))
@SOME
def test_slopes_are_those_of_the_direction_to_the_camera(pitch: float, yaw: float, roll: float) -> None:
    towards = attitude_matrix(pitch, yaw, roll).T @ np.array([0, 0, -1.0])
    expected = towards[:2] / towards[2]
    assert np.array(fov.slopes(pitch, yaw)) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@given(offset=st.floats(0, 0.45), depth=st.floats(0.2, 0.99), size=st.floats(0.02, 1))
@SOME
def test_sides_are_where_the_markers_blob_reaches_the_margin(offset: float, depth: float, size: float) -> None:
    marker = MarkerDesign(size_m=size, virtual_offset_fraction=offset, virtual_depth_fraction=depth)
    top, length = marker.elements[0], marker.element_length_m
    margin = 0.1 * length
    near, far = fov.element_sides(length, (0.5 - offset) * length, top.virtual_depth_m, margin)
    camera = 1e7 * length * np.array([[np.sin(near), 0, np.cos(near)], [-np.sin(far), 0, np.cos(far)]])
    assert top.blob_offset_m(camera) == pytest.approx([length / 2 - margin, margin - length / 2], rel=1e-4)


@given(slits=st.integers(5, 60), slat=st.floats(0.05, 0.6), depth=st.floats(0.05, 0.3))
@SOME
def test_blob_and_its_cut_are_the_slit_models(slits: int, slat: float, depth: float) -> None:
    marker = MarkerDesign(slit_count=slits, slat_fraction=slat, element_depth_fraction=depth)
    top, length = marker.elements[0], marker.element_length_m
    model = Slits(marker, top, np.array([0.0, 0.0, 1e6]))
    half = fov.blob_half_base(length / slits * (1 - slat), top.depth_m, top.virtual_depth_m)
    assert half == pytest.approx(model.half_width, rel=1e-5)
    if half < length / 2:
        for fraction in (0.0, 0.05, 0.3, 0.5):
            room = fov.margin_of_cut(half, fraction)
            assert model.cut_fraction(length / 2 - room) == pytest.approx(fraction, abs=1e-5)


def test_a_cut_of_more_than_half_is_refused() -> None:
    with pytest.raises(ValueError, match=r"cut_fraction: 0\.6, expected 0 to 0\.5"):
        fov.margin_of_cut(1.0, 0.6)


@given(slope=st.floats(-3, 3), width=st.floats(0.1, 1), depth=st.floats(0.05, 1))
@SOME
def test_lateral_share_is_the_floor_that_a_sight_line_past_the_wall_reaches(
    slope: float, width: float, depth: float
) -> None:
    """Rays along the sight line through the opening, counted where they hit the floor between the walls."""
    x = (np.arange(20_000) + 0.5) / 20_000 * width
    landed = x - slope * depth
    counted = np.mean((landed > 0) & (landed < width))
    assert float(fov.lateral_share(slope, width, depth)) == pytest.approx(counted, abs=2e-4)
    limit = fov.lateral_limit(width, depth, 0.25)
    assert float(fov.lateral_share(np.tan(limit), width, depth)) == pytest.approx(0.25)


def test_the_field_is_a_rectangle_in_slopes() -> None:
    sides, across = fov.Sides(0.3, 0.9), 1.0
    inside = fov.in_field([0.0, np.tan(0.89), -np.tan(0.29), 0.0], [0.0, 0.0, 0.0, np.tan(0.99)], sides, across)
    outside = fov.in_field([np.tan(0.91), -np.tan(0.31), 0.0], [0.0, 0.0, -np.tan(1.01)], sides, across)
    assert inside.all()
    assert not outside.any()
    assert fov.in_field(
        np.tan(0.89), np.tan(0.99), sides, across
    )  # a corner that every ellipse within the sides leaves out
    assert fov.ellipse(0.99, 0.89, across, sides.far) > 1


def test_opposite_elements_that_do_not_overlap_leave_their_gap_out() -> None:
    assert fov.combined_field(fov.Sides(0.1, 0.5)) == pytest.approx(1.0)
    assert fov.combined_field(fov.Sides(-0.1, 0.5)) == pytest.approx(0.8)
