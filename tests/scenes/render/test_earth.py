"""The sunlit Earth in the batched renderer."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.stats import t as student

from materials import library
from radiometry.earth import earth_transport
from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.files.exr import read_basis, write_basis
from scenes.marker import MarkerDesign
from scenes.render.stock import render_subpixels
from scenes.render.transport import Quality, Region, View, render_basis
from scenes.target import Target

NODES = (807, 833, 867, 893)


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
