"""What rays hit and what it reflects, against the material's definition."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from materials import library
from scenes.marker import MarkerDesign
from scenes.render.scene import Scene, SurfaceInteraction, intersect
from scenes.target import Target

MARKER = MarkerDesign()
TARGET = Target(tape_material="white_paint", absorber_material="diffuse_reference", facet_slope_deg=0.0)
#: A viewer 2 m straight above a point of the front plane, in millimetres.
HEIGHT_MM = 2000.0


def look_down(mi: ModuleType, scene: Scene, point_m: np.ndarray) -> SurfaceInteraction:
    ray = mi.Ray3f(mi.Point3f(*map(float, point_m[:2] * 1e3), HEIGHT_MM), mi.Vector3f(0, 0, -1))
    return intersect(scene, ray, (850,))


def first(value: Any) -> float:
    return float(np.array(value).ravel()[0])


@pytest.fixture(scope="module", params=["closed form", "triangles"])
def scene(mi: ModuleType, request: pytest.FixtureRequest) -> Scene:
    made = Scene(MARKER, TARGET)
    assert made.marker is not None
    if request.param == "triangles":
        made.marker = None
    return made


@pytest.mark.parametrize(("white", "material"), [(True, "white_paint"), (False, "diffuse_reference")])
@pytest.mark.parametrize("incidence_deg", [0.0, 60.0])
def test_a_bit_reflects_as_its_material_says(
    mi: ModuleType, scene: Scene, white: bool, material: str, incidence_deg: float
) -> None:
    centres = MARKER.white_bit_centres_m() if white else MARKER.black_bit_centres_m()
    interaction = look_down(mi, scene, centres[0])
    angle = np.radians(incidence_deg)
    towards = np.array([np.sin(angle), 0.0, np.cos(angle)])
    up = np.array([0.0, 0.0, 1.0])
    expected = float(library.load(material).brdf(up, towards, up, 850.0)) * np.cos(angle)
    assert first(interaction.valid) == 1
    assert first(interaction.hit.p.z) == pytest.approx(0.0, abs=1e-3)
    assert first(interaction.reflected(mi.Vector3f(*map(float, towards)))) == pytest.approx(expected, rel=1e-5)


def test_light_from_behind_the_plane_reflects_nothing(mi: ModuleType, scene: Scene) -> None:
    interaction = look_down(mi, scene, MARKER.white_bit_centres_m()[0])
    assert first(interaction.reflected(mi.Vector3f(0.6, 0.0, -0.8))) == 0


def test_a_ray_past_the_target_hits_nothing(mi: ModuleType, scene: Scene) -> None:
    assert first(look_down(mi, scene, np.array([3.0, 0.0, 0.0])).valid) == 0


def test_the_first_two_materials_are_those_of_the_marker(scene: Scene) -> None:
    assert list(scene.materials)[:2] == ["retro", "absorber"]
    assert scene.materials["retro"].name == "white_paint"
    assert scene.materials["absorber"].name == "diffuse_reference"
