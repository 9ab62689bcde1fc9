"""The chain with what a real lens, the Earth and the LEDs' limits add: rendered and closed form agree, poses are recovered."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from experiments import chain
from experiments.scenario import Scenario, ScenarioError, json_schema, load_scenario, validate
from scenes.render.transport import TransportBasis, View

#: Few pixels over a field of 29° by 23°, near enough for the marker to fill half of it.
NEAR: dict[str, Any] = {
    "range_m": 0.4,
    "camera": {"width_px": 240, "height_px": 200, "focal_length_m": 4e-3},
    "marker": {"size_m": 0.12},
    "leds": {"ring_radius_m": 0.03, "count": 12},
    "target": {"yaw_deg": 15.0, "pitch_deg": -10.0, "roll_deg": 20.0},
    "render": {"frame_samples": 1, "marker_rays": 400_000},
}
DISTORTION = {"k1": -0.4, "k2": 0.05, "p1": 1e-3, "p2": -2e-3}
STRAY = {"point_source_transmittance": [[20.0, 1e-4], [60.0, 1e-5], [150.0, 1e-7]]}


def near(**sections: Any) -> Scenario:
    return validate(
        {**NEAR, **{k: {**NEAR.get(k, {}), **v} if isinstance(v, dict) else v for k, v in sections.items()}}
    )


@cache
def plain_basis() -> TransportBasis:
    return chain.transport(near())


def bits(scenario: Scenario, rate: Any) -> tuple[float, float]:
    """Mean rates of bright bits and dark cells of a rendered frame."""
    view, marker = chain.view(scenario), scenario.marker
    return tuple(
        float(np.mean([rate[p].mean() for p in chain.bit_pixels(view, centres)]))
        for centres in (marker.white_bit_centres_m(), marker.black_bit_centres_m())
    )  # type: ignore[return-value]


# --- distortion


@cache
def distorted_basis() -> TransportBasis:
    return chain.transport(near(camera=DISTORTION))


def test_the_closed_form_follows_a_distorted_lens() -> None:
    scenario = near(camera=DISTORTION)
    signal, _ = bits(scenario, chain.electron_rate(scenario, distorted_basis(), "eclipse"))
    assert signal == pytest.approx(chain.link_budget(scenario, "eclipse").signal_rate, rel=0.01)


def test_the_pose_is_recovered_through_a_distorted_lens() -> None:
    """Four frames: corners where the lens images them, the pose as good as an ideal lens gives it here.

    At this sampling of 12 px a bit the detector's own bias prevails over noise, with and without distortion: 0.05 px at a corner,
    0.1° and 0.04 % in range. Twice that passes; the distortion itself moves corners by 0.22 to 0.28 px.
    """
    scenario = near(camera=DISTORTION)
    truth = chain.view(scenario)
    rate = chain.electron_rate(scenario, distorted_basis(), "eclipse")
    seconds = chain.solve_exposure(scenario, chain.link_budget(scenario, "eclipse"), "auto")
    corners = truth.to_image(scenario.marker.corners_m)
    assert np.linalg.norm(corners - _ideal_corners(truth), axis=1).min() > 0.2
    for trial in range(4):
        seen = chain.detect(chain.Belief.of(scenario), chain.expose(scenario, rate, "eclipse", seconds, trial).dn)
        assert seen.features.reason is None  # all four blobs
        np.testing.assert_allclose(seen.features.corners_px, corners, atol=0.1)
        assert seen.pose is not None
        attitude, distance = chain.pose_errors(scenario, seen.pose)
        assert np.degrees(attitude) < 0.2
        assert distance < 8e-4


def _ideal_corners(view: View) -> np.ndarray:
    return view.camera.without_distortion.project(view.marker.corners_m @ view.rotation.T + view.translation_m)


# --- blur


def test_defocus_blurs_rendered_and_closed_form_alike() -> None:
    """At 4 px a bit a disc of 6 px, on a marker that faces the camera.

    The closed form takes a Gaussian of the disc's variance for the disc that is drawn. Where the blur spans a bit and a half,
    that is worth 5 % of the signal and 12 % of the background.
    """
    far = {"range_m": 1.2, "target": {"yaw_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}}
    sharp = near(**far, camera={"f_number": 1.4})
    scenario = near(**far, camera={"f_number": 1.4, "focus_m": 0.19})
    assert 1.0 < chain.view(scenario).camera.psf_sigma_px < 2.0
    signal, background = bits(scenario, chain.electron_rate(scenario, chain.transport(scenario), "eclipse"))
    budget = chain.link_budget(scenario, "eclipse")
    assert budget.signal_rate < 0.9 * chain.link_budget(sharp, "eclipse").signal_rate
    assert signal == pytest.approx(budget.signal_rate, rel=0.05)
    assert background == pytest.approx(budget.background_rate, rel=0.12)


def test_focus_and_distortion_are_another_geometry_glare_and_vignetting_are_not() -> None:
    known = chain.geometry_digest(near())
    for same in ({"vignetting": 0.2}, {"veiling_glare": 0.1}, STRAY, {"f_number": 4.0}, {"lens_transmission": 0.9}):
        assert chain.geometry_digest(near(camera=same)) == known, same
    for other in ({"focus_m": 0.3}, {"k1": 0.01}, {"p1": 1e-4}, {"f_number": 22.0}):  # at F/22 diffraction rules
        assert chain.geometry_digest(near(camera=other)) != known, other
    assert chain.geometry_digest(near(earth={})) != known
    assert chain.geometry_digest(near(earth={})) == chain.geometry_digest(near(earth={"albedo": 0.5}))


def test_a_focus_that_blurs_everything_is_no_error_of_the_scenario() -> None:
    blurred = load_scenario(overrides=("camera.focus_m=20.0", "range_m=0.05"))
    assert chain.view(blurred).camera.psf_sigma_px > 80


def test_a_distortion_that_folds_back_is_refused_in_one_line() -> None:
    with pytest.raises(ScenarioError, match=r"^camera: k1 = -3: this distortion folds[^\n]*$"):
        load_scenario(overrides=("camera.k1=-3", "camera.focal_length_m=5e-3"))


# --- vignetting, glare and stray light act on the rendered basis


def test_vignetting_darkens_frame_and_budget_alike() -> None:
    plain, dark = near(), near(camera={"vignetting": 0.5})
    for basis_of in (plain, dark):
        signal, _ = bits(basis_of, chain.electron_rate(basis_of, plain_basis(), "eclipse"))
        assert signal == pytest.approx(chain.link_budget(basis_of, "eclipse").signal_rate, rel=0.01)
    rate = [chain.electron_rate(s, plain_basis(), "sunlit") for s in (plain, dark)]
    assert rate[1][0, 0] == pytest.approx(0.5 * rate[0][0, 0])


def test_veiling_glare_keeps_the_light_of_the_frame() -> None:
    plain, veiled = near(), near(camera={"veiling_glare": 0.05})
    before, after = (chain.electron_rate(s, plain_basis(), "sunlit") for s in (plain, veiled))
    assert after.sum() == pytest.approx(before.sum(), rel=1e-12)
    assert after.min() > before.min()
    clean = chain.link_budget(plain, "sunlit")
    told = chain.link_budget(veiled, "sunlit", mean_rate=float(before.mean()))
    for name in ("signal_rate", "background_rate"):
        value = 0.95 * getattr(clean, name) + 0.05 * before.mean()
        assert getattr(told, name) == pytest.approx(value, rel=1e-12)
    guessed = chain.link_budget(veiled, "sunlit")
    assert guessed.background_rate == pytest.approx(told.background_rate, rel=0.1), "crinkled foil behind the plane"
    assert clean.background_rate < 0.5 * told.background_rate


def test_a_sun_outside_the_field_lifts_every_pixel_of_frame_and_budget_alike() -> None:
    for phase_deg in (100.0, 140.0):
        plain, stray = near(sun={"phase_deg": phase_deg}), near(sun={"phase_deg": phase_deg}, camera=STRAY)
        lift = chain.electron_rate(stray, plain_basis(), "sunlit") - chain.electron_rate(plain, plain_basis(), "sunlit")
        added = chain.sun_stray_rate(stray)
        assert added > 0
        np.testing.assert_allclose(lift, added, rtol=1e-6)
        clean, budget = (chain.link_budget(s, "sunlit") for s in (plain, stray))
        assert budget.signal_rate - clean.signal_rate == pytest.approx(added, rel=1e-6)
        assert budget.background_rate - clean.background_rate == pytest.approx(added, rel=1e-6)
        eclipse = [chain.electron_rate(s, plain_basis(), "eclipse") for s in (plain, stray)]
        np.testing.assert_array_equal(*eclipse)
    angles = [chain.sun_stray_rate(near(sun={"phase_deg": phase}, camera=STRAY)) for phase in (20.0, 100.0, 140.0)]
    assert angles[0] == 0  # 160° off the axis, beyond the table
    assert angles[1] < angles[2]  # the nearer to the axis the more


# --- the Earth


@cache
def earth_basis() -> TransportBasis:
    return chain.transport(near(earth={}, sun={"phase_deg": 60.0, "azimuth_deg": 90.0}))


def test_the_earth_adds_its_light_in_sunlight_alone() -> None:
    with_it = near(earth={}, sun={"phase_deg": 60.0, "azimuth_deg": 90.0})
    without = near(sun={"phase_deg": 60.0, "azimuth_deg": 90.0})
    assert set(chain.source_spectra(with_it)) == {"led", "sun", "earth"}
    rates = {s: [chain.electron_rate(x, earth_basis(), s) for x in (without, with_it)] for s in ("eclipse", "sunlit")}
    np.testing.assert_array_equal(*rates["eclipse"])
    assert np.all(rates["sunlit"][1] >= rates["sunlit"][0])
    added = np.subtract(bits(with_it, rates["sunlit"][1]), bits(without, rates["sunlit"][0]))
    budgets = [chain.link_budget(s, "sunlit") for s in (without, with_it)]
    # The front plane sees all that is above its horizon: nothing shadows a bit.
    assert added[0] == pytest.approx(budgets[1].signal_rate - budgets[0].signal_rate, rel=0.01)
    assert added[1] == pytest.approx(budgets[1].background_rate - budgets[0].background_rate, rel=0.05)
    assert added[0] > 0.001 * budgets[0].signal_rate
    double = chain.electron_rate(
        near(earth={"albedo": 0.6}, sun={"phase_deg": 60.0, "azimuth_deg": 90.0}), earth_basis(), "sunlit"
    )
    np.testing.assert_allclose(
        double - rates["sunlit"][0], 2 * (rates["sunlit"][1] - rates["sunlit"][0]), rtol=1e-6, atol=1e-3
    )


def test_a_basis_without_the_earth_that_a_scenario_has_is_refused() -> None:
    with pytest.raises(ValueError, match="no earth layers; render it again"):
        chain.electron_rate(near(earth={}), plain_basis(), "sunlit")
    assert chain.electron_rate(near(earth={}), plain_basis(), "eclipse").sum() > 0


def test_an_earth_that_hides_the_sun_is_refused_and_a_slip_in_it_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"^earth: its disc of 70 deg hides the Sun, 20\.0 deg from its centre"):
        validate({"earth": {"phase_deg": 65.0, "azimuth_deg": 60.0}})
    with pytest.raises(ScenarioError, match=r"^earth\.albedoo: unknown key; did you mean 'earth\.albedo'"):
        validate({"earth": {"albedoo": 0.3}})
    assert load_scenario(overrides=("earth.albedo=0.4",)).earth is not None
    assert "Earth" in json_schema()["$defs"]


# --- pulses


def test_pulses_longer_than_leds_stand_are_refused_and_avoided() -> None:
    with pytest.raises(
        ScenarioError, match=r"exposures_s: 0\.0333333 s, expected at most leds\.longest_pulse_s, 0\.001 s"
    ):
        validate({"leds": {"longest_pulse_s": 1e-3}})
    with pytest.raises(ScenarioError, match=r"^exposure_s: 0\.002 s, expected at most leds\.longest_pulse_s"):
        validate({"exposure_s": 2e-3, "leds": {"longest_pulse_s": 1e-3}, "budget": {"exposures_s": ["auto"]}})
    dim = near(leds={"longest_pulse_s": 1e-6, "count": 1}, budget={"exposures_s": ["auto"]})
    assert chain.solve_exposure(dim, chain.link_budget(dim, "eclipse"), "auto") == 1e-6
