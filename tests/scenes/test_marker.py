"""The marker as geometry: every surface where it should be, facing where it should, and the virtual lines it stands for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES, Element, MarkerDesign, aruco_dictionary


@st.composite
def designs(draw: st.DrawFn) -> MarkerDesign:
    """Valid designs: the elements' reach, the ring and the depth are drawn within what the others leave."""
    width = draw(st.floats(0.02, 0.4))
    gap = draw(st.floats(0.02, 0.4))
    return MarkerDesign(
        size_m=draw(st.floats(0.01, 2)),
        identity=draw(st.integers(0, 49)),
        aruco_fraction=draw(st.floats(0.3, 0.999)) * 0.5 / (0.5 + gap + width),
        ring_fraction=draw(st.floats(0.1, 1.0)) * gap,
        gap_fraction=gap,
        element_width_fraction=width,
        element_length_fraction=draw(st.floats(0.2, 0.99)),
        element_depth_fraction=draw(st.floats(0.02, 0.2)),
        virtual_depth_fraction=draw(st.floats(0.21, 0.9)),
        virtual_offset_fraction=draw(st.floats(0, 0.49)),
        slit_count=draw(st.integers(3, 12)),
        slat_fraction=draw(st.floats(0.05, 0.9)),
    )


designed = settings(deadline=None, derandomize=True, max_examples=40)


def triangles(marker: MarkerDesign, material: str) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 3, 3) and unit normals (n, 3)."""
    vertices, faces = marker.meshes()[material]
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def local(element: Element, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coordinates along and across an element from its centre, and depth below the front."""
    relative = points - element.centre_m
    return relative @ element.along, relative @ element.across, -points[..., 2]


def in_a_slit(marker: MarkerDesign, points: FloatArray) -> FloatArray:
    """Whether points below the front lie in open air: within a cavity and not in a slat.

    Independent of the mesh: a point is carried along the ray from the virtual line up to the front plane, where the slits
    are even stripes.
    """
    free = np.zeros(points.shape[:-1], bool)
    for e in marker.elements:
        along, across, depth = local(e, points)
        front = e.virtual_offset_m + (along - e.virtual_offset_m) * e.virtual_depth_m / (e.virtual_depth_m - depth)
        pitch = e.length_m / marker.slit_count
        beside = np.abs((front + e.length_m / 2) / pitch - np.round((front + e.length_m / 2) / pitch))
        inside = (np.abs(front) < e.length_m / 2) & (np.abs(across) < e.width_m / 2) & (depth > 0) & (depth < e.depth_m)
        free |= inside & (beside > marker.slat_fraction / 2)
    return free


OFF = (1e-3, -5e-4, 0.0, 2e-3)


@designed
@given(designs())
def test_the_front_plane_covers_the_square_less_the_openings_once(marker: MarkerDesign) -> None:
    cells = np.array([cell[:4] for cell in marker.plane_cells()])
    area = (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2])
    openings = sum(e.length_m * e.width_m for e in marker.elements)
    # Edges are rounded to 1e-12 m.
    assert area.sum() == pytest.approx(marker.size_m**2 - openings, abs=1e-10 * marker.size_m)
    assert area.min() > 0
    x = np.minimum(cells[:, None, 1], cells[:, 1]) - np.maximum(cells[:, None, 0], cells[:, 0])
    y = np.minimum(cells[:, None, 3], cells[:, 3]) - np.maximum(cells[:, None, 2], cells[:, 2])
    overlap = np.clip(x, 0, None) * np.clip(y, 0, None)
    np.fill_diagonal(overlap, 0)
    assert not overlap.any()


@designed
@given(designs())
def test_the_printed_pattern_is_opencvs(marker: MarkerDesign) -> None:
    """Read back from the cells, at the centre of every bit and around the border."""
    cells = list(marker.plane_cells())

    def material(x: float, y: float) -> str:
        return next(cell[4] for cell in cells if cell[0] < x < cell[1] and cell[2] < y < cell[3])

    image = aruco_dictionary(marker.dictionary).generateImageMarker(marker.identity, 6, borderBits=1)
    for row in range(6):
        for column in range(6):
            # A little off the centre, where a cell's edge may run.
            x = (column + 0.51) * marker.bit_m - marker.aruco_m / 2
            y = marker.aruco_m / 2 - (row + 0.51) * marker.bit_m
            assert material(x, y) == ("retro" if image[row, column] else "absorber")
    ring = marker.aruco_m * (0.5 + marker.ring_fraction / 2)
    assert {material(s * ring, 1e-3 * ring) for s in (-1, 1)} == {"retro"}
    assert {material(1e-3 * ring, s * ring) for s in (-1, 1)} == {"retro"}


def test_reflective_rectangles_are_the_tape_of_the_front_mesh() -> None:
    marker = MarkerDesign()
    cells = marker.reflective_rectangles_m()
    area = np.sum((cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2]))
    white = marker.bits.sum() * marker.bit_m**2
    ring = marker.aruco_m**2 * ((1 + 2 * marker.ring_fraction) ** 2 - 1)
    assert area == pytest.approx(white + ring, rel=1e-9)


def test_white_and_black_bit_centres_lie_on_their_cells() -> None:
    marker = MarkerDesign()
    white, black = marker.white_bit_centres_m(), marker.black_bit_centres_m()
    cells = marker.reflective_rectangles_m()

    def on_tape(points: FloatArray) -> FloatArray:
        x, y = points[:, 0, None] + 1e-6, points[:, 1, None] + 1e-6
        return np.any((cells[:, 0] < x) & (x < cells[:, 1]) & (cells[:, 2] < y) & (y < cells[:, 3]), axis=1)

    assert len(white) == marker.bits.sum()
    assert on_tape(white).all()
    assert not on_tape(black).any()
    assert len(black)
    nearest = np.linalg.norm(black[:, None] - white, axis=2).min(axis=1)
    np.testing.assert_allclose(nearest, marker.bit_m, rtol=1e-9)


@designed
@given(designs())
def test_every_mesh_lies_within_the_markers_box(marker: MarkerDesign) -> None:
    for vertices, faces in marker.meshes().values():
        assert np.abs(vertices[:, :2]).max() <= marker.size_m / 2 * (1 + 1e-9)
        assert vertices[:, 2].max() <= 0
        assert vertices[:, 2].min() >= -marker.thickness_m * (1 + 1e-12)
        assert faces.max() == len(vertices) - 1


@designed
@given(designs())
def test_all_tape_faces_the_viewer_and_the_floors_lie_at_the_cavitys_depth(marker: MarkerDesign) -> None:
    corners, normal = triangles(marker, "retro")
    np.testing.assert_allclose(normal, np.broadcast_to([0.0, 0.0, 1.0], normal.shape), atol=1e-12)
    depth = -corners[..., 2]
    floor = depth[:, 0] > 0
    assert np.count_nonzero(floor) == 2 * len(marker.elements)
    np.testing.assert_allclose(depth[floor], marker.element_depth_m, rtol=1e-12)
    assert not depth[~floor].any()


@designed
@given(designs())
def test_absorbing_surfaces_face_the_air_and_not_the_body(marker: MarkerDesign) -> None:
    """A point just before each triangle is free, one just behind it is not; the half slats' faces on the end walls are hidden."""
    corners, normal = triangles(marker, "absorber")
    centre = corners.mean(axis=1)
    small = 1e-6 * marker.size_m
    half = marker.size_m / 2

    def free(points: FloatArray) -> FloatArray:
        outside = (np.abs(points[:, :2]).max(axis=1) > half) | (points[:, 2] > 0)
        return outside | in_a_slit(marker, points)

    before, behind = free(centre + small * normal), free(centre - small * normal)
    assert not behind.any()
    hidden = ~before
    # Hidden are the two outer faces of the first and last slat of each element, and where a wall's centre meets a slat.
    for e in marker.elements:
        along, across, depth = local(e, centre)
        front = e.virtual_offset_m + (along - e.virtual_offset_m) * e.virtual_depth_m / (e.virtual_depth_m - depth)
        near = (depth > 0) & (np.abs(across) < e.width_m / 2 * (1 + 1e-9)) & (np.abs(along) < e.length_m)
        on_end = near & (np.abs(np.abs(front) - e.length_m / 2) < 1e-6 * marker.size_m)
        on_wall = near & (np.abs(np.abs(normal @ e.across) - 1) < 1e-9)
        # Walls face each other across the cavity.
        assert np.all((across * (normal @ e.across))[on_wall] < 0)
        hidden &= ~(on_end | on_wall)
    assert not hidden.any()


@designed
@given(designs())
def test_the_slats_and_end_walls_converge_on_the_virtual_line(marker: MarkerDesign) -> None:
    corners, normal = triangles(marker, "absorber")
    for e in marker.elements:
        along, across, depth = local(e, corners)
        slat = np.all(np.abs(across) <= e.width_m / 2 * (1 + 1e-9), axis=1) & (np.ptp(depth, axis=1) > 0)
        slat &= np.all(np.abs(along) <= e.length_m, axis=1) & (np.abs(normal @ e.across) < 0.5)
        assert np.count_nonzero(slat) == 4 * (marker.slit_count + 1)
        on_line = e.virtual_offset_m * e.along - np.array([0, 0, e.virtual_depth_m])
        for shift in (-1.0, 1.0):
            distance = np.sum(normal[slat] * (on_line + shift * marker.size_m * e.across - corners[slat, 0]), axis=1)
            np.testing.assert_allclose(distance, 0, atol=1e-9 * marker.size_m)


cameras = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.2, 20))


@designed
@given(designs(), cameras)
def test_the_blob_lies_on_the_line_from_the_camera_to_the_virtual_line(
    marker: MarkerDesign, camera: tuple[float, float, float]
) -> None:
    viewer = np.array(camera)
    for e in marker.elements:
        on_line = e.virtual_offset_m * e.along - np.array([0, 0, e.virtual_depth_m]) + (viewer @ e.across) * e.across
        share = viewer[2] / (viewer[2] + e.virtual_depth_m)
        crossing = viewer + share * (on_line - viewer)
        assert crossing[2] == pytest.approx(0, abs=1e-12)
        scale = np.abs(viewer).max() + marker.size_m
        assert float(e.blob_offset_m(viewer)) == pytest.approx(crossing @ e.along, abs=1e-13 * scale)


def test_blob_offsets_take_any_shape_of_cameras() -> None:
    (e, *_) = MarkerDesign().elements
    assert e.blob_offset_m(np.ones((4, 5, 3))).shape == (4, 5)


@designed
@given(designs())
def test_virtual_points_are_where_two_virtual_lines_cross(marker: MarkerDesign) -> None:
    elements = {e.name: e for e in marker.elements}
    points = marker.virtual_points_m
    assert set(points) == {f"{h}_{v}" for h in ("top", "bottom") for v in ("right", "left")}
    for name, point in points.items():
        for part in name.split("_"):
            e = elements[part]
            assert point @ e.along == pytest.approx(e.virtual_offset_m, abs=1e-15)
            assert point[2] == -e.virtual_depth_m


def test_elements_stand_around_the_square_with_opposite_offsets() -> None:
    marker = MarkerDesign()
    assert tuple(e.name for e in marker.elements) == ELEMENT_NAMES
    top, right, bottom, left = marker.elements
    for e, sign, axis in ((top, 1, 1), (right, 1, 0), (bottom, -1, 1), (left, -1, 0)):
        assert e.centre_m[axis] * sign == pytest.approx(marker.aruco_m * (0.5 + 0.17 + 0.1), rel=1e-12)
        assert e.along @ e.centre_m == 0
    assert top.virtual_offset_m == -bottom.virtual_offset_m > 0
    assert right.virtual_offset_m == -left.virtual_offset_m > 0


def test_corners_run_clockwise_from_the_top_left_as_seen() -> None:
    marker = MarkerDesign(size_m=0.2)
    corners = marker.corners_m
    assert np.array_equal(np.sign(corners[:, :2]), [[-1, 1], [1, 1], [1, -1], [-1, -1]])
    assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(0.2 * 0.525)
    assert marker.bit_m == pytest.approx(0.2 * 0.525 / 6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"dictionary": "5X5_7"}, "'5X5_7' is not one of OpenCV's"),
        ({"identity": 50}, "identity: 50, but 4X4_50 has 50"),
        ({"identity": -1}, "identity"),
        ({"aruco_fraction": 0.6}, r"reach 0\.522 of the marker's side.*at most 0\.5"),
        ({"ring_fraction": 0.18}, r"ring_fraction: 0\.18 exceeds gap_fraction 0\.17"),
        ({"element_depth_fraction": 0.5}, "must be smaller than virtual_depth_fraction"),
        ({"size_m": 0}, "size_m"),
        ({"size_m": float("nan")}, "size_m"),
        ({"slit_count": 2}, "slit_count"),
        ({"slat_fraction": 1.0}, "slat_fraction"),
        ({"virtual_offset_fraction": 0.5}, "virtual_offset_fraction"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_design_that_cannot_be_built_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        MarkerDesign(**values)


def test_the_pattern_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        MarkerDesign().bits[0, 0] = True


def test_an_element_off_its_place_moves_whole() -> None:
    design, built = MarkerDesign(), MarkerDesign(element_offsets_m=OFF)
    for planned, real, offset in zip(design.elements, built.elements, OFF, strict=True):
        assert real.shift_m == offset
        assert real.virtual_offset_m == pytest.approx(planned.virtual_offset_m + offset, abs=1e-15)
        np.testing.assert_array_equal(real.centre_m, planned.centre_m)
    for material in ("retro", "absorber"):
        vertices = built.meshes()[material][0]
        # The floor is retro, slats and walls are absorbing: below the front plane there is nothing else but the sides.
        below = vertices[(vertices[:, 2] < 0) & (np.abs(vertices[:, :2]).max(axis=1) < design.size_m / 2)]
        planned = design.meshes()[material][0]
        planned = planned[(planned[:, 2] < 0) & (np.abs(planned[:, :2]).max(axis=1) < design.size_m / 2)]
        moved = below - planned
        for element, offset in zip(design.elements, OFF, strict=True):
            of_it = np.abs((planned - element.centre_m) @ element.across) <= element.width_m / 2 + 1e-9
            others = [e for e in design.elements if e is not element]
            away = np.abs((planned - element.centre_m) @ element.along) <= element.length_m / 2 + 1e-9
            alone = (
                of_it
                & away
                & ~np.any([np.abs((planned - e.centre_m) @ e.across) <= e.width_m / 2 for e in others], axis=0)
            )
            assert alone.sum() >= 4
            np.testing.assert_allclose(
                moved[alone], np.broadcast_to(offset * element.along, moved[alone].shape), atol=1e-12
            )


def test_the_front_plane_still_covers_everything_once() -> None:
    marker = MarkerDesign(element_offsets_m=OFF)
    cells = np.array([cell[:4] for cell in marker.plane_cells()])
    area = (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2])
    openings = sum(e.length_m * e.width_m for e in marker.elements)
    assert area.sum() == pytest.approx(marker.size_m**2 - openings, abs=1e-12)
    for element in marker.elements:
        middle = (element.centre_m + element.shift_m * element.along)[:2]
        ends = middle + np.array([[-0.499], [0.499]]) * element.length_m * element.along[:2]
        covered = [
            np.any((cells[:, 0] < x) & (x < cells[:, 1]) & (cells[:, 2] < y) & (y < cells[:, 3])) for x, y in ends
        ]
        assert not any(covered)


def test_an_element_may_not_run_into_its_neighbour() -> None:
    with pytest.raises(ValidationError, match=r"element_offsets_m: .* expected at most .* m either way"):
        MarkerDesign(element_offsets_m=(0.02, 0, 0, 0))
    with pytest.raises(ValidationError):
        MarkerDesign(element_offsets_m=(np.nan, 0, 0, 0))
