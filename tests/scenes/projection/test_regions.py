"""Which pixels show what of the marker: boxes, uniform pixels, edges."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box, uniform_pixels
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
