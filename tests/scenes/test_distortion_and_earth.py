"""The renderer behind a distorted lens, and under the sunlit Earth."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student

from materials import library
from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.files import cache
from scenes.files.exr import read_basis, write_basis
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box
from scenes.render.stock import render_subpixels
from scenes.render.transport import Quality, Region, View, render_basis
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


def test_stock_mitsuba_refuses_a_distorted_lens(mi: ModuleType) -> None:
    with pytest.raises(ValueError, match="Mitsuba's own camera has no distortion"):
        render_subpixels(view(WIDE, Target()), Region(0, 0, 8, 8, 1), 0, 833, "sun", 1)


# --- the Earth

SMALL = Camera(width_px=96, height_px=96)
#: Everything diffuse and flat: what the front plane shows is known in closed form.
PLATE = {
    "tape_material": "diffuse_reference",
    "absorber_material": "diffuse_reference",
    "face_material": "black_coating",
    "facet_slope_deg": 0.0,
}


def plate_pixels(scene_view: View) -> tuple[slice, slice]:
    """Pixels well inside the ArUco square: the marker's front plane, without slits."""
    x, y = scene_view.to_image(scene_view.marker.corners_m * 0.6).T
    return slice(int(y.min()) + 2, int(y.max()) - 1), slice(int(x.min()) + 2, int(x.max()) - 1)


@pytest.mark.parametrize(
    ("phase_deg", "radius_deg"),
    [(90.0, 70.0), (40.0, 70.0), (0.0, 30.0), (120.0, 65.0)],
    ids=["beside", "around the camera", "behind the camera", "half behind the plate"],
)
def test_a_plate_under_the_earth_is_as_bright_as_in_closed_form(
    mi: ModuleType, phase_deg: float, radius_deg: float
) -> None:
    earth = Earth(phase_deg=phase_deg, angular_radius_deg=radius_deg)
    scene_view = view(SMALL, Target(**PLATE, yaw_deg=10.0), earth)
    basis = render_basis(scene_view, Quality(1, 300_000))
    viewer = scene_view.to_marker(np.zeros(3))
    exact = earth_transport(
        viewer / np.linalg.norm(viewer),
        scene_view.earth_in_marker,
        earth.angular_radius_rad,
        library.load("diffuse_reference").brdf,
        np.array(NODES, float),
    )
    rows, columns = plate_pixels(scene_view)
    seen = basis.layers["earth"][:, rows, columns].mean(axis=(1, 2))
    np.testing.assert_allclose(seen, exact, rtol=5e-3)


def test_tape_under_an_earth_around_the_camera_returns_its_light(mi: ModuleType) -> None:
    """The lobe of a degree or so is sampled by itself: 0.5 % of the closed form, where even sampling scatters by tens."""
    scene_view = view(SMALL, Target(yaw_deg=10.0), Earth(phase_deg=20.0))
    basis = render_basis(scene_view, Quality(1, 1_000_000))
    viewer = scene_view.to_marker(np.zeros(3))
    exact = earth_transport(
        viewer / np.linalg.norm(viewer),
        scene_view.earth_in_marker,
        np.radians(70.0),
        library.load("tape_type_xi").brdf,
        np.array(NODES, float),
    )
    x0, x1, y0, y1 = scene_view.marker.reflective_rectangles_m().T
    centres = np.column_stack([x0 + x1, y0 + y1, 0 * x0]) / 2
    big = np.minimum(x1 - x0, y1 - y0) > 0.9 * scene_view.marker.bit_m
    column, row = np.rint(scene_view.to_image(centres[big])).astype(int).T
    seen = basis.layers["earth"][:, row, column].mean(axis=1)
    np.testing.assert_allclose(seen, exact, rtol=5e-3)


def test_the_earth_of_the_batched_renderer_is_stock_mitsubas(mi: ModuleType) -> None:
    """Marker, slits, foil and the disc behind them; 4 σ of the mean over independent stock renderings."""
    square = SMALL.model_copy(update={"pixel_pitch_y_m": 8.6e-6, "psf_sigma_px": 0.0})
    scene_view = view(square, Target(yaw_deg=20.0, face_m=0.12), Earth(phase_deg=125.0, azimuth_deg=-60.0), range_m=5.0)
    region = Region(0, 0, 96, 96, 2)
    ours = render_basis(scene_view, Quality(4, 150_000)).layers["earth"][0]
    runs = [render_subpixels(scene_view, region, 0, NODES[0], "earth", seed, spp=8) for seed in range(6)]
    face = slice(24, 72), slice(24, 72)
    for where in (face, (slice(None), slice(None))):
        theirs = [float(np.mean(run.reshape(96, 2, 96, 2).mean(axis=(1, 3))[where])) for run in runs]
        sampling = float(np.std(theirs, ddof=1)) / np.sqrt(len(theirs)) * student.ppf(0.9995, len(theirs) - 1)
        assert abs(ours[where].mean() - np.mean(theirs)) < sampling + 2e-3 * np.mean(theirs)


def test_the_earth_is_seen_behind_the_target(mi: ModuleType) -> None:
    here = view(SMALL, Target(face_m=0.1), Earth(phase_deg=180.0), range_m=5.0)
    away = view(SMALL, Target(face_m=0.1), Earth(phase_deg=90.0), range_m=5.0)
    assert render_basis(here, Quality(1, 20_000)).layers["earth"][0, 2, 2] == pytest.approx(1, rel=1e-6)
    assert render_basis(away, Quality(1, 20_000)).layers["earth"][0, 2, 2] == 0.0


def test_the_earth_changes_neither_light_beside_it_and_is_written_and_read(mi: ModuleType, tmp_path: Path) -> None:
    alone = render_basis(view(SMALL, Target()), Quality(1, 50_000))
    both = render_basis(view(SMALL, Target(), Earth()), Quality(1, 50_000))
    assert set(alone.layers) == {"led", "sun"}
    assert set(both.layers) == {"led", "sun", "earth"}
    for light, images in alone.layers.items():
        np.testing.assert_array_equal(both.layers[light], images)
    for basis, name in ((alone, "without.exr"), (both, "with.exr")):
        write_basis(basis, tmp_path / name)
        back = read_basis(tmp_path / name)
        assert set(back.layers) == set(basis.layers)
        for light, images in basis.layers.items():
            np.testing.assert_array_equal(back.layers[light], images)


@pytest.mark.parametrize(
    ("changes", "anew"),
    [
        ({"vignetting": 0.3}, False),
        ({"veiling_glare": 0.1}, False),
        ({"point_source_transmittance": ((20.0, 1e-4), (40.0, 1e-5))}, False),
        ({"k1": -0.1}, True),
        ({"p2": 1e-3}, True),
        ({"psf_sigma_px": 0.7}, True),
    ],
)
def test_the_cache_renders_anew_what_changes_transport_alone(changes: dict[str, float], anew: bool) -> None:
    plain, changed = view(SMALL, Target()), view(SMALL.model_copy(update=changes), Target())
    assert (cache.key(plain, Quality(), "v") != cache.key(changed, Quality(), "v")) == anew


def test_the_cache_tells_earths_apart_by_place_not_by_albedo() -> None:
    keys = [
        cache.key(view(SMALL, Target(), earth), Quality(), "v")
        for earth in (None, Earth(), Earth(albedo=0.6), Earth(phase_deg=80.0), Earth(angular_radius_deg=60.0))
    ]
    assert keys[1] == keys[2]
    assert len(set(keys)) == 4
