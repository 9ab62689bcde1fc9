"""The marker in closed form is the marker of triangles."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from scenes.marker import MarkerDesign
from scenes.render.scene import Scene
from scenes.target import Target
from scenes.view import MM_PER_M

DESIGNS = {
    "default": MarkerDesign(),
    "displaced": MarkerDesign(
        size_m=0.05, slit_count=11, virtual_offset_fraction=0.1, element_offsets_m=(5e-4, -4e-4, 3e-4, 0.0)
    ),
    "wide slats": MarkerDesign(size_m=0.3, slat_fraction=0.5, dictionary="5X5_50", identity=7),
}
#: Camera positions over the marker's side.
CAMERAS = [(0.0, 0.0, 25.0), (8.0, -5.0, 25.0), (-15.0, 18.0, 25.0)]
RAYS = 200_000


def floats(mi: ModuleType, values: np.ndarray) -> list[Any]:
    return [mi.Float(np.ascontiguousarray(axis, np.float32)) for axis in values.T]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("name", DESIGNS)
def test_rays_meet_the_same_surface_and_the_same_shadows(
    mi: ModuleType, name: str, camera: tuple[float, float, float]
) -> None:
    """Distance, normal, material, and whether a random direction sees light, of random rays through the front.

    Single precision at 25 sides of range blurs 1e-6 of them: rays within some 5e-6 of a side from an edge may differ, 5e-4 of
    all where slats are 4e-3 of a side apart.
    """
    design = DESIGNS[name]
    rng = np.random.default_rng(1)
    scene = Scene(design, Target())
    assert scene.marker is not None
    side = design.size_m * MM_PER_M
    origin = np.array(camera) * side
    front = np.column_stack([rng.uniform(-0.5, 0.5, (RAYS, 2)) * side, np.zeros(RAYS)])
    direction = (front - origin) / np.linalg.norm(front - origin, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(*map(float, origin)), mi.Vector3f(*floats(mi, direction)))
    ours, theirs = scene.marker.find(ray.o, ray.d), scene.solids.ray_intersect(ray)
    assert np.array(ours.found).all()
    tape = np.array(theirs.shape == mi.ShapePtr(scene.shapes["retro"]))
    same = np.abs(np.array(ours.distance) - np.array(theirs.t)) < 2e-4 * side
    same &= np.abs(np.array(ours.normal) - np.array(theirs.n)).max(axis=0) < 1e-3
    same &= tape == np.array(ours.bright)
    assert np.mean(~same) < 5e-4
    assert 0.001 < np.mean(np.array(ours.floor)) < 0.1

    light = np.column_stack([rng.normal(size=(RAYS, 2)), 2 * np.abs(rng.normal(size=RAYS)) + 0.1])
    towards = mi.Vector3f(*floats(mi, light / np.linalg.norm(light, axis=1, keepdims=True)))
    seen = np.array(ours.sees(ray.o + ray.d * ours.distance, towards))
    expected = ~np.array(scene.solids.ray_test(theirs.spawn_ray(towards)))
    facing = np.sum(np.array(theirs.n) * np.array(towards), axis=0) > 0.01
    assert np.mean((seen != expected)[same & facing]) < 5e-4
    assert np.mean(~expected[same & facing]) > 0.01


def test_what_stands_before_the_plane_is_left_to_triangles(mi: ModuleType) -> None:
    """Bars thicker than the marker shade it."""
    design = MarkerDesign()
    assert Scene(design, Target(edge_radius_m=0.5 * design.thickness_m)).marker is not None
    assert Scene(design, Target(edge_radius_m=2 * design.thickness_m)).marker is None
