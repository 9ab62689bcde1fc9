"""The kernel: rays through real lenses, single LEDs and rings of them, against closed forms."""

from __future__ import annotations

from types import ModuleType

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from materials import library
from radiometry.geometry import FloatArray
from radiometry.link import ring_transport, sun_transport
from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.render.transport import LIGHTS, Quality, View, render_basis
from scenes.target import Target

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
FLAT = {"tape_material": "diffuse_reference", "face_material": "black_coating", "facet_slope_deg": 0.0}


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


def pattern_seen(scene_view: View, fine: int) -> FloatArray:
    """Share of each pixel that shows printed cells, by OpenCV's inverse distortion of `fine`² points a pixel."""
    camera = scene_view.camera
    x = (np.arange(camera.width_px * fine) + 0.5) / fine - 0.5
    y = (np.arange(camera.height_px * fine) + 0.5) / fine - 0.5
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    coefficients = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
    tangents = cv2.undistortPoints(points, camera.matrix, coefficients)[:, 0]
    homography = np.column_stack([scene_view.rotation[:, :2], scene_view.translation_m])
    plane = np.column_stack([tangents, np.ones(len(tangents))]) @ np.linalg.inv(homography).T
    plane = plane[:, :2] / plane[:, 2:]
    lit = np.zeros(len(plane), bool)
    for x0, x1, y0, y1 in scene_view.marker.reflective_rectangles_m():
        lit |= (plane[:, 0] > x0) & (plane[:, 0] < x1) & (plane[:, 1] > y0) & (plane[:, 1] < y1)
    return lit.reshape(camera.height_px, fine, camera.width_px, fine).mean(axis=(1, 3))


#: A corner of a real camera: few pixels, its pitches and focal length unchanged.
CAMERA = Camera(width_px=64, height_px=48)
TILTS = [(0.0, 0.0, 0.0), (35.0, 0.0, 10.0), (0.0, -45.0, 0.0), (20.0, 30.0, -120.0)]


def render(scene_view: View, samples: int, seed: int) -> dict[str, FloatArray]:
    """Basis images by the batched renderer, all pixels with about as many samples along a side."""
    return render_basis(scene_view, Quality(samples, 1, seed)).layers


def rays_in_marker(scene_view: View) -> tuple[FloatArray, FloatArray]:
    """Camera position (3,) and directions through the pixel centres (height, width, 3) in the marker frame."""
    camera = scene_view.camera
    column, row = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    pixel = np.stack([column, row, np.ones_like(row)], axis=-1)
    directions = pixel @ np.linalg.inv(camera.matrix).T
    return scene_view.to_marker(np.zeros(3)), directions @ scene_view.rotation


def on_plane(scene_view: View, depth_m: float) -> FloatArray:
    """Points of the plane z = −depth behind the pixel centres, (height, width, 3)."""
    origin, directions = rays_in_marker(scene_view)
    return origin + directions * ((-depth_m - origin[2]) / directions[..., 2:])


def plate(pitch_deg: float, yaw_deg: float, roll_deg: float, leds: LedRing) -> View:
    """A flat plate of albedo 0.5 that fills the frame, with a marker of 1 cm before its middle."""
    target = Target(
        face_material="diffuse_reference", facet_slope_deg=0, pitch_deg=pitch_deg, yaw_deg=yaw_deg, roll_deg=roll_deg
    )
    return View(
        camera=CAMERA,
        marker=MarkerDesign(size_m=0.01),
        target=target,
        leds=leds,
        sun=Sun(phase_deg=25, azimuth_deg=40),
        range_m=2.0,
        nodes_nm=NODES,
    )


def test_the_marker_lands_where_the_distorted_lens_projects_it(mi: ModuleType) -> None:
    """Shift of the rendered pattern against OpenCV's, quarter by quarter: below 0.02 px, where the lens moves it by 1 px."""
    target = Target(**FLAT, yaw_deg=15.0, pitch_deg=-10.0, roll_deg=25.0)
    scene_view = view(WIDE, target, range_m=0.22, marker=MarkerDesign(size_m=0.2))
    corners = scene_view.to_image(scene_view.marker.corners_m)
    ideal = WIDE.without_distortion.project(
        scene_view.marker.corners_m @ scene_view.rotation.T + scene_view.translation_m
    )
    assert np.linalg.norm(corners - ideal, axis=1).min() > 1.0
    sharp = render_basis(scene_view, Quality(2, 4_000_000)).layers["sun"][1]
    # A point spread on both makes small shifts linear in the slope.
    image, expected = gaussian_filter(sharp.astype(float), 1.0), gaussian_filter(pattern_seen(scene_view, 6), 1.0)
    inside = np.zeros(image.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)  # the ArUco square: no slits, no face
    light = image[(expected > 0.999) & (inside == 1)].mean()
    slope_y, slope_x = np.gradient(expected)
    rows, columns = np.nonzero(inside)
    for right in (False, True):
        for low in (False, True):
            quarter = ((columns > corners[:, 0].mean()) == right) & ((rows > corners[:, 1].mean()) == low)
            at = rows[quarter], columns[quarter]
            equations = np.column_stack([expected[at], 1 - expected[at], -slope_x[at], -slope_y[at]])
            (_, _, x, y), *_ = np.linalg.lstsq(equations, image[at] / light)
            assert np.hypot(x, y) < 0.02


def test_distortion_keeps_the_light_of_the_target(mi: ModuleType) -> None:
    """Rendered radiance times the lens's relative illumination, over a face that both lenses show whole, to 0.2 %.

    Both sums carry the sampling of the face's edges: 2 × 2 jittered rays on some 650 edge pixels of 27 000, each ± 1/4.
    """
    target = Target(**{**FLAT, "face_material": "diffuse_reference"}, face_m=0.3)
    light = []
    for camera in (WIDE, WIDE.without_distortion):
        basis = render_basis(view(camera, target, range_m=0.5), Quality(4, 200_000))
        light.append(float(np.sum(basis.layers["sun"][0] * camera.relative_illumination())))
    assert light[0] == pytest.approx(light[1], rel=2e-3)


@pytest.mark.parametrize("tilt", TILTS)
def test_a_diffuse_plate_renders_to_the_closed_form_within_a_thousandth(
    mi: ModuleType, tilt: tuple[float, float, float]
) -> None:
    """Every pixel 10 or more from the marker, under the Sun and under one LED: DESIGN's figure of merit of the renderer."""
    # So far from the lens, at 8.5 deg, that the LED's pattern counts: 0.71 of its axis.
    scene_view = plate(*tilt, leds=LedRing(count=1, ring_radius_m=0.3))
    points = on_plane(scene_view, scene_view.marker.thickness_m)
    image = scene_view.to_image(points)
    assert np.abs(image - np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1)).max() < 1e-9
    box = scene_view.to_image(scene_view.marker.size_m / 2 * np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)]))
    clear = np.any((image < box.min(axis=0) - 10) | (image > box.max(axis=0) + 10), axis=-1)
    assert clear.sum() > 1000
    brdf = library.load("diffuse_reference").brdf
    camera = scene_view.to_marker(np.zeros(3))
    leds = scene_view.to_marker(scene_view.leds.positions_m())
    axis = scene_view.rotation[2]
    nodes = np.array(NODES, float)
    expected = {
        "led": ring_transport(points, camera, leds, axis=axis, ring=scene_view.leds, brdf=brdf, wavelength_nm=nodes),
        "sun": sun_transport(points, camera, scene_view.sun_in_marker, brdf, nodes),
    }
    rendered = render(scene_view, 8, seed=3)
    for light in LIGHTS:
        assert expected[light].min() > 0
        ratio = np.moveaxis(rendered[light], 0, -1)[clear] / expected[light][clear]
        assert np.abs(ratio - 1).max() < 1e-3, light


def test_a_ring_is_the_mean_of_its_leds(mi: ModuleType) -> None:
    """A plate under two LEDs of opposite sides, against the closed form of both; which LED a ray meets is a lattice's choice.

    0.1 % again: the two differ by some per cent, and a pixel's rays are shared almost evenly.
    """
    scene_view = plate(0.0, 30.0, 0.0, leds=LedRing(count=2, ring_radius_m=0.08))
    points = on_plane(scene_view, scene_view.marker.thickness_m)[:, :10]
    arguments = (scene_view.rotation[2], scene_view.leds, library.load("diffuse_reference").brdf, np.array([850.0]))
    leds, camera = scene_view.to_marker(scene_view.leds.positions_m()), scene_view.to_marker(np.zeros(3))
    expected = ring_transport(points, camera, leds, *arguments)[..., 0]
    rendered = render(scene_view, 8, seed=1)["led"][0][:, :10]
    np.testing.assert_allclose(rendered, expected, rtol=1e-3)
