"""Optics: projection, the camera equation, point spread and blur, and spectral integration that narrow lines do not fool."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from pydantic import ValidationError
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.special import j1, ndtr

from radiometry.filters import Bandpass
from radiometry.optics import (
    Camera,
    blur_sigma_px,
    camera_at,
    diffraction_sigma_px,
    electron_responsivity,
    electrons_per_joule,
    etendue_m2_sr,
    node_weights,
    pixel_profile_integral,
    wavelength_nodes,
)
from radiometry.spectrum import Spectrum, constant, gaussian_line

BAND = Bandpass(low_nm=820, high_nm=880, edge_nm=1.0)  # 60 nm wide
SQUARE = Camera(pixel_pitch_x_m=8.6e-6, pixel_pitch_y_m=8.6e-6)
#: 32° off the axis at the corners.
WIDE = {"width_px": 320, "height_px": 240, "focal_length_m": 2.7e-3}


def test_electron_responsivity_is_the_constant_of_the_audit() -> None:
    """3.884e6 e⁻/s per W m⁻² sr⁻¹ at 850 nm, for 8.6 µm square pixels, F/2.8 and T = QE = 0.35."""
    rate = electron_responsivity(SQUARE, constant(1.0), constant(0.35))
    assert float(rate(850.0)) == pytest.approx(3.884e6, abs=500)


def test_a_photon_of_1240_nm_carries_one_electron_volt() -> None:
    """hc = 1239.842 eV nm, so a joule at that wavelength holds 1/1.602177e-19 photons."""
    assert float(electrons_per_joule(1239.842)) == pytest.approx(1 / 1.602177e-19, rel=1e-6)


def test_etendue_is_the_pixels_area_times_the_lenss_solid_angle() -> None:
    """Small apertures: the cone of the pupil as the pixel sees it, at a distance of one focal length."""
    camera = Camera(f_number=100.0)
    half_angle = np.arctan(0.5 / camera.f_number)
    cone = 2 * np.pi * (1 - np.cos(half_angle))
    # π/(4F²) is the cone to first order in 1/F²; the next is 3/16 of 1/F².
    assert etendue_m2_sr(camera) == pytest.approx(camera.pixel_area_m2 * cone, rel=0.2 / camera.f_number**2)


def test_responsivity_follows_filter_and_quantum_efficiency() -> None:
    """Between knots the product of an edge and a slope is taken as linear: off by at most a quarter of 1 × 0.001."""
    efficiency = Spectrum([300, 1200], [0.9, 0.0])
    response = electron_responsivity(SQUARE, BAND.spectrum(), efficiency)
    flat = electron_responsivity(SQUARE, constant(1.0), constant(1.0))
    for wavelength, transmission in ((819.0, 0.0), (820.0, 0.5), (850.0, 1.0), (880.25, 0.25), (881.0, 0.0)):
        share = float(response(wavelength)) / float(flat(wavelength))
        assert share == pytest.approx(transmission * float(efficiency(wavelength)), abs=0.25e-3)
    assert np.diff(response.wavelength_nm).max() <= 0.5 + 1e-9


@settings(deadline=None, derandomize=True)
@given(st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 50)))
def test_projection_is_the_intrinsic_matrix(point: tuple[float, float, float]) -> None:
    camera = Camera()
    homogeneous = camera.matrix @ np.array(point)
    found = camera.project(point)
    np.testing.assert_allclose(found, homogeneous[:2] / homogeneous[2], rtol=1e-12, atol=1e-9)


def test_the_optical_axis_meets_the_centre_of_the_pixel_grid() -> None:
    """Pixel centres lie at integers: the middle of an even count lies between two of them."""
    assert Camera(width_px=752, height_px=581).project([0, 0, 3.0]) == pytest.approx([375.5, 290.0], abs=0)


def test_images_grow_to_the_right_and_downwards() -> None:
    x, y = Camera().project([1e-3, 2e-3, 1.0]) - np.array(Camera().principal_point_px)
    assert (x, y) == pytest.approx((20.19e-3 / 8.6e-6 * 1e-3, 20.19e-3 / 8.3e-6 * 2e-3), rel=1e-9)


def test_illumination_falls_with_the_fourth_power_of_the_field_angles_cosine() -> None:
    camera = Camera(width_px=65, height_px=33, focal_length_m=1e-3)
    fall_off = camera.relative_illumination()
    assert fall_off.shape == (33, 65)
    assert fall_off[16, 32] == 1
    ray = np.linalg.inv(camera.matrix) @ [64, 32, 1]
    assert fall_off[32, 64] == pytest.approx((1 / np.linalg.norm(ray)) ** 4, rel=1e-12)


@pytest.mark.parametrize(
    ("field", "value"),
    [("f_number", 0), ("focal_length_m", np.nan), ("width_px", 15), ("lens_transmission", 1.2), ("psf_sigma_px", -1)],
)
def test_a_camera_that_cannot_be_built_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        Camera(**{field: value})


@pytest.mark.parametrize("count", [4, 8, 12])
def test_nodes_are_whole_nanometres_spread_evenly_over_the_passband(count: int) -> None:
    nodes = wavelength_nodes(BAND.spectrum(), count)
    assert len(nodes) == count
    assert all(819.5 < n < 880.5 for n in nodes)
    assert list(nodes) == sorted(nodes)
    mirrored = [1700 - n for n in reversed(nodes)]
    assert np.abs(np.array(nodes) - mirrored).max() <= 1  # rounding to whole nanometres


@pytest.mark.parametrize("count", [0, 2, 5, 6])
def test_node_counts_that_do_not_fill_rays_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match="multiple of 4"):
        wavelength_nodes(BAND.spectrum(), count)


def test_a_band_too_narrow_for_its_nodes_is_refused() -> None:
    with pytest.raises(ValueError, match=r"848\.95-851\.05 nm is too narrow for 8 nodes"):
        wavelength_nodes(Bandpass(low_nm=849, high_nm=851).spectrum(), 8)


coefficients = st.tuples(*[st.floats(-1, 1)] * 4)


@settings(deadline=None, derandomize=True)
@given(coefficients, st.floats(810, 890), st.floats(0.5, 60), st.sampled_from([4, 8]))
def test_node_weights_are_exact_for_cubic_transport(
    cubic: tuple[float, ...], centre: float, fwhm: float, count: int
) -> None:
    """Exact against the trapezoid rule on the weight's own grid: the nodes add nothing but rounding."""
    transport = Polynomial(cubic, domain=[800, 900])
    weight = gaussian_line(centre, fwhm) * electron_responsivity(SQUARE, BAND.spectrum(), constant(0.35))
    nodes = wavelength_nodes(BAND.spectrum(), count)
    found = node_weights(weight, nodes) @ transport(np.array(nodes, float))
    grid = weight.wavelength_nm
    expected = np.trapezoid(weight.values * transport(grid), grid)
    # Eight nodes are a few nanometres apart at the ends: extrapolation amplifies rounding a thousandfold at most.
    assert found == pytest.approx(expected, abs=1e-12 * np.trapezoid(weight.values, grid) + 1e-200)


@pytest.mark.parametrize("count", [4, 8])
@pytest.mark.parametrize("centre", [850.0, 833.3, 820.0, 880.4, 879.2, 818.5, 881.7])
@pytest.mark.parametrize("fwhm", [2.0, 30.0])
def test_a_narrow_line_through_a_bandpass_is_not_biased(centre: float, fwhm: float, count: int) -> None:
    """A 2 nm line, inside a 60 nm band or on its edge, against adaptive quadrature of the exact curves.

    The grid of the weight has steps of h ≤ σ/20. The trapezoid rule errs by h²/12 ∫|(g r)''| ≤ h²/12 (∫|g''| + 2 max|g'|) for a
    line g of unit area through edges r that rise or fall by one: ≤ (0.97 + 0.97)/4800 = 4.1e-4 of the whole line. The
    ends at ±5σ hold 6e-7.
    """
    sigma = fwhm / (2 * np.sqrt(2 * np.log(2)))
    transport = Polynomial([0.3, 0.1, -0.2, 0.15], domain=[820, 880])

    def exact(wavelength: float) -> float:
        line = np.exp(-0.5 * ((wavelength - centre) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        passed = np.interp(wavelength, [819.5, 820.5, 879.5, 880.5], [0, 1, 1, 0])
        return float(line * passed * transport(wavelength))

    cuts = np.clip([819.5, 820.5, centre - 3 * sigma, centre, centre + 3 * sigma, 879.5, 880.5], 819.5, 880.5)
    expected = sum(quad(exact, a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(np.sort(cuts)))
    weight = gaussian_line(centre, fwhm) * BAND.spectrum().resampled(0.5)
    nodes = wavelength_nodes(BAND.spectrum(), count)
    found = node_weights(weight, nodes) @ transport(np.array(nodes, float))
    assert found == pytest.approx(expected, abs=4.1e-4 * np.abs(transport(np.linspace(819, 881))).max())


@settings(deadline=None, derandomize=True)
@given(st.floats(-8, 8), st.floats(0.02, 5))
def test_pixel_profile_is_the_box_convolved_with_the_point_spread(x: float, sigma: float) -> None:
    kinks = [u for u in (x - 4 * sigma, x, x + 4 * sigma) if -0.5 < u < 0.5]
    expected, error = quad(lambda u: ndtr((x - u) / sigma), -0.5, 0.5, points=kinks or None, epsabs=1e-11)
    assert float(pixel_profile_integral(x, sigma)) == pytest.approx(expected, abs=error + 1e-12)


def test_without_point_spread_the_profile_is_the_bare_pixel() -> None:
    x = np.array([-2, -0.5, -0.25, 0, 0.25, 0.5, 2])
    # A point spread of zero is taken as 1e-6 px, which rounds the box's corners by 4e-7.
    np.testing.assert_allclose(pixel_profile_integral(x, 0.0), [0, 0, 0.25, 0.5, 0.75, 1, 1], atol=4e-7)


@settings(deadline=None, derandomize=True)
@given(st.floats(-50, 50), st.floats(0, 20))
def test_two_half_planes_fill_a_pixel(x: float, sigma: float) -> None:
    both = pixel_profile_integral(x, sigma) + pixel_profile_integral(-x, sigma)
    assert float(both) == pytest.approx(1, abs=1e-13)


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
