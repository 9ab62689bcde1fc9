"""What a real lens adds: distortion, blur, vignetting, glare; and the limits of LEDs and the closed form of the Earth."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.optimize import least_squares
from scipy.special import j1

from radiometry.distortion import BrownConrady
from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray
from radiometry.link import frames_per_second
from radiometry.optics import Camera, blur_sigma_px, camera_at, diffraction_sigma_px
from radiometry.sources import Earth, LedRing, Sun, am0_spectrum
from radiometry.spectrum import constant
from radiometry.stray import add_veiling_glare, point_source_transmittance, stray_rate

#: 32° off the axis at the corners.
WIDE = {"width_px": 320, "height_px": 240, "focal_length_m": 2.7e-3}
BARREL = Camera(**WIDE, k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3, k3=-0.004)
small_coefficient = st.floats(-0.12, 0.12)


def directions(camera: Camera, image_px: FloatArray) -> FloatArray:
    """Points (..., 3) that an ideal lens images at positions (..., 2)."""
    tangents = (image_px - camera.principal_point_px) / camera.focal_px
    return np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(
    k1=small_coefficient,
    k2=small_coefficient,
    p1=st.floats(-5e-3, 5e-3),
    p2=st.floats(-5e-3, 5e-3),
    k3=small_coefficient,
    x=st.floats(0, 319),
    y=st.floats(0, 239),
)
def test_projection_undoes_undistortion_everywhere_in_the_frame(
    k1: float, k2: float, p1: float, p2: float, k3: float, x: float, y: float
) -> None:
    camera = Camera(**WIDE, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    image = np.array([x, y])
    # 1e-10 in tangents, the inverse's stated residual, is 3e-8 px here.
    np.testing.assert_allclose(camera.project(directions(camera, camera.undistort_px(image))), image, atol=1e-7)


def test_distortion_is_opencvs() -> None:
    points = np.random.default_rng(1).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (500, 3))
    coefficients = np.array([BARREL.k1, BARREL.k2, BARREL.p1, BARREL.p2, BARREL.k3])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), BARREL.matrix, coefficients)
    np.testing.assert_allclose(BARREL.project(points), theirs[:, 0], atol=1e-9)


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.tuples(*[st.floats(-0.3, 0.3)] * 5), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_the_derivative_of_distortion_is_its_derivative(k: tuple[float, ...], x: float, y: float) -> None:
    lens, step = BrownConrady(*k), 1e-6
    by_x = (np.array(lens.distort(x + step, y)) - lens.distort(x - step, y)) / (2 * step)
    by_y = (np.array(lens.distort(x, y + step)) - lens.distort(x, y - step)) / (2 * step)
    xx, xy, yy = lens.derivative(x, y)
    np.testing.assert_allclose([by_x, by_y], [[xx, xy], [xy, yy]], atol=1e-8)


def test_without_coefficients_the_lens_is_a_pinhole_to_the_last_bit() -> None:
    camera = Camera(**WIDE)
    points = np.random.default_rng(2).uniform([-1, -1, 2], [1, 1, 4], (100, 3))
    np.testing.assert_array_equal(
        camera.project(points), points[:, :2] / points[:, 2:] * camera.focal_px + camera.principal_point_px
    )
    assert camera.without_distortion is camera
    assert not BARREL.without_distortion.distorted


def test_what_stands_outside_the_frame_is_not_folded_back_into_it() -> None:
    angle = np.linspace(0, 2 * np.pi, 60)[:, None]
    far = np.linspace(1.0, 30.0, 40)
    points = np.stack([far * np.cos(angle), far * np.sin(angle), np.ones_like(far * angle)], axis=-1)
    polynomial = np.stack(BARREL.distortion.distort(points[..., 0], points[..., 1]), axis=-1) * BARREL.focal_px
    corner = np.array(BARREL.principal_point_px)
    assert np.any(np.all(np.abs(polynomial) < corner, axis=-1))  # as the bare polynomial would
    assert not np.any(np.all(np.abs(BARREL.project(points) - corner) < corner, axis=-1))


@pytest.mark.parametrize("coefficients", [{"k1": -1.5}, {"k1": 0.1, "k2": -2.0}, {"p1": 0.5}, {"k3": -4.0}])
def test_a_lens_that_folds_the_frame_back_is_refused(coefficients: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match="folds the image back within the frame"):
        Camera(**WIDE, **coefficients)


def test_distortion_spreads_light_without_making_any() -> None:
    """What falls on all pixels of a uniform scene is what the pupil takes from the solid angle that they show."""
    sharp = BARREL.relative_illumination() / BARREL.natural_falloff()  # ideal area of each pixel
    right, bottom = BARREL.width_px - 0.5, BARREL.height_px - 0.5
    x, y = np.linspace(-0.5, right, 2001), np.linspace(-0.5, bottom, 2001)
    sides = [(x, 0 * x - 0.5), (0 * y + right, y), (x[::-1], 0 * x + bottom), (0 * y - 0.5, y[::-1])]
    px, py = BARREL.undistort_px(np.concatenate([np.column_stack(side) for side in sides])).T
    area = abs(px @ np.roll(py, -1) - py @ np.roll(px, -1)) / 2
    assert sharp.sum() == pytest.approx(area, rel=1e-5)  # midpoint rule over the pixels
    assert area > BARREL.width_px * BARREL.height_px  # a barrel shows more


def test_the_gaussian_of_diffraction_fits_the_core_of_the_airy_pattern() -> None:
    radius = np.linspace(1e-6, 1.22, 2000)  # in λ F#, to the first dark ring
    airy = (2 * j1(np.pi * radius) / (np.pi * radius)) ** 2
    fit = least_squares(lambda s: (np.exp(-(radius**2) / (2 * s**2)) - airy) * np.sqrt(radius), [0.4])  # over the area
    camera = Camera(pixel_pitch_x_m=5e-6, pixel_pitch_y_m=5e-6, f_number=8.0)
    assert diffraction_sigma_px(camera, 850.0) == pytest.approx(fit.x[0] * 850e-9 * 8.0 / 5e-6, rel=2e-3)


def test_blur_adds_diffraction_and_defocus_to_the_lens() -> None:
    camera = Camera(pixel_pitch_x_m=8e-6, pixel_pitch_y_m=8e-6, focal_length_m=20e-3, f_number=2.0)
    assert blur_sigma_px(camera, 3.0, 850.0) == camera.psf_sigma_px  # in focus everywhere, far from diffraction
    assert camera_at(camera, 3.0, 850.0) is camera
    small_stop = camera.model_copy(update={"f_number": 22.0})
    assert blur_sigma_px(small_stop, 3.0, 850.0) == pytest.approx(0.42 * 850e-9 * 22 / 8e-6)
    near = camera.model_copy(update={"focus_m": 2.0})
    # (20 mm)²/2 · |1/2 − 1/8| = 75 µm: 9.375 px across, a quarter of it as standard deviation.
    assert blur_sigma_px(near, 8.0, 850.0) == pytest.approx(np.hypot(0.5, 9.375 / 4))
    assert blur_sigma_px(near, 2.0, 850.0) == 0.5
    seen = camera_at(near, 8.0, 850.0)
    assert (seen.psf_sigma_px, seen.focus_m) == (blur_sigma_px(near, 8.0, 850.0), None)
    assert camera_at(seen, 8.0, 850.0) is seen  # not blurred twice
    with pytest.raises(ValueError, match=r"focus 2 m at F/2 blurs a point at 0\.05 m .* expected at most 20 px"):
        camera_at(near, 0.05, 850.0)


def test_an_ideal_lens_has_no_point_spread_but_defocus() -> None:
    ideal = Camera(psf_sigma_px=0.0, f_number=16.0)
    assert blur_sigma_px(ideal, 5.0, 850.0) == 0.0
    assert blur_sigma_px(ideal.model_copy(update={"focus_m": 2.0}), 5.0, 850.0) > 0


def test_a_quarter_of_the_circle_is_the_spread_of_a_uniform_disc() -> None:
    across = np.linspace(-1, 1, 4001)
    chord = np.sqrt(1 - across**2)  # a disc of diameter 2, summed along y
    assert np.sqrt(np.average(across**2, weights=chord)) == pytest.approx(2 / 4, rel=1e-3)


def test_vignetting_takes_its_fraction_at_the_corners_and_grows_with_the_square() -> None:
    plain, camera = Camera(**WIDE), Camera(**WIDE, vignetting=0.3)
    loss = 1 - camera.relative_illumination() / plain.relative_illumination()
    np.testing.assert_allclose([loss[0, 0], loss[-1, 0], loss[0, -1], loss[-1, -1]], 0.3)
    (fx, fy), (cx, cy) = plain.focal_px, plain.principal_point_px
    share = ((60 - cx) / fx) ** 2 + ((30 - cy) / fy) ** 2
    assert loss[30, 60] == pytest.approx(0.3 * share / ((cx / fx) ** 2 + (cy / fy) ** 2))
    np.testing.assert_array_equal(camera.natural_falloff(), plain.relative_illumination())


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.floats(0, 1), st.integers(0, 1000))
def test_veiling_glare_moves_light_and_keeps_it(glare: float, seed: int) -> None:
    rate = np.random.default_rng(seed).exponential(1e6, (12, 16))
    spread = add_veiling_glare(rate, glare)
    assert spread.sum() == pytest.approx(rate.sum(), rel=1e-12)
    assert np.ptp(spread) == pytest.approx((1 - glare) * np.ptp(rate), rel=1e-9, abs=1e-6)
    np.testing.assert_allclose(add_veiling_glare(rate[3, 4], glare, float(rate.mean())), spread[3, 4])


def test_point_source_transmittance_is_log_linear_and_ends_with_its_table() -> None:
    camera = Camera(point_source_transmittance=((20.0, 1e-4), (40.0, 1e-6), (60.0, 1e-7)))
    at = point_source_transmittance(camera, np.radians([0.0, 20.0, 30.0, 50.0, 60.0, 61.0, 180.0]))
    np.testing.assert_allclose(at, [1e-4, 1e-4, 1e-5, 10**-6.5, 1e-7, 0, 0], rtol=1e-9)
    assert point_source_transmittance(Camera(), 0.5) == 0


@pytest.mark.parametrize(
    "table", [((20.0, 1e-4),), ((20.0, 1e-4), (10.0, 1e-5)), ((20.0, 0.0), (30.0, 1e-5)), ((20.0, 1.0), (200.0, 1e-5))]
)
def test_a_stray_light_table_that_makes_no_sense_is_refused(table: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValidationError, match="expected two or more rows"):
        Camera(point_source_transmittance=table)


def test_stray_light_is_irradiance_times_transmittance_on_a_pixel() -> None:
    """2 W m⁻² nm⁻¹ over 800–802 nm (4 W/m²) at a PST of 1e-5 on (5 µm)², in photons of 801 nm at a QE of 0.5."""
    camera = Camera(pixel_pitch_x_m=5e-6, pixel_pitch_y_m=5e-6, point_source_transmittance=((10.0, 1e-5), (90.0, 1e-5)))
    rate = stray_rate(camera, 0.5, constant(2.0), constant(1.0, 800.0, 802.0), constant(0.5))
    photon_j = 6.62607015e-34 * 299792458 / 801e-9
    assert rate == pytest.approx(4 * 1e-5 * 25e-12 * 0.5 / photon_j, rel=1e-9)


def test_frames_per_second_are_the_thesiss() -> None:
    """Equation 6.10: 100 LEDs of 2.1 W for 20 ms are 4.2 J a frame; 5 W pay for 1.19 frames a second."""
    ring = LedRing(count=100, electrical_power_w=2.1)
    energy = ring.energy_per_frame_j(0.02)
    assert float(energy) == pytest.approx(4.2)
    assert float(frames_per_second(5.0, energy)) == pytest.approx(1.190, abs=5e-4)
    assert float(frames_per_second(5.0, energy, 0.02, duty_max=0.01)) == pytest.approx(0.5)
    both = frames_per_second(5.0, ring.energy_per_frame_j([0.02, 1e-4]), [0.02, 1e-4], duty_max=0.02)
    np.testing.assert_allclose(both, [1.0, 200.0])  # duty cycle binds either way
    np.testing.assert_allclose(frames_per_second([5.0, 10.0], 4.2), [5 / 4.2, 10 / 4.2])


def test_pulses_are_bounded_in_length_and_duty() -> None:
    ring = LedRing(longest_pulse_s=1e-3, duty_max=0.1)
    assert ring.pulse_allowed(1e-3)
    assert not ring.pulse_allowed(1.01e-3)
    np.testing.assert_array_equal(ring.pulse_allowed(1e-3, [10.0, 100.0, 101.0]), [True, True, False])
    assert ring.pulse_allowed(5e-4, frames_per_second(np.inf, 1.0, 5e-4, ring.duty_max))
    assert LedRing().pulse_allowed(100.0, 0.01)  # no limit unless one is given


def test_the_earth_is_as_bright_as_a_sunlit_lambert_surface() -> None:
    radiance = Earth(albedo=0.3).radiance(Sun(distance_au=2.0))
    assert float(radiance(850.0)) == pytest.approx(0.3 / np.pi * float(am0_spectrum()(850.0)) / 4)


def _direction(polar_deg: float, azimuth_deg: float) -> FloatArray:
    polar, azimuth = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def _lambert(normal: FloatArray, to_source: FloatArray, to_viewer: FloatArray, wavelength: FloatArray) -> FloatArray:
    return np.full(np.broadcast_shapes(to_source.shape[:-1], wavelength.shape), 0.5 / np.pi)


@pytest.mark.parametrize(
    ("radius_deg", "earth_deg", "viewer_deg"), [(70, 0, 0), (70, 15, 60), (30, 50, 20), (85, 0, 70), (10, 70, 70)]
)
def test_light_of_the_earth_on_a_lambert_plane_is_its_view_factor(
    radius_deg: float, earth_deg: float, viewer_deg: float
) -> None:
    """Albedo · sin²(radius) · cos(earth) where the whole disc stands above the horizon."""
    seen = earth_transport(
        _direction(viewer_deg, 20.0), _direction(earth_deg, 70.0), np.radians(radius_deg), _lambert, np.array([850.0])
    )
    exact = 0.5 * np.sin(np.radians(radius_deg)) ** 2 * np.cos(np.radians(earth_deg))
    np.testing.assert_allclose(seen, exact, rtol=3e-4)


def test_half_an_earth_on_the_horizon_lights_a_plane_by_its_upper_half() -> None:
    """View factor of a half disc of radius ρ centred on the horizon: (ρ − sin ρ cos ρ)/π."""
    radius = np.radians(70.0)
    seen = earth_transport(_direction(30.0, 0.0), _direction(90.0, 0.0), radius, _lambert, np.array([850.0]))
    np.testing.assert_allclose(seen, 0.5 * (radius - np.sin(radius) * np.cos(radius)) / np.pi, rtol=3e-3)
