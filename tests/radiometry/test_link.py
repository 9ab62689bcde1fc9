"""The closed-form link budget, term by term, against geometry and direct numerical integration."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import ndtr

from radiometry.filters import Bandpass
from radiometry.geometry import FloatArray
from radiometry.link import (
    band_grid,
    cnr,
    electron_rate,
    frames_per_second,
    reflective_fill,
    ring_transport,
    sampling_window_px,
    smear_px,
    snr,
    sun_transport,
)
from radiometry.optics import Camera, electron_responsivity, pixel_profile_integral
from radiometry.sources import LedRing
from radiometry.spectrum import Spectrum, constant, gaussian_line

NODES = np.array([810.0, 850.0, 890.0])
SLOPE = np.array([0.1, 0.2, 0.4])


def flat(normal: FloatArray, to_source: FloatArray, to_viewer: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """A BRDF of 0.1, 0.2 and 0.4 sr⁻¹ at the three wavelengths, in every direction."""
    shape = np.broadcast_shapes(to_source.shape[:-1], to_viewer.shape[:-1], wavelength_nm.shape)
    return np.broadcast_to(np.interp(wavelength_nm, NODES, SLOPE), shape)


def ring_on_axis(range_m: float, **values: float) -> FloatArray:
    """Transport of the marker's centre, frontal, at a range."""
    ring = LedRing(**values)
    camera = np.array([0, 0, range_m])
    leds = camera + ring.positions_m() * [1, -1, -1]
    return ring_transport([0.0, 0, 0], camera, leds, axis=[0, 0, -1.0], ring=ring, brdf=flat, wavelength_nm=NODES)


def test_on_the_axis_the_ring_gives_brdf_over_distance_squared() -> None:
    """With the ring shrunk onto the lens: L/I₀ = f / R²; all angles are zero."""
    np.testing.assert_allclose(ring_on_axis(4.0, ring_radius_m=1e-9), SLOPE / 16, rtol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 100])
def test_off_the_lens_pattern_cosine_and_distance_enter_once_each(count: int) -> None:
    """Every LED of the ring sees the centre alike: L/I₀ = f cosⁿθ cosθ / (R² + b²), tan θ = b/R."""
    cosine = 2 / np.hypot(2, 0.3)
    exponent = LedRing().exponent
    expected = SLOPE * cosine**exponent * cosine / (2**2 + 0.3**2)
    np.testing.assert_allclose(ring_on_axis(2.0, ring_radius_m=0.3, count=count), expected, rtol=1e-12)


@settings(deadline=None, derandomize=True)
@given(st.floats(0.5, 50), st.floats(1.1, 10))
def test_ring_light_follows_the_inverse_square_where_the_geometry_scales(range_m: float, factor: float) -> None:
    near = ring_on_axis(range_m, ring_radius_m=0.05 * range_m)
    far = ring_on_axis(factor * range_m, ring_radius_m=0.05 * factor * range_m)
    np.testing.assert_allclose(near, far * factor**2, rtol=1e-12)


def test_points_keep_their_leading_shape_and_each_its_own_light() -> None:
    ring = LedRing(count=3, ring_radius_m=0.05)
    camera = np.array([0, 0, 1.0])
    leds = camera + ring.positions_m() * [1, -1, -1]
    points = np.random.default_rng(5).uniform(-0.1, 0.1, (2, 4, 3)) * [1, 1, 0]
    together = ring_transport(points, camera, leds, axis=[0, 0, -1.0], ring=ring, brdf=flat, wavelength_nm=NODES)
    assert together.shape == (2, 4, 3)
    alone = [
        np.mean(
            [
                SLOPE
                * ring.pattern((led - p)[2] / np.linalg.norm(led - p))
                * (led - p)[2]
                / np.linalg.norm(led - p) ** 3
                for led in leds
            ],
            axis=0,
        )
        for p in points.reshape(-1, 3)
    ]
    np.testing.assert_allclose(together.reshape(-1, 3), alone, rtol=1e-12)


def test_light_from_behind_the_plane_does_not_count() -> None:
    ring = LedRing(count=1)
    behind = ring_transport(
        [0.0, 0, 0],
        [0, 0, 1.0],
        np.array([[0.5, 0, -0.1]]),
        axis=[-1.0, 0, 0],
        ring=ring,
        brdf=flat,
        wavelength_nm=NODES,
    )
    assert not np.any(behind)
    assert not np.any(sun_transport([0.0, 0, 0], [0, 0, 1.0], [0.6, 0, -0.8], flat, NODES))


@settings(deadline=None, derandomize=True)
@given(st.floats(0, np.pi / 2))
def test_sunlight_is_brdf_times_the_cosine_of_incidence(incidence: float) -> None:
    to_sun = np.array([np.sin(incidence), 0, np.cos(incidence)])
    found = sun_transport([0.0, 0, 0], [0, 0, 5.0], to_sun, flat, NODES)
    np.testing.assert_allclose(found, SLOPE * np.cos(incidence), rtol=1e-12)


def test_electron_rate_is_the_integral_of_piecewise_linear_transport() -> None:
    """A 2 nm line on the edge of the band: adaptive quadrature against the sum over three wavelengths.

    Tolerance: the trapezoid bound of a line sampled at σ/20, 4.1e-4 of the whole line (derived at the node weights' test).
    """
    band = Bandpass(low_nm=820, high_nm=880, edge_nm=1.0).spectrum().resampled(0.5)
    for centre in (850.0, 820.2, 879.9):
        line = gaussian_line(centre, 2.0)
        found = float(electron_rate(SLOPE, NODES, line, band))
        sigma = 2.0 / (2 * np.sqrt(2 * np.log(2)))

        def exact(x: float, centre: float = centre, sigma: float = sigma) -> float:
            passed = np.interp(x, [819.5, 820.5, 879.5, 880.5], [0, 1, 1, 0])
            shape = np.exp(-0.5 * ((x - centre) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
            return float(shape * passed * np.interp(x, NODES, SLOPE))

        cuts = np.clip([819.5, 820.5, centre - 3, centre, centre + 3, 850.0, 879.5, 880.5], 819.5, 880.5)
        cuts.sort()
        expected = sum(quad(exact, a, b, epsabs=1e-12)[0] for a, b in itertools.pairwise(cuts))
        assert found == pytest.approx(expected, abs=4.1e-4 * SLOPE.max())


def test_electron_rate_of_flat_transport_is_the_band_integral() -> None:
    response = electron_responsivity(Camera(), Bandpass().spectrum(), constant(0.35))
    strength = Spectrum([300, 1200], [2.0, 3.0])
    rate = electron_rate(np.full((5, 3), 0.7), NODES, strength, response)
    np.testing.assert_allclose(rate, 0.7 * (strength * response).integral(), rtol=1e-12)
    assert rate.shape == (5,)


def test_band_grid_spans_the_band_in_fine_enough_steps() -> None:
    response = electron_responsivity(Camera(), Bandpass().spectrum(), constant(0.35))
    grid = band_grid(response, 7.0)
    assert (grid[0], grid[-1]) == response.support_nm
    assert np.diff(grid).max() <= 7.0


@st.composite
def rectangles(draw: st.DrawFn) -> list[tuple[int, int, int, int]]:
    """One to four rectangles on a grid of 1/64 px within 0-8 px."""
    edge = st.integers(0, 8 * 64)
    pairs = st.tuples(edge, edge).filter(lambda p: p[0] != p[1]).map(lambda p: (min(p), max(p)))
    return draw(st.lists(st.tuples(pairs, pairs).map(lambda p: (*p[0], *p[1])), min_size=1, max_size=4))


def _sampled_kernel(offset: FloatArray, sigma: float) -> FloatArray:
    """Point spread ⊗ pixel at an offset [px], per px."""
    return ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(rectangles(), st.floats(0.3, 2.0))
def test_reflective_fill_is_the_supersampled_convolution(cells: list[tuple[int, int, int, int]], sigma: float) -> None:
    """Against a sum over sub-pixels of 1/64 px, on whose edges the rectangles lie.

    The midpoint rule errs by h²/24 ∫|K''| per axis; ∫|K''| ≤ 4 max φ_σ = 1.6/σ for a box smeared by σ, and the other axis weighs
    at most one.
    """
    h = 1 / 64
    pattern = np.zeros((8 * 64, 8 * 64))
    for x0, x1, y0, y1 in cells:
        pattern[y0:y1, x0:x1] += 1
    centres = (np.arange(8 * 64) + 0.5) * h
    pixels = np.arange(-1, 9)[:, None].astype(float)
    weights = _sampled_kernel(centres - pixels, sigma) * h
    expected = weights @ pattern @ weights.T
    grid = np.stack(np.meshgrid(pixels[:, 0], pixels[:, 0]), axis=-1).reshape(-1, 2)
    found = reflective_fill(grid, np.array(cells) * h, sigma).reshape(expected.shape)
    bound = 2 * len(cells) * h**2 / 24 * 1.6 / sigma
    np.testing.assert_allclose(found, expected, atol=bound)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(rectangles(), st.floats(0.2, 2.0), st.integers(0, 3), st.booleans())
def test_a_rectangle_fills_alike_as_a_quadrilateral(
    cells: list[tuple[int, int, int, int]], sigma: float, first: int, clockwise: bool
) -> None:
    """Whichever corner comes first and whichever way round, to the 1e-6 that is stated from a point spread of 0.2 px on."""
    boxes = np.array(cells) / 64
    corners = np.stack([boxes[:, [0, 2]], boxes[:, [1, 2]], boxes[:, [1, 3]], boxes[:, [0, 3]]], axis=1)
    corners = np.roll(corners[:, ::-1] if clockwise else corners, first, axis=1)
    pixels = np.random.default_rng(4).uniform(-1, 9, (40, 2))
    difference = reflective_fill(pixels, corners, sigma) - reflective_fill(pixels, boxes, sigma)
    assert np.abs(difference).max() <= 1e-6 * len(cells)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.floats(-2, 2), st.floats(-1.2, 1.2), st.floats(0.2, 2.0))
def test_a_slanted_edge_fills_as_adaptive_quadrature_says(distance: float, slant: float, sigma: float) -> None:
    """A half plane beyond the line y = distance + x tan(slant), as a quadrilateral much larger than the kernel."""
    along, across = np.array([np.cos(slant), np.sin(slant)]), np.array([-np.sin(slant), np.cos(slant)])
    start = np.array([0.0, distance])
    quad_px = start + np.array([-60 * along, 60 * along, 60 * along - 60 * across, -60 * along - 60 * across])
    kinks = [-0.5, 0.5]
    expected, error = quad(
        lambda x: float(
            _sampled_kernel(np.array(x), sigma) * pixel_profile_integral(distance + x * np.tan(slant), sigma)
        ),
        -0.5 - 8 * sigma,
        0.5 + 8 * sigma,
        points=kinks,
        epsabs=1e-10,
        limit=200,
    )
    assert float(reflective_fill([[0.0, 0.0]], quad_px[None], sigma)[0]) == pytest.approx(expected, abs=error + 1e-6)


def test_pixels_deep_inside_a_polygon_hold_its_whole_share_and_those_about_its_edge_join_them() -> None:
    """Whichever way round its corners go; from the inside out, the fill falls without a step where quadrature takes over."""
    square = np.array([[-20.0, -20.0], [20.0, -16.0], [18.0, 21.0], [-19.0, 20.0]])
    line = np.column_stack([np.zeros(401), np.linspace(0, 30, 401)])
    for corners in (square, square[::-1]):
        fill = reflective_fill(line, corners[None], 0.6, [0.7])
        np.testing.assert_array_equal(fill[line[:, 1] < 15], 0.7)
        assert np.all(np.diff(fill) < 1e-6)
        assert np.abs(np.diff(fill)).max() < 0.7 * 0.1
        assert fill[-1] == 0


def test_a_plane_full_of_tape_fills_every_pixel() -> None:
    fill = reflective_fill([[0, 0], [3.2, -1.7]], [[-100, 100, -100, 0.5], [-100, 100, 0.5, 100]], 0.5)
    np.testing.assert_allclose(fill, 1, atol=1e-12)


def test_the_sampling_window_is_half_a_bit_but_a_pixel_at_least() -> None:
    assert np.array_equal(sampling_window_px([0.5, 2, 3, 12]), [1, 1, 1.5, 6])


def test_smear_is_image_speed_times_exposure_on_the_finer_pitch() -> None:
    """Thesis setting: 5 deg/s at a lever of 0.57 m for 1/50 s moves 1 mm, 2.3 px at 1 m (audit, section 5) on 8.6 µm."""
    speed = np.radians(5) * 0.57
    square = Camera(pixel_pitch_y_m=8.6e-6)
    assert float(smear_px(square, 1.0, speed, 1 / 50)) == pytest.approx(2.3, abs=0.05)
    assert float(smear_px(Camera(), 1.0, speed, 1 / 50)) == pytest.approx(
        Camera().project([speed / 50, speed / 50, 1.0])[1] - Camera().principal_point_px[1], rel=1e-12
    )


electrons = st.floats(1e-3, 1e6)


@settings(deadline=None, derandomize=True)
@given(electrons, electrons, st.floats(0, 1e3))
def test_snr_squared_times_variance_is_signal_squared(signal: float, dark: float, noise: float) -> None:
    assert snr(signal, dark, noise) ** 2 * (signal + dark + noise**2) == pytest.approx(signal**2, rel=1e-12)


@settings(deadline=None, derandomize=True)
@given(electrons, electrons, electrons, st.floats(0, 1e3))
def test_cnr_is_antisymmetric_and_never_above_snr(signal: float, background: float, dark: float, noise: float) -> None:
    assert cnr(signal, background, dark, noise) == -cnr(background, signal, dark, noise)
    assert cnr(signal, background, dark, noise) <= snr(signal, dark, noise)


def test_shot_noise_alone_gives_root_n() -> None:
    assert float(snr(400.0, 0, 0)) == 20
    assert float(cnr(400.0, 0, 0, 0)) == 20
    assert float(cnr(400.0, 400.0, 0, 0)) == 0


def test_ten_to_one_takes_336_electrons_against_the_thesiss_read_noise() -> None:
    """S² = 100 (S + 28.2²) has the root 336.4 (audit, 1.3: 336)."""
    assert snr(335.5, 0, 28.2) < 10 < snr(336.5, 0, 28.2)


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
