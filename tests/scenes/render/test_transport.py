"""The transport basis: its pattern, its linearity, and the same bits for the same seed."""

from __future__ import annotations

from types import ModuleType

import numpy as np
from scipy.stats import t as student

from materials import library
from radiometry.geometry import FloatArray
from radiometry.link import reflective_fill
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box
from scenes.render.transport import LIGHTS, Quality, View, render_basis
from scenes.target import Target

NODES = (807, 833, 867, 893)
#: A corner of a real camera: few pixels, its pitches and focal length unchanged.
CAMERA = Camera(width_px=64, height_px=48)
SQUARE = Camera(width_px=48, height_px=40, pixel_pitch_y_m=8.6e-6)


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


def render(scene_view: View, samples: int, seed: int) -> dict[str, FloatArray]:
    """Basis images by the batched renderer, all pixels with about as many samples along a side."""
    return render_basis(scene_view, Quality(samples, 1, seed)).layers


def plate(pitch_deg: float, yaw_deg: float, roll_deg: float, leds: LedRing) -> View:
    """A flat plate of albedo 0.5 that fills the frame, with a marker of 1 cm before its middle."""
    target = Target(
        face_material="diffuse_reference", facet_slope_deg=0, pitch_deg=pitch_deg, yaw_deg=yaw_deg, roll_deg=roll_deg
    )
    return view(marker=MarkerDesign(size_m=0.01), target=target, leds=leds, sun=Sun(phase_deg=25, azimuth_deg=40))


def test_a_frontal_marker_renders_to_its_pattern_under_point_spread_and_pixel(mi: ModuleType) -> None:
    """Every pixel within the ring, against the closed form: no mirror image, no shift, the stated point spread.

    Eight seeds give each pixel's mean and error, held by Student's t at 99.9 % over all pixels (Šidák).
    """
    target = Target(tape_material="diffuse_reference", absorber_material="black_coating")
    scene_view = view(target=target, sun=Sun(phase_deg=40, azimuth_deg=30), range_m=2.6, nodes_nm=(850,) * 4)
    marker, seeds = scene_view.marker, 8
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
    rendered = np.array([render(scene_view, 12, seed)["sun"][0][near] for seed in range(seeds)])
    error = rendered.std(axis=0, ddof=1) / np.sqrt(seeds)
    score = student.isf((1 - 0.999 ** (1 / len(fill))) / 2, seeds - 1)
    assert np.ptp(fill) > 0.9
    assert np.median(error) < 0.002 * contrast  # or the interval would say nothing
    miss = np.abs(rendered.mean(axis=0) - expected) - score * error
    # Disc and cosine: the Sun's half a degree of width moves a plane's radiance by a thousandth at most.
    assert np.all(miss < 1e-3 * expected)


def test_the_basis_does_not_depend_on_the_strength_of_the_lights(mi: ModuleType) -> None:
    """Transport per unit strength: power, spectrum, lens aperture and efficiency leave every bit as it is."""
    bright = LedRing(count=6, intensity_w_sr=0.1, centroid_nm=810, electrical_power_w=9)
    camera = SQUARE.model_copy(update={"f_number": 8.0, "lens_transmission": 0.9})
    one = render(view(SQUARE), 2, 1)
    other = render(view(camera, leds=bright), 2, 1)
    for light in LIGHTS:
        assert np.array_equal(one[light], other[light])


def test_reflectance_scales_the_image(mi: ModuleType) -> None:
    """A scene of one Lambertian material at two albedos, same seed: the images differ by their ratio, to single precision."""
    names = ("diffuse_reference", "black_coating")
    images = [
        render(
            view(
                SQUARE,
                target=Target(face_material=n, tape_material=n, absorber_material=n, pitch_deg=20),
                nodes_nm=(850,) * 4,
            ),
            2,
            1,
        )
        for n in names
    ]
    ratio = np.divide(*(float(library.load(n).diffuse(850.0)) for n in names))
    for light in LIGHTS:
        np.testing.assert_allclose(images[0][light], ratio * images[1][light], rtol=1e-5)


def test_wavelengths_are_rendered_independently_and_in_groups_of_four(mi: ModuleType) -> None:
    alone = render(view(SQUARE, nodes_nm=NODES), 2, 1)
    together = render(view(SQUARE, nodes_nm=(803, 815, *NODES, 895, 897)), 2, 1)
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
    scene_view = plate(0.0, 20.0, 0.0, LedRing(count=1))
    basis = render_basis(scene_view, Quality(frame_samples=1, marker_rays=200_000))
    assert basis.attributes["aruco_rays_per_pixel"] > 1
    box = marker_box(scene_view)
    edge = basis.layers["sun"][0][box.y0 - 3 : box.y1 + 3, box.x0 - 3 : box.x0 + 3]
    np.testing.assert_allclose(edge[:, :-1], edge[:, 1:], rtol=1e-3)
