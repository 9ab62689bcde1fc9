"""Which pixels show what of the marker: boxes, uniform pixels, edges."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import (
    Box,
    at_rest,
    bounds_m,
    dilated,
    edge_normals,
    frame_box,
    marker_box,
    marker_pixels,
    target_box,
    uniform_pixels,
)
from scenes.render.transport import View
from scenes.target import Target

CAMERA = Camera(width_px=96, height_px=96)
VIEW = View(
    camera=CAMERA,
    marker=MarkerDesign(),
    target=Target(pitch_deg=12, yaw_deg=-9, roll_deg=20),
    leds=LedRing(count=12),
    sun=Sun(),
    range_m=2.6,
    nodes_nm=(850,),
)


def surface_at(view: View, points_px: np.ndarray) -> np.ndarray:
    """Absorber 1, tape 2, anything else 0: told cell by cell, from the marker's list of bits and elements."""
    marker, result = view.marker, []
    for x, y in view.to_plane(points_px):
        reach = max(abs(x), abs(y))
        surface = 0 if reach > marker.size_m / 2 else 1
        if reach < marker.aruco_m * (0.5 + marker.ring_fraction) and reach >= marker.aruco_m / 2:
            surface = 2
        surface += sum(np.abs(np.array([x, y]) - c[:2]).max() < marker.bit_m / 2 for c in marker.white_bit_centres_m())
        for element in marker.elements:
            along, across = np.array([x, y, 0]) @ np.array([element.along, element.across]).T
            inside = abs(across - element.centre_m @ element.across) <= element.width_m / 2
            surface *= not (inside and abs(along - element.shift_m) <= element.length_m / 2)
        result.append(surface)
    return np.array(result)


NODES = (807, 833, 867, 893)
#: 30° off the axis at the corners, square pixels, no point spread.
WIDE = Camera(
    width_px=320,
    height_px=240,
    focal_length_m=3e-3,
    pixel_pitch_y_m=8.6e-6,
    psf_sigma_px=0.0,
    k1=-0.2,
    k2=0.05,
    p1=1e-3,
    p2=-2e-3,
    k3=-0.004,
)


def view(
    camera: Camera, target: Target, earth: Earth | None = None, range_m: float = 2.0, marker: MarkerDesign | None = None
) -> View:
    sun = Sun(phase_deg=30.0, azimuth_deg=90.0)
    return View(
        camera=camera,
        marker=marker or MarkerDesign(),
        target=target,
        leds=LedRing(count=6),
        sun=sun,
        range_m=range_m,
        nodes_nm=NODES,
        earth=earth,
    )


def test_even_pixels_show_one_surface() -> None:
    box = marker_box(VIEW)
    row, column = np.nonzero(uniform_pixels(VIEW, box))
    assert len(row) > 0.2 * box.width * box.height
    rng = np.random.default_rng(1)
    picked = rng.choice(len(row), 400, replace=False)
    inside = rng.uniform(-0.5, 0.5, (400, 30, 2)) + np.stack([column + box.x0, row + box.y0], axis=-1)[picked, None]
    surfaces = surface_at(VIEW, inside.reshape(-1, 2)).reshape(400, 30)
    assert np.all(surfaces == surfaces[:, :1])
    assert set(np.unique(surfaces)) == {1, 2}


@pytest.mark.parametrize(
    "changed",
    [replace(VIEW, range_m=30.0), replace(VIEW, target=Target(edge_radius_m=0.03)), replace(VIEW, earth=Earth())],
    ids=["details smaller than pixels", "a bar that may shade the marker", "a wide light"],
)
def test_none_are_even_where_it_cannot_be_told(changed: View) -> None:
    assert not uniform_pixels(changed, marker_box(changed)).any()


def test_the_dense_region_holds_a_marker_whose_edges_bulge(mi: ModuleType) -> None:
    barrel = WIDE.model_copy(update={"k1": -0.4, "p1": 0.0, "p2": 0.0})
    scene_view = view(barrel, Target(), range_m=0.3, marker=MarkerDesign(size_m=0.2))
    box = marker_box(scene_view)
    edge = np.linspace(-0.1, 0.1, 101)
    for side in (-0.1, 0.1):
        for points in (
            np.stack([edge, 0 * edge + side, 0 * edge], axis=-1),
            np.stack([0 * edge + side, edge, 0 * edge], -1),
        ):
            x, y = scene_view.to_image(points).T
            assert x.min() >= box.x0
            assert x.max() <= box.x1
            assert y.min() >= box.y0
            assert y.max() <= box.y1


def test_the_rest_of_a_box_around_a_hole_tiles_it() -> None:
    box, hole = Box(2, 3, 20, 15), Box(5, 4, 20, 9)
    cover = np.zeros((15, 20), int)
    for part in (hole, *box.around(hole)):
        cover[part.slices(Box(0, 0, 20, 15))] += 1
    assert np.all(cover[3:, 2:] == 1)
    assert cover.sum() == box.width * box.height
    assert box.around(box) == []
    assert box.around(Box(4, 4, 4, 9)) == [box]


def test_boxes_are_cut_and_grown() -> None:
    assert Box(0, 0, 10, 10).within(Box(5, -5, 15, 5)) == Box(5, 0, 10, 5)
    assert Box(0, 0, 10, 10).within(Box(20, 20, 30, 30)).width == 0
    assert Box(4, 4, 6, 6).grown(2) == Box(2, 2, 8, 8)
    assert Box(6, 6, 4, 4).height == 0


def test_a_mask_is_dilated_by_a_square() -> None:
    mask = np.zeros((9, 9), bool)
    mask[4, 4] = True
    expected = np.zeros((9, 9), bool)
    expected[2:7, 2:7] = True
    np.testing.assert_array_equal(dilated(mask, 2), expected)
    assert dilated(mask, 0) is mask


def test_a_frontal_marker_fills_its_box_and_the_target_its_own() -> None:
    view = replace(VIEW, target=Target(face_m=0.2, facet_slope_deg=0.0))
    side = view.marker.size_m / view.range_m * CAMERA.focal_px[0]
    assert marker_box(view).width == pytest.approx(side + 8, abs=2)
    assert target_box(view).width == pytest.approx(2 * side + 8, rel=0.02)
    assert frame_box(view) == Box(0, 0, 96, 96)


def test_bounds_hold_marker_and_target() -> None:
    marker, target = MarkerDesign(), Target(face_m=0.4, facet_slope_deg=0.0, yaw_deg=20.0, tumble_deg_s=3.0)
    low, high = bounds_m(marker, at_rest(target))
    np.testing.assert_allclose(low, [-0.2, -0.2, low[2]], atol=1e-12)
    np.testing.assert_allclose(high, [0.2, 0.2, 0.0], atol=1e-12)
    assert at_rest(target) == at_rest(target.model_copy(update={"pitch_deg": 5.0, "roll_deg": 1.0}))


def test_edges_of_a_frontal_marker_stand_square_to_the_pixels() -> None:
    normals = edge_normals(replace(VIEW, target=Target()))
    scale = np.array(CAMERA.focal_px) / VIEW.range_m
    np.testing.assert_allclose(np.abs(normals), [[scale[1], 0.0], [0.0, scale[0]]], rtol=1e-6, atol=1e-6)


def test_pixels_of_the_marker_are_told_by_what_their_centres_show() -> None:
    view = replace(VIEW, target=Target())
    seen = marker_pixels(view, frame_box(view))
    scale = np.prod(CAMERA.focal_px) / view.range_m**2
    ring = (view.marker.aruco_m * (1 + 2 * view.marker.ring_fraction)) ** 2
    openings = sum(element.length_m * element.width_m for element in view.marker.elements)
    assert seen.aruco.sum() == pytest.approx(ring * scale, rel=0.1)
    assert seen.opening.sum() == pytest.approx(openings * scale, rel=0.15)
    assert not np.any(seen.blob & ~seen.opening)
    assert 0 < seen.blob.sum() < seen.opening.sum()
