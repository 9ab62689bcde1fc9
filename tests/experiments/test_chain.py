"""The stages of the chain: what each takes, refuses and repeats."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from detector.sensor.noise import noise_of
from experiments import chain
from experiments.chain import trials
from experiments.chain.exposure import camera_pattern
from experiments.scenario import Scenario, load_scenario
from radiometry.geometry import attitude_matrix, faces_camera
from scenes.render.transport import TransportBasis


def changed(scenario: Scenario, section: str, **values: Any) -> Scenario:
    return scenario.at(**{section: {**getattr(scenario, section).model_dump(), **values}})


def test_automatic_exposure_brings_bright_bits_to_the_wanted_part_of_the_usable_well(small: Scenario) -> None:
    for illumination in ("eclipse", "sunlit"):
        budget = chain.link_budget(small, illumination)
        seconds = chain.solve_exposure(small, budget, "auto")
        assert budget.at(seconds)["full_well_fraction"] == pytest.approx(small.auto_exposure.full_well_fraction)
    warm = changed(small, "sensor", dark_current_electrons_per_s=1e9)
    budget = chain.link_budget(warm, "eclipse")
    assert budget.at(chain.solve_exposure(warm, budget, "auto"))["full_well_fraction"] == pytest.approx(0.5)
    assert chain.solve_exposure(small, budget, 0.01) == 0.01


def test_automatic_exposure_stays_between_the_shortest_pulse_and_the_longest_exposure(small: Scenario) -> None:
    slow = changed(small, "auto_exposure", shortest_s=1e-3)
    assert chain.solve_exposure(slow, chain.link_budget(slow, "eclipse"), "auto") == 1e-3
    dark = changed(small, "leds", centroid_nm=1100)  # off the filter's band
    assert chain.link_budget(dark, "eclipse").signal_rate == 0
    assert chain.solve_exposure(dark, chain.link_budget(dark, "eclipse"), "auto") == dark.auto_exposure.longest_s
    too_near = small.at(range_m=0.05)
    with pytest.raises(ValueError, match=r"'auto' needs a bit in the frame, and none is at 0\.05 m"):
        chain.solve_exposure(too_near, chain.link_budget(too_near, "eclipse"), "auto")


def test_the_usable_well_ends_with_the_converter_where_that_is_smaller(small: Scenario) -> None:
    assert chain.usable_well_electrons(small.sensor) == min(20_000, (4095 - 64) * 5)
    assert chain.usable_well_electrons(changed(small, "sensor", bits=10).sensor) == (1023 - 64) * 5


def test_transport_does_not_change_with_what_is_applied_after_it(small: Scenario) -> None:
    """The geometry digest lets one basis serve every power, spectrum, F-number, sensor, exposure and seed; nothing else."""
    digest = chain.geometry_digest(small)
    same: list[tuple[str, dict[str, Any]]] = [
        ("leds", {"intensity_w_sr": 1.0, "fwhm_nm": 2.0, "centroid_nm": 860.0}),
        ("sensor", {"bits": 10}),
        ("camera", {"f_number": 4.0, "lens_transmission": 0.5}),
        ("filter", {"transmission": 0.5}),
    ]
    other: list[tuple[str, dict[str, Any]]] = [
        ("leds", {"ring_radius_m": 0.06}),
        ("leds", {"half_angle_deg": 20.0}),
        ("camera", {"focal_length_m": 0.03}),
        ("camera", {"psf_sigma_px": 1.0}),
        ("sun", {"phase_deg": 30.0}),
        ("target", {"yaw_deg": 5.0}),
        ("marker", {"identity": 3}),
        ("filter", {"low_nm": 820.0}),
    ]
    for section, values in same:
        assert chain.geometry_digest(changed(small, section, **values)) == digest, (section, values)
    for section, values in other:
        assert chain.geometry_digest(changed(small, section, **values)) != digest, (section, values)
    assert chain.geometry_digest(small.at(seed=2, exposure_s=1e-3, illumination="sunlit")) == digest
    assert chain.geometry_digest(small.at(range_m=3.001)) != digest


def test_rates_add_up_and_scale_with_their_sources(small: Scenario, small_basis: TransportBasis) -> None:
    eclipse, sun = (chain.electron_rate(small, small_basis, illumination) for illumination in ("eclipse", "sunlit"))
    assert (eclipse >= 0).all()
    assert (sun >= eclipse).all()
    twice = changed(small, "leds", count=100, intensity_w_sr=7.0)
    np.testing.assert_allclose(chain.electron_rate(twice, small_basis, "eclipse"), 2 * eclipse, rtol=1e-12)
    far = changed(small, "sun", distance_au=2.0)
    in_far_sun = chain.electron_rate(far, small_basis, "sunlit")
    np.testing.assert_allclose(in_far_sun - eclipse, (sun - eclipse) / 4, rtol=1e-9, atol=1e-6)


def test_a_basis_of_another_size_is_refused(small: Scenario, small_basis: TransportBasis) -> None:
    wide = changed(small, "camera", width_px=200)
    with pytest.raises(ValueError, match="160 × 160 px, the camera 200 × 160 px"):
        chain.electron_rate(wide, small_basis, "eclipse")


def test_frames_repeat_and_are_independent_between_cases(small: Scenario) -> None:
    """Same scenario, same seed, same bytes; another trial, exposure, light, range or seed, other noise."""
    rate = np.full((64, 64), 1e6)
    first = chain.expose(small, rate, "eclipse", 1e-3)
    np.testing.assert_array_equal(first.dn, chain.expose(small, rate, "eclipse", 1e-3).dn)
    others = [
        chain.expose(small, rate, "eclipse", 1e-3, trial=1),
        chain.expose(small, rate, "sunlit", 1e-3),
        chain.expose(small, rate * 1e-3 / 1.001e-3, "eclipse", 1.001e-3),
        chain.expose(small.at(range_m=3.1), rate, "eclipse", 1e-3),
        chain.expose(small.at(seed=2), rate, "eclipse", 1e-3),
    ]
    noise = np.array([frame.dn.ravel() - frame.dn.mean() for frame in (first, *others)])
    correlation = np.corrcoef(noise)[np.triu_indices(len(noise), 1)]
    # 99.9 % of independent frames' 15 correlations all lie within 4.1 standard errors of zero.
    assert np.abs(correlation).max() < 4.1 / np.sqrt(noise.shape[1])


@pytest.mark.parametrize(
    ("image", "known"),
    [
        (np.full((4, 4), 4095, np.uint16), True),
        (np.full((4, 4), 4096, np.uint16), False),
        (np.zeros((4, 4), np.uint8), False),
        (np.zeros((4, 4), np.float32), False),
    ],
)
def test_noise_is_known_only_of_images_that_the_sensor_can_have_made(
    small: Scenario, image: np.ndarray, known: bool
) -> None:
    assert (noise_of(small.sensor, image) is not None) == known


@pytest.mark.parametrize("shape", [(160,), (160, 161), (161, 160), (160, 160, 3)])
def test_an_image_of_another_shape_is_refused(small: Scenario, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="the camera 160×160 px"):
        chain.detect(chain.Belief.of(small), np.zeros(shape, np.uint16))


def test_pose_errors_compare_with_the_scenarios_truth(small: Scenario, small_basis: TransportBasis) -> None:
    frame = chain.expose(small, chain.electron_rate(small, small_basis, "eclipse"), "eclipse", 5e-7)
    pose = chain.detect(chain.Belief.of(small), frame.dn).pose
    angle, relative = chain.pose_errors(small, pose)
    assert np.degrees(angle) < 2
    assert relative < 0.01
    assert chain.pose_errors(small.at(range_m=6), pose)[1] == pytest.approx(0.5, abs=0.01)
    assert np.isnan(chain.pose_errors(small, None)).all()


@pytest.mark.parametrize("tilt", [(0, 0, 0), (20, -25, 0), (-40, 30, 170), (60, 10, -90)])
def test_every_view_shows_the_face_to_the_camera(small: Scenario, tilt: tuple[float, float, float]) -> None:
    view = chain.view(changed(small, "target", **dict(zip(("pitch_deg", "yaw_deg", "roll_deg"), tilt, strict=True))))
    np.testing.assert_allclose(view.rotation, attitude_matrix(*np.radians(tilt)))
    assert faces_camera(view.rotation, view.translation_m)


@pytest.mark.parametrize("range_m", [1.0, 5.0, 20.0])
def test_bit_pixels_lie_on_their_bits(range_m: float) -> None:
    """The middle half of each bit, one pixel at least, and where a bit has four pixels or more, none of a neighbour's."""
    scenario = load_scenario(overrides=("target.pitch_deg=20", "target.yaw_deg=-25")).at(range_m=range_m)
    view, marker = chain.view(scenario), scenario.marker
    centres = marker.white_bit_centres_m()
    pixels = chain.bit_pixels(view, centres)
    assert len(pixels) == len(centres)
    for centre, (rows, columns) in zip(centres, pixels, strict=True):
        assert len(rows) >= 1
        off = np.abs(view.to_plane(np.column_stack([columns, rows])) - centre[:2])
        if marker.bit_m * min(chain.bit_scale_px(view)) >= 4:
            assert (off <= marker.bit_m / 4 + 1e-9).all()
    np.testing.assert_allclose(view.to_plane(view.to_image(centres)), centres[:, :2], atol=1e-12)


def test_a_bit_that_is_larger_than_the_frame_counts_with_some_of_its_pixels() -> None:
    scenario = load_scenario(overrides=("camera.focal_length_m=0.5",)).at(range_m=0.5)
    view = chain.view(scenario)
    pixels = chain.bit_pixels(view, scenario.marker.white_bit_centres_m())
    assert 0 < sum(len(rows) for rows, _ in pixels) < 40**2 * len(pixels)
    assert all(np.all((r >= 0) & (r < 580) & (c >= 0) & (c < 752)) for r, c in pixels)
    assert np.isfinite(chain.link_budget(scenario, "eclipse").signal_rate)


def test_the_fixed_pattern_of_a_scenario_is_in_every_frame_and_the_same_in_each(small: Scenario) -> None:
    """PRNU, DSNU, hot and dead pixels change the frames; what differs from frame to frame is the noise alone."""
    rate = np.full((64, 64), 1e6)
    flat = changed(small, "sensor", prnu=0.0).at(camera={**small.camera.model_dump(), "width_px": 64, "height_px": 64})
    uneven = changed(flat, "sensor", prnu=0.05, dsnu_electrons=40.0, hot_fraction=0.01, dead_fraction=0.01)
    pattern = camera_pattern(uneven)
    assert camera_pattern(flat) is None
    assert pattern is not None
    mean = np.mean([chain.expose(uneven, rate, "eclipse", 5e-3, trial).dn for trial in range(64)], axis=0)
    plain = np.mean([chain.expose(flat, rate, "eclipse", 5e-3, trial).dn for trial in range(64)], axis=0)
    gain = uneven.sensor.gain_electrons_per_dn
    expected = (5000 * pattern.prnu + pattern.dsnu_electrons) / gain
    hot, dead = pattern.dsnu_electrons > 10_000, pattern.prnu == -1
    assert hot.sum() == pytest.approx(41, abs=20)
    assert dead.sum() == pytest.approx(41, abs=20)
    good = ~hot & ~dead
    noise = np.sqrt(2 * (5000 + uneven.sensor.total_noise_electrons**2) / 64) / gain
    assert np.abs((mean - plain - expected)[good]).max() < 5 * noise
    assert (mean[hot] > plain.max()).all()
    assert (mean[dead & ~hot] < 0.2 * plain.mean()).all()


def test_the_closed_form_counts_the_non_uniformity_as_the_pixels_show_it(small: Scenario) -> None:
    """SNR of bits on an uneven sensor: temporal noise and the pattern's own variance at their pixels against S/√(S+D+σ²+…)."""
    uneven = changed(small, "sensor", prnu=0.03, dsnu_electrons=30.0).at(
        budget={**small.budget.model_dump(), "trials": 64}
    )
    case = chain.Case(uneven, "eclipse")
    rate = chain.electron_rate(uneven, chain.transport(uneven), "eclipse")
    [drawn] = trials.draw(case, rate, [case.exposure_s("auto")])
    known = case.link_budget.at(case.exposure_s("auto"))
    even = chain.link_budget(small, "eclipse").at(case.exposure_s("auto"))
    assert known["snr"] < 0.9 * even["snr"]
    pixels = len(case.bright.index[0])
    # The variance of a pattern over n pixels is known to √(2/n) of itself.
    assert drawn.values["snr_rendered"] == pytest.approx(known["snr"], rel=3 * np.sqrt(2 / pixels) / 2 + 0.02)
