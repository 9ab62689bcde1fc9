"""Pixels without an edge get few rays, and nobody sees where they are."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box, uniform_pixels
from scenes.render import image, lattice
from scenes.render.transport import Quality, View, render_basis
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


def test_few_rays_weigh_as_many() -> None:
    rng = np.random.default_rng(2)
    few, many = (lattice.weights(lattice.points(n, g, rng.random(2)), 0.55) for n, g in ((16, 5), (160, 37)))
    scaled = lattice.in_place_of(few, many)
    np.testing.assert_allclose(scaled.sum(axis=0), many.sum(axis=0), rtol=1e-5, atol=2e-6)
    assert few.sum() == pytest.approx(scaled.sum(), rel=1e-3)


def test_an_image_is_the_same_with_many_rays_everywhere(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean over the image within its error over seeds, and no pixel off by more than five of its own."""
    few, many = [], []
    for seed in range(8):
        quality = Quality(frame_samples=0, seed=seed)
        few.append(render_basis(VIEW, quality).layers["led"][0])
        with monkeypatch.context() as patched:
            patched.setattr(image, "uniform_pixels", lambda _, box: np.zeros((box.height, box.width), bool))
            many.append(render_basis(VIEW, quality).layers["led"][0])
    box = marker_box(VIEW).within(marker_box(VIEW).grown(-6))
    there = (slice(None), slice(max(box.y0, 0), box.y1), slice(max(box.x0, 0), box.x1))
    ours, theirs = np.array(few, float)[there], np.array(many, float)[there]
    assert np.any(ours != theirs)
    error = np.sqrt((ours.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / 8)
    error = np.maximum(error, np.median(error))  # a pixel's own error, of eight seeds, may come out too small
    z = (ours.mean(axis=0) - theirs.mean(axis=0)) / error
    assert abs(z.mean()) < 5 / np.sqrt(z.size / 25)  # neighbours within the point spread share rays
    assert np.abs(z).max() < 6
