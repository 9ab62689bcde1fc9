"""The batched renderer against closed forms, against stock Mitsuba, and against its own promises."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as student

from materials import library
from radiometry.geometry import FloatArray
from radiometry.link import reflective_fill, ring_transport, sun_transport
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes import transport
from scenes.exr import write_channels
from scenes.marker import MarkerDesign
from scenes.stock import render_subpixels
from scenes.target import Target
from scenes.transport import LIGHTS, Quality, Region, View, marker_region, render_basis

NODES = (807, 833, 867, 893)
#: A corner of a real camera: few pixels, its pitches and focal length unchanged.
CAMERA = Camera(width_px=64, height_px=48)
SQUARE = Camera(width_px=48, height_px=40, pixel_pitch_y_m=8.6e-6)
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
        camera, marker or MarkerDesign(size_m=0.05), target or Target(), leds or LedRing(count=6), sun or Sun(), range_m, nodes_nm
    )  # fmt: skip


def render(scene_view: View, region: Region, seed: int) -> dict[str, FloatArray]:
    """Basis images of a region by the batched renderer."""
    scene = transport._scene(scene_view.marker, scene_view.target)
    return transport._render_region(scene, scene_view, region, seed)


def whole(camera: Camera, samples: int) -> Region:
    return Region(0, 0, camera.width_px, camera.height_px, samples)


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


# --- a diffuse plate: the closed form


def plate(pitch_deg: float, yaw_deg: float, roll_deg: float, leds: LedRing) -> View:
    """A flat plate of albedo 0.5 that fills the frame, with a marker of 1 cm before its middle."""
    target = Target(
        face_material="diffuse_reference", facet_slope_deg=0, pitch_deg=pitch_deg, yaw_deg=yaw_deg, roll_deg=roll_deg
    )
    return view(marker=MarkerDesign(size_m=0.01), target=target, leds=leds, sun=Sun(phase_deg=25, azimuth_deg=40))


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
        "led": ring_transport(points, camera, leds, axis, scene_view.leds, brdf, nodes),
        "sun": sun_transport(points, camera, scene_view.sun_in_marker, brdf, nodes),
    }
    rendered = render(scene_view, whole(CAMERA, 8), seed=3)
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
    rendered = render(scene_view, whole(CAMERA, 8), seed=1)["led"][0][:, :10]
    np.testing.assert_allclose(rendered, expected, rtol=1e-3)


# --- conventions


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


def test_a_frontal_marker_renders_to_its_pattern_under_point_spread_and_pixel(mi: ModuleType) -> None:
    """Every pixel within the ring, against the closed form: no mirror image, no shift, the stated point spread.

    Eight seeds give each pixel's mean and error, held by Student's t at 99.9 % over all pixels (Šidák). Beyond that a straight
    edge within a sub-pixel of width h may move a pixel by h²/8 max K' = h²/8 · 0.7 of the contrast (point spread 0.5 px), two
    edges by twice that.
    """
    target = Target(tape_material="diffuse_reference", absorber_material="black_coating")
    scene_view = view(target=target, sun=Sun(phase_deg=40, azimuth_deg=30), range_m=2.6, nodes_nm=(850,) * 4)
    marker, h, seeds = scene_view.marker, 1 / 12, 8
    (fx, fy), (cx, cy) = CAMERA.focal_px, CAMERA.principal_point_px
    reach = marker.aruco_m * (0.5 + 0.7 * marker.ring_fraction)
    column, row = np.meshgrid(np.arange(64), np.arange(48))
    x, y = (column - cx) * scene_view.range_m / fx, -(row - cy) * scene_view.range_m / fy
    near = (np.abs(x) < reach) & (np.abs(y) < reach)
    scale = np.repeat([fx, fy], 2) / scene_view.range_m
    pixels = np.stack([column[near] - cx, cy - row[near]], axis=-1)
    fill = reflective_fill(pixels, marker.reflective_rectangles_m() * scale, CAMERA.psf_sigma_px)
    tape, absorber = (
        float(library.load(name).diffuse(850.0)) for name in (target.tape_material, target.absorber_material)
    )
    cosine = scene_view.sun_in_marker[2]
    expected = cosine / np.pi * (absorber + fill * (tape - absorber))
    contrast = cosine / np.pi * (tape - absorber)
    region = Region(12, 4, 40, 40, 12)
    inside = near[region.y0 : region.y0 + region.height, region.x0 : region.x0 + region.width]
    assert inside.sum() == near.sum()
    rendered = np.array([render(scene_view, region, seed)["sun"][0][inside] for seed in range(seeds)])
    error = rendered.std(axis=0, ddof=1) / np.sqrt(seeds)
    score = student.isf((1 - 0.999 ** (1 / len(fill))) / 2, seeds - 1)
    assert np.ptp(fill) > 0.9
    assert np.median(error) < 0.002 * contrast  # or the interval would say nothing
    miss = np.abs(rendered.mean(axis=0) - expected) - score * error - 2 * h**2 / 8 * 0.7 * contrast
    # Disc and cosine: the Sun's half a degree of width moves a plane's radiance by a thousandth at most.
    assert np.all(miss < 1e-3 * expected)


# --- against stock Mitsuba


def block_means(images: FloatArray, size: int) -> FloatArray:
    """Means over square blocks, (..., height // size, width // size)."""
    *lead, height, width = images.shape
    return images.reshape(*lead, height // size, size, width // size, size).mean(axis=(-3, -1))


def reduced(image: FloatArray, region: Region, pad: int, camera: Camera) -> FloatArray:
    """Pixels from stock's sub-pixels, by the renderer's own kernel."""
    step = 1 / region.samples
    columns = transport._reduction(region.width, pad, image.shape[1], step, camera.psf_sigma_px)
    rows = transport._reduction(region.height, pad, image.shape[0], step, camera.psf_sigma_px)
    return rows @ (image @ columns.T)


def check_same(
    ours: FloatArray, theirs: FloatArray, systematic: float, keep: Callable[[dict[str, FloatArray]], None]
) -> None:
    """Welch's t on the mean over seeds of every block, 99.9 % for all blocks together (Šidák).

    Args:
        ours, theirs: (seeds, blocks, blocks).
        systematic: relative difference that is known and allowed for.
        keep: called with the images before a failure.
    """
    parts = [images.var(axis=0, ddof=1) / len(images) for images in (ours, theirs)]
    variance = parts[0] + parts[1]
    freedom = variance**2 / np.maximum(
        parts[0] ** 2 / (len(ours) - 1) + parts[1] ** 2 / (len(theirs) - 1), 1e-300
    )  # Welch–Satterthwaite
    limit = student.isf((1 - 0.999 ** (1 / variance.size)) / 2, np.maximum(freedom, 1))
    difference = ours.mean(axis=0) - theirs.mean(axis=0)
    allowed = limit * np.sqrt(variance) + systematic * ours.mean(axis=0)
    if np.any(np.abs(difference) > allowed):
        keep({"ours": ours.mean(axis=0), "theirs": theirs.mean(axis=0), "difference": difference, "allowed": allowed})
        pytest.fail(
            f"worst block: {np.max(np.abs(difference) / allowed):.2f} of the interval; images in the temporary folder"
        )
    # All blocks together: the total flux, a far tighter interval.
    totals = ours.mean(axis=(1, 2)), theirs.mean(axis=(1, 2))
    spread = np.sqrt(sum(total.var(ddof=1) / len(total) for total in totals))
    freedom_least = min(len(ours), len(theirs)) - 1
    assert (
        abs(totals[0].mean() - totals[1].mean())
        < student.isf(0.0005, freedom_least) * spread + systematic * totals[0].mean()
    )


SEEDS = 16
TILTED = Target(pitch_deg=12, yaw_deg=-15)


@pytest.fixture(scope="module")
def batched(mi: ModuleType) -> dict[str, FloatArray]:
    """Block means of a tilted marker on crinkled foil at one wavelength, (seeds, blocks, blocks) by light."""
    runs = [render(view(SQUARE, target=TILTED, range_m=3.0), whole(SQUARE, 4), seed) for seed in range(SEEDS)]
    return {light: block_means(np.array([run[light][0] for run in runs]), 4) for light in LIGHTS}


@pytest.mark.parametrize("light", LIGHTS)
def test_the_batched_renderer_agrees_with_stock_path(
    batched: dict[str, FloatArray], light: str, tmp_path: Path
) -> None:
    """A tilted marker on crinkled foil, both samplings on the same sub-pixels and through the same kernel.

    Known and allowed for: stock's LED pattern is a texture, whose linear interpolation over cells of h = 2 tan 60° / 512 lowers
    cosⁿ by n h²/12 = 1.2e-4 on average near the axis, per direction; its Sun stands at 1 km, 3e-5 rad of parallax, 5e-5 of a
    cosine at 60 deg.
    """
    scene_view, region = view(SQUARE, target=TILTED, range_m=3.0), whole(SQUARE, 4)
    pad = int(np.ceil(4 * SQUARE.psf_sigma_px + 0.5))
    theirs = np.array(
        [
            reduced(render_subpixels(scene_view, region, pad, NODES[0], light, seed), region, pad, SQUARE)
            for seed in range(SEEDS)
        ]
    )

    def keep(images: dict[str, FloatArray]) -> None:
        write_channels({name: np.float32(image) for name, image in images.items()}, {}, tmp_path / f"{light}.exr")

    systematic = {"led": 2.5e-4, "sun": 5e-5}[light]
    check_same(batched[light], block_means(theirs, 4), systematic, keep)


def test_the_comparison_with_stock_would_notice_a_shift_of_a_tenth_of_a_pixel(batched: dict[str, FloatArray]) -> None:
    """The power of the test above, shown on the batched renderer alone with half the seeds: 0.13 mm at 3 m."""
    shifted = view(SQUARE, target=TILTED, range_m=3.0)
    object.__setattr__(shifted, "translation_m", np.array([0.1 * 3.0 / SQUARE.focal_px[0], 0.0, 3.0]))
    moved = [render(shifted, whole(SQUARE, 4), seed)["led"][0] for seed in range(50, 50 + SEEDS // 2)]
    kept: list[Any] = []
    with pytest.raises(pytest.fail.Exception, match="worst block"):
        check_same(batched["led"], block_means(np.array(moved), 4), 2.5e-4, kept.append)
    assert kept


@pytest.mark.parametrize(("light", "stated", "spp"), [("led", 0.0002, 8), ("sun", 0.007, 48)])
def test_indirect_light_is_as_faint_as_stated(mi: ModuleType, light: str, stated: float, spp: int) -> None:
    """Stock path of up to four segments against two, same seeds: the first two draw the same numbers, so the pairs' spread is
    that of the indirect light alone. Upper end of the 99.9 % interval of the mean.
    """
    scene_view, region = view(SQUARE, target=TILTED, range_m=3.0), whole(SQUARE, 2)
    seeds = 8
    flux = {
        depth: np.array(
            [
                render_subpixels(scene_view, region, 0, 850, light, seed, spp, depth).mean(dtype=float)
                for seed in range(seeds)
            ]
        )
        for depth in (2, 4)
    }
    extra = (flux[4] - flux[2]) / flux[2].mean()
    assert extra.mean() > 0
    assert extra.mean() + student.isf(0.001, seeds - 1) * extra.std(ddof=1) / np.sqrt(seeds) < stated


# --- linearity and reproducibility


def test_the_basis_does_not_depend_on_the_strength_of_the_lights(mi: ModuleType) -> None:
    """Transport per unit strength: power, spectrum, lens aperture and efficiency leave every bit as it is."""
    bright = LedRing(count=6, intensity_w_sr=0.1, centroid_nm=810, electrical_power_w=9)
    camera = SQUARE.model_copy(update={"f_number": 8.0, "lens_transmission": 0.9})
    one = render(view(SQUARE), whole(SQUARE, 2), 1)
    other = render(view(camera, leds=bright), whole(SQUARE, 2), 1)
    for light in LIGHTS:
        assert np.array_equal(one[light], other[light])


def test_reflectance_scales_the_image(mi: ModuleType) -> None:
    """A scene of one Lambertian material at two albedos, same seed: the images differ by their ratio, to single precision."""
    names = ("diffuse_reference", "black_coating")
    images = [
        render(
            view(SQUARE, target=Target(face_material=n, tape_material=n, absorber_material=n, pitch_deg=20), nodes_nm=(850,) * 4),
            whole(SQUARE, 2), 1,
        )
        for n in names
    ]  # fmt: skip
    ratio = np.divide(*(float(library.load(n).diffuse(850.0)) for n in names))
    for light in LIGHTS:
        np.testing.assert_allclose(images[0][light], ratio * images[1][light], rtol=1e-5)


def test_wavelengths_are_rendered_independently_and_in_groups_of_four(mi: ModuleType) -> None:
    alone = render(view(SQUARE, nodes_nm=NODES), whole(SQUARE, 2), 1)
    together = render(view(SQUARE, nodes_nm=(803, 815, *NODES, 895, 897)), whole(SQUARE, 2), 1)
    for light in LIGHTS:
        assert together[light].shape == (8, 40, 48)
        np.testing.assert_allclose(together[light][2:6], alone[light], rtol=1e-6)


def test_one_seed_gives_the_same_bits_and_another_seed_does_not(mi: ModuleType) -> None:
    quality = Quality(frame_samples=1, marker_rays=20_000, seed=5)
    first, again, other = (
        render_basis(view(SQUARE, nodes_nm=NODES), q) for q in (quality, quality, Quality(1, 20_000, 6))
    )
    for light in LIGHTS:
        assert first.layers[light].dtype == np.float32
        assert first.layers[light].shape == (4, 40, 48)
        assert np.array_equal(first.layers[light], again.layers[light])
        assert not np.array_equal(first.layers[light], other.layers[light])
        assert np.all(np.isfinite(first.layers[light]))
        assert first.layers[light].min() >= 0


def test_the_frame_and_the_densely_sampled_marker_fit_together(mi: ModuleType) -> None:
    """Of a plain plate nothing shows where the dense patch was set in: 0.1 % across its edge."""
    basis = render_basis(plate(0.0, 20.0, 0.0, LedRing(count=1)), Quality(frame_samples=6, marker_rays=200_000))
    patch = marker_region(plate(0.0, 20.0, 0.0, LedRing(count=1)), 200_000)
    assert patch is not None
    assert basis.attributes["marker_samples_per_pixel"] == patch.samples**2
    edge = basis.layers["sun"][0][patch.y0 : patch.y0 + patch.height, patch.x0 - 1 : patch.x0 + 1]
    np.testing.assert_allclose(edge[:, 0], edge[:, 1], rtol=1e-3)


# --- regions


def test_the_marker_region_holds_the_whole_marker_with_a_margin() -> None:
    scene_view = view(Camera(), target=Target(pitch_deg=30, yaw_deg=20, roll_deg=45))
    region = marker_region(scene_view, 2_000_000, margin_px=4)
    assert region is not None
    half, back = scene_view.marker.size_m / 2, -scene_view.marker.thickness_m
    box = scene_view.to_image(np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (0, back)]))
    low, high = np.array([region.x0, region.y0]), np.array([region.x0 + region.width, region.y0 + region.height])
    assert np.all(box.min(axis=0) - low >= 4)
    assert np.all(high - 1 - box.max(axis=0) >= 4)
    assert np.all(box.min(axis=0) - low < 5)
    assert np.all(high - 1 - box.max(axis=0) < 5)
    assert region.samples == int(np.sqrt(2_000_000 / (region.width * region.height)))


@pytest.mark.parametrize("range_m", [0.6, 1.0, 1.6])
def test_the_marker_region_is_cut_to_the_frame(range_m: float) -> None:
    """At 1 m a 10 cm marker is 235 px wide: larger than the frame of 64 × 48."""
    region = marker_region(view(marker=MarkerDesign(size_m=0.1), range_m=range_m), 10_000_000)
    assert region == Region(0, 0, 64, 48, 48)


def test_a_marker_that_only_the_frames_height_cuts_keeps_its_width() -> None:
    region = marker_region(view(Camera(width_px=200, height_px=48), range_m=2.0), 100_000)
    assert region is not None
    assert (region.y0, region.height) == (0, 48)
    assert region.x0 > 0
    assert region.x0 + region.width < 200


def test_a_marker_outside_the_frame_has_no_region() -> None:
    scene_view = view()
    object.__setattr__(scene_view, "translation_m", np.array([0.5, 0.0, 2.0]))
    assert marker_region(scene_view, 100_000) is None


@pytest.mark.parametrize(("rays", "samples"), [(1, 2), (10**12, 48)])
def test_sub_pixels_stay_between_2_and_48(rays: int, samples: int) -> None:
    region = marker_region(view(), rays)
    assert region is not None
    assert region.samples == samples


def test_the_reduction_conserves_a_uniform_image() -> None:
    matrix = transport._reduction(20, 3, 26 * 4, 1 / 4, 0.5)
    assert matrix.shape == (20, 104)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=1e-6)
    # Pixel 7's centre is at 10.5 padded pixels, 42 sub-pixels: symmetric about it. Float32 holds 6e-8.
    np.testing.assert_allclose(matrix[7, :42][::-1], matrix[7, 42:84], atol=1e-7)
    np.testing.assert_allclose(matrix[7, 8:76], matrix[8, 12:80], atol=1e-7)
