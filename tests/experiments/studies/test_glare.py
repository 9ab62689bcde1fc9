"""Counter-measures against glare: the difference of two frames, the shadow, the truth they are held to, and a small run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from rich.table import Table as RichTable
from scipy import stats

from detector.features import find_features
from detector.sensor.noise import sensor_noise
from detector.sensor.pair import difference, shifted
from detector.sensor.sensor import Sensor, expose
from experiments import chain
from experiments.chain.statistics import wilson_interval
from experiments.scenario import Scenario
from experiments.studies.glare import conditions, dimmed, study
from experiments.studies.glare import page as glare_page
from experiments.studies.glare.bracket import fuse
from experiments.studies.glare.frames import VARIABLES, draw
from experiments.studies.glare.gallery import worst_frames
from experiments.studies.glare.geometry import Geometry, MovedView, at_sun, cropped, render
from experiments.studies.glare.modes import (
    MODES,
    Mode,
    bracket_exposures_s,
    chaser_shadow,
    expose_mode,
    pulse_s,
    through,
)
from experiments.studies.glare.plan import Attitude, Plan
from experiments.studies.glare.tables import HEADINGS, TERMINAL, mode_rows, summarise, verdicts
from experiments.studies.shared.truth import Truth

ATTITUDE = Attitude(-4, 7, 10, 1)


@pytest.fixture(scope="module")
def geometry() -> Geometry:
    """A marker at 5 m with the Sun 20° off, every mode's rates."""
    return render(cropped(at_sun(Scenario(), 5.0, 20.0, 60.0, ATTITUDE)), tuple(MODES), 1 / 30, 100_000)


def test_shift_undoes_a_motion_of_a_band_limited_image() -> None:
    row, column = np.mgrid[:40, :50]

    def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 5 + np.sin(x / 4) * np.cos(y / 5)

    motion = np.array([2.3, -1.6])
    back = shifted(wave(column - motion[0], row - motion[1]), motion)
    inner = (slice(6, -6), slice(6, -6))
    assert np.abs(back - wave(column, row))[inner].max() < 2e-3


def test_squared_shift_gives_the_variance_of_a_shifted_noise_image() -> None:
    noise = np.random.default_rng(1).standard_normal((300, 300)).astype(np.float32)
    motion = np.array([0.4, 1.7])
    expected = float(shifted(np.ones((20, 20)), motion, power=2)[10, 10])
    ratio = shifted(noise, motion).var() / expected
    # Neighbours of a resampled image are correlated: a tenth of its pixels counts as independent.
    low, high = stats.chi2.interval(0.9999, 9000)
    assert low / 9000 < ratio < high / 9000


def electrons_of(
    sensor: Sensor, on: np.ndarray, off: np.ndarray, mean_e: float, scale: float = 1.0
) -> tuple[np.ndarray, float]:
    """A difference of two frames of a sensor in electrons, and its mean variance where so many are expected."""
    image, noise = difference(on, off, sensor_noise(sensor), scale=scale)
    gain = sensor.gain_electrons_per_dn
    return image * gain, gain**2 * float(noise.variance(np.full(image.shape, mean_e / gain)).mean())


def test_variance_of_a_difference_is_that_of_both_frames() -> None:
    sensor, rng = Sensor(), np.random.default_rng(2)
    led, sun, seconds = np.full((120, 120), 2000.0), np.full((120, 120), 3000.0), 1.0
    on, off = expose(sensor, led + sun, seconds, rng).dn, expose(sensor, sun, seconds, rng).dn
    image, predicted = electrons_of(sensor, on, off, 2000.0)
    low, high = stats.chi2.interval(0.9999, image.size - 1)
    assert low < (image.size - 1) * image.var() / predicted < high
    assert predicted == pytest.approx(2000 + 2 * 3000 + 2 * sensor.total_noise_electrons**2, rel=0.01)
    assert abs(image.mean() - 2000) < 4 * np.sqrt(predicted / image.size)


def test_scaled_difference_removes_the_light_of_the_second_band_and_knows_its_noise() -> None:
    sensor, rng, scale = Sensor(), np.random.default_rng(5), 0.7
    led, sun = np.full((120, 120), 2000.0), np.full((120, 120), 2100.0)
    on, off = expose(sensor, led + sun, 1.0, rng).dn, expose(sensor, sun / scale, 1.0, rng).dn
    image, predicted = electrons_of(sensor, on, off, 2000.0, scale)
    low, high = stats.chi2.interval(0.9999, image.size - 1)
    assert low < (image.size - 1) * image.var() / predicted < high
    assert abs(image.mean() - 2000) < 4 * np.sqrt(predicted / image.size)


def test_bracket_reads_each_pixel_from_the_longest_exposure_that_is_not_clipped() -> None:
    scenario, mode = Scenario(), MODES["bracket"]
    sensor, steps = scenario.sensor, bracket_exposures_s(scenario, mode, 4e-6)
    assert steps == pytest.approx([4e-6, 1e-6, 2.5e-7])
    # The second of these fills the well in the first exposure, the third in the first two, the last in all.
    charges = np.repeat([8e3, 6e4, 2.4e5, 1e6], 400).reshape(40, 40)
    rng = np.random.default_rng(6)
    image, noise = fuse(sensor, [expose(sensor, charges / 4e-6, s, rng).dn for s in steps], steps)
    assert noise.extra_variance_dn2 is not None
    assert np.isinf(noise.extra_variance_dn2[30:]).all()
    predicted = noise.variance(charges)
    for rows in (slice(0, 10), slice(10, 20), slice(20, 30)):
        part, expected = image[rows], predicted[rows].mean()
        low, high = stats.chi2.interval(0.9999, part.size - 1)
        assert low < (part.size - 1) * part.var() / expected < high
        assert abs(part.mean() - charges[rows].mean()) < 4 * np.sqrt(expected / part.size)


def test_exposures_of_a_bracket_below_the_cameras_shortest_are_not_taken() -> None:
    scenario = Scenario()
    shortest = scenario.auto_exposure.shortest_s
    assert bracket_exposures_s(scenario, MODES["bracket"], 2 * shortest) == [2 * shortest, shortest]


def test_second_band_holds_the_same_sunlight_of_a_grey_surface(geometry: Geometry) -> None:
    lit = geometry.mode_rates(MODES["two_bands"])
    truth = Truth.of(geometry.scenario)
    assert lit.off is not None
    # Tape and foil are nearly grey from 785 to 850 nm, and the LEDs do not reach that far.
    bright, _ = truth.bits(lit.sun)
    assert truth.bits(lit.off)[0] * lit.off_scale == pytest.approx(bright, rel=0.05)


def test_clipped_pixels_of_either_frame_say_nothing() -> None:
    sensor = Sensor()
    on, off = np.full((20, 20), 500, np.uint16), np.full((20, 20), 100, np.uint16)
    on[3, 4], off[10, 10] = sensor.saturation_dn, sensor.saturation_dn
    _, noise = difference(on, off, sensor_noise(sensor))
    assert noise.extra_variance_dn2 is not None
    blind = {(int(r), int(c)) for r, c in zip(*np.nonzero(np.isinf(noise.extra_variance_dn2)), strict=True)}
    assert blind == {(3, 4), (10, 10)}
    pixels = np.array([[4.0, 3.0], [5.0, 3.0]])
    assert noise.readable(pixels).tolist() == [[5.0, 3.0]]


def test_extra_variance_widens_the_covariance_of_corners(geometry: Geometry) -> None:
    scenario, mode = geometry.scenario, MODES["single"]
    truth, lit = Truth.of(scenario), geometry.mode_rates(mode)
    seconds = pulse_s(scenario, mode, truth.bits(lit.led)[0], truth.bits(lit.sun)[0])
    shown = expose_mode(scenario, mode, lit, seconds, geometry.motion_px, np.random.default_rng(1))
    noise = shown.noise
    noisier = replace(noise, extra_variance_dn2=np.full(shown.pixels.shape, 50 * noise.read_noise_dn**2))
    plain, wide = (find_features(shown.pixels, scenario.marker, scenario.camera, n) for n in (noise, noisier))
    assert plain.corners_covariance_px2 is not None
    assert wide.corners_covariance_px2 is not None
    assert np.trace(wide.corners_covariance_px2[0]) > np.trace(plain.corners_covariance_px2[0])


def test_one_basis_over_the_widest_band_serves_the_scenarios_filter() -> None:
    scenario = cropped(at_sun(Scenario(), 5.0, 20.0, 60.0, ATTITUDE))
    wide = render(scenario, ("single",), 1 / 30, 100_000).rates[None]
    own = chain.transport(scenario.at(render={"frame_samples": 4, "marker_rays": 10_000}))
    truth = Truth.of(scenario)
    led = truth.bits(chain.electron_rate(scenario, own, "eclipse"))[0]
    assert truth.bits(wide.led)[0] == pytest.approx(led, rel=0.02)


def test_target_moves_by_rate_lever_and_interval() -> None:
    view = chain.view(Scenario(range_m=4.0))
    turn = np.radians(5.0) / 30
    moved = MovedView(**{n: getattr(view, n) for n in view.__dataclass_fields__}, turn_rad=turn, lever_m=0.57)
    assert np.linalg.norm(moved.translation_m - view.translation_m) == pytest.approx(0.57 * turn, rel=1e-3)
    assert np.arccos((np.trace(moved.rotation.T @ view.rotation) - 1) / 2) == pytest.approx(turn, rel=1e-6)


def test_chaser_shadows_the_marker_up_to_the_angle_of_its_radius() -> None:
    limit = np.degrees(np.arctan(0.5 / 5.0))

    def free(phase_deg: float, radius_m: float = 0.5) -> np.ndarray:
        return chaser_shadow(chain.view(cropped(at_sun(Scenario(), 5.0, phase_deg, 60.0, ATTITUDE))), radius_m)

    assert free(limit - 1.5).max() == 0
    assert free(limit + 1.5).min() == 1
    assert free(limit).mean() == pytest.approx(0.5, abs=0.1)
    assert free(0.0, radius_m=0.0).min() == 1
    assert free(120.0).min() == 1


def test_pulse_counts_sunlight_only_where_the_shutter_closes_with_it() -> None:
    scenario = Scenario()
    assert pulse_s(scenario, Mode(""), 1e9, 1e9) == pytest.approx(pulse_s(scenario, Mode(""), 2e9, 0.0))
    assert pulse_s(scenario, Mode("", shutter_s=1e-3), 1e9, 1e9) == pytest.approx(pulse_s(scenario, Mode(""), 1e9, 0.0))
    assert pulse_s(scenario, Mode("", shutter_s=1e-6), 1.0, 0.0) == 1e-6


def test_filters_of_the_modes_are_presets() -> None:
    assert through(Scenario(), MODES["narrow"].filter).filter.high_nm == 862.5
    assert through(Scenario(), MODES["single"].filter).filter == Scenario().filter


def test_registration_removes_what_motion_leaves(geometry: Geometry) -> None:
    lit, sensor = geometry.mode_rates(MODES["pair"]), geometry.scenario.sensor
    scale = 0.5 * sensor.full_well_electrons / lit.sun.max()  # sunlight alone, well exposed
    left = []
    for name in ("pair", "pair_raw"):
        dark = type(lit)(0 * lit.led, lit.sun, lit.moved_sun)
        shown = expose_mode(geometry.scenario, MODES[name], dark, scale, geometry.motion_px, np.random.default_rng(3))
        left.append(float(np.std(shown.pixels[8:-8, 8:-8])))
    assert left[0] < 0.7 * left[1]


def test_a_pair_finds_marker_and_pose(geometry: Geometry) -> None:
    values, blobs = draw(geometry, ("pair", "single"), 2, (1,))
    named = dict(zip(VARIABLES, values, strict=True))
    assert (named["detected"] == 1).all()
    assert (named["attitude_error_deg"] < 1).all()
    assert np.abs(blobs).max() < 0.3


@pytest.mark.parametrize(("successes", "trials"), [(96, 96), (0, 50), (30, 60)])
def test_wilson_interval_is_scipys(successes: int, trials: int) -> None:
    expected = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-6)


#: One range, two Suns, a mode that works and one whose sunlit bits saturate.
PLAN = Plan(
    ranges_m=(5.0,),
    phases_deg=(0.0, 45.0),
    azimuths_deg=(60.0,),
    attitudes=(ATTITUDE,),
    draws=2,
    modes=("pair", "long"),
    rays=60_000,
    whole_range_m=3.0,
    whole_azimuths_deg=(0.0,),
    dimmed_scales=(1.0, 1e-4),
    dimmed_draws=1,
    condition_phases_deg=(20.0,),
    condition_draws=1,
    condition_rays=30_000,
)


@pytest.fixture(scope="module")
def small_run() -> xr.Dataset:
    """The frames of `PLAN`."""
    return study.over_suns(Scenario(), PLAN, workers=0)


def test_run_is_reproducible_and_labelled(small_run: xr.Dataset) -> None:
    xr.testing.assert_identical(small_run.drop_attrs(), study.over_suns(Scenario(), PLAN, workers=0).drop_attrs())
    assert small_run.detected.dims == study.DIMS
    assert small_run.sizes["frame"] == 2


def test_verdict_names_the_limit_that_stands_in_the_way(small_run: xr.Dataset) -> None:
    summary = summarise(small_run, Scenario())
    assert verdicts(summary, "pair")[0]
    met, failures = verdicts(summary, "long")
    assert any("fills the well" in failure and "phase 0°" in failure for failure in failures)
    assert len(mode_rows(summary)) == 4
    assert isinstance(met, bool)


def test_report_is_written_with_its_figures(small_run: xr.Dataset, small: Scenario, tmp_path: Path) -> None:
    scenario = Scenario()
    result = study.GlareResult(
        scenario=scenario,
        plan=PLAN,
        dataset=small_run,
        summary=summarise(small_run, scenario),
        whole=study.false_positives(small, PLAN, ("pair",)),
        dimmed=dimmed.run(scenario, PLAN),
        conditions=conditions.run(scenario, PLAN),
        worst=worst_frames(small_run, scenario, PLAN),
    )
    page = glare_page.page(result, "mantis glare")
    page.write(tmp_path)
    written = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    data = {f"data/glare{part}.csv" for part in ("", "-failures", "-modes", "-conditions")}
    assert written == {"glare.nc", "glare.md", "report.html"} | data | {
        f"figures/glare-{key}.svg" for key in ("detection", "pose", "phase", "dimmed", "gallery")
    }
    assert "src=" not in (tmp_path / "report.html").read_text()
    assert page.passed
    assert page.unmet == {}
    [shown] = [block for block in page.terminal() if isinstance(block, RichTable)]
    assert len(shown.columns) == len(TERMINAL) < len(HEADINGS)
    assert int(result.whole.found.sum()) == 0
    table = conditions.rows(result.conditions, scenario)
    assert len(table) == len(conditions.CONDITIONS) * len(conditions.MODES)
    assert all(row[3] == "100" and row[-1] == "none" for row in table)  # at 20° nothing of this disturbs a pose
    lost = result.worst[PLAN.modes.index("long")]
    assert lost.failed
    assert "not found" in lost.lines[0]


def test_modes_have_titles_and_a_target() -> None:
    assert glare_page.TARGET_MODE in MODES
    assert set(study.WHOLE_MODES) <= set(MODES)
    assert all(mode.title for mode in MODES.values())
