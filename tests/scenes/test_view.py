"""A view: where its points and its Sun stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.render.transport import View
from scenes.target import Target

NODES = (807, 833, 867, 893)
#: A corner of a real camera: few pixels, its pitches and focal length unchanged.
CAMERA = Camera(width_px=64, height_px=48)
TILTS = [(0.0, 0.0, 0.0), (35.0, 0.0, 10.0), (0.0, -45.0, 0.0), (20.0, 30.0, -120.0)]


def view(
    camera: Camera = CAMERA,
    marker: MarkerDesign | None = None,
    target: Target | None = None,
    leds: LedRing | None = None,
    sun: Sun | None = None,
    range_m: float = 2.0,
    nodes_nm: tuple[int, ...] = NODES,
) -> View:
    return View(
        camera=camera,
        marker=marker or MarkerDesign(size_m=0.05),
        target=target or Target(),
        leds=leds or LedRing(count=6),
        sun=sun or Sun(),
        range_m=range_m,
        nodes_nm=nodes_nm,
    )


@pytest.mark.parametrize("tilt", TILTS)
def test_points_are_imaged_as_the_pose_and_the_camera_say(tilt: tuple[float, float, float]) -> None:
    scene_view = view(target=Target(pitch_deg=tilt[0], yaw_deg=tilt[1], roll_deg=tilt[2]))
    corners = scene_view.marker.corners_m
    in_camera = np.array([scene_view.rotation @ c + scene_view.translation_m for c in corners])
    np.testing.assert_allclose(scene_view.to_image(corners), CAMERA.project(in_camera), rtol=1e-12)
    np.testing.assert_allclose(scene_view.to_marker(in_camera), corners, atol=1e-15)


def test_the_sun_stands_at_its_phase_angle_from_the_camera_in_the_marker_frame() -> None:
    scene_view = view(target=Target(pitch_deg=20, yaw_deg=-30, roll_deg=70), sun=Sun(phase_deg=33, azimuth_deg=-110))
    to_camera = scene_view.to_marker(np.zeros(3)) / scene_view.range_m
    assert np.degrees(np.arccos(scene_view.sun_in_marker @ to_camera)) == pytest.approx(33, abs=1e-9)


@pytest.mark.parametrize("k1", [0.0, -0.2])
def test_a_line_of_sight_meets_the_plane_where_its_point_was_imaged(k1: float) -> None:
    seen = view(camera=CAMERA.model_copy(update={"k1": k1}), target=Target(pitch_deg=20.0, yaw_deg=-35.0))
    points = np.random.default_rng(1).uniform(-0.02, 0.02, (50, 3)) * (1, 1, 0)
    np.testing.assert_allclose(seen.to_plane(seen.to_image(points)), points[:, :2], atol=1e-10)


def test_an_earth_is_one_light_more() -> None:
    plain = view()
    assert plain.lights == ("led", "sun")
    with_earth = replace(plain, earth=Earth(phase_deg=90.0, azimuth_deg=0.0))
    assert with_earth.lights == ("led", "sun", "earth")
    np.testing.assert_allclose(with_earth.rotation @ with_earth.earth_in_marker, [1.0, 0.0, 0.0], atol=1e-12)
