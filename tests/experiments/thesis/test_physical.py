"""The emulated laboratory: arm, calibrated camera, scaling, and a run of a few stations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from detector.calibration.camera import CameraCalibration
from detector.sensor.noise import NoiseModel
from experiments import chain
from experiments.thesis.claims import Claim
from experiments.thesis.physical import arm, camera, page, study
from experiments.thesis.physical.claims import claims
from experiments.thesis.physical.methods import METHODS
from experiments.thesis.physical.plan import FULL, Plan
from experiments.thesis.physical.station import CameraModel, StationRates, judge_station
from radiometry.geometry import FRONTAL
from radiometry.laboratory import HalogenSpot, LedClusters
from radiometry.optics import Camera

Mantis = Callable[..., tuple[int, str, str]]


def test_scenario_has_what_the_thesis_prints() -> None:
    scenario = arm.load()
    real, marker = scenario.camera, scenario.marker
    assert (real.width_px, real.height_px) == (4096, 4096)
    assert 2 * np.degrees(np.arctan(real.width_px / 2 / real.focal_px[0])) == pytest.approx(42.01, abs=0.005)
    assert scenario.sensor.read_noise_electrons == 28.2
    assert marker.size_m == 0.2
    assert marker.element_length_m == pytest.approx(0.10, rel=0.01)
    assert marker.element_depth_m == pytest.approx(0.01, rel=0.01)
    assert scenario.leds.count * scenario.leds.electrical_power_w == pytest.approx(8.8 * 2.0)
    passes = arm.stations(FULL)
    assert 2 * len(passes) == 8


def test_camera_looks_at_the_marker_from_where_the_arm_holds_it() -> None:
    lab = arm.equipped(arm.load())
    assert isinstance(lab.leds, LedClusters)
    assert isinstance(lab.sun, HalogenSpot)
    for passing in arm.stations(FULL):
        for station in passing[::12]:
            view = chain.view(arm.at(lab, station))
            assert view.to_marker(np.zeros(3)) == pytest.approx(station.place_m)
            assert view.rotation == pytest.approx(station.rotation)
            # Rows level: the camera's x axis has no part along the marker's y.
            assert view.rotation[0, 1] == pytest.approx(0, abs=1e-12)
            assert view.sun_in_marker == pytest.approx(arm.lamp_direction())
    assert arm.nearest().rotation == pytest.approx(FRONTAL, abs=0.11)


def known(principal: tuple[float, float] = (2040.0, 2050.0)) -> CameraCalibration:
    """A calibration with numbers that are no camera's defaults."""
    lens = np.array([-0.05, 0.01, 1e-4, -1e-4, 0.0])
    return CameraCalibration(np.array([5300.0, 5310.0]), np.array(principal), lens, np.ones(9), 0.1, 8)


def test_solved_camera_and_its_crop_project_to_the_same_places() -> None:
    scenario = arm.load()
    crop = arm.equipped(scenario).camera
    whole = camera.solved(scenario.camera, known())
    assert whole.matrix[:2, 2] == pytest.approx([2040.0, 2050.0])
    part = camera.cropped(whole, crop)
    points = np.array([[0.05, -0.1, 3.0], [0.0, 0.0, 3.0], [-0.1, 0.1, 3.5]])
    off = (4096 - crop.width_px) / 2
    assert whole.project(points) - part.project(points) == pytest.approx(np.full((3, 2), off))
    assert whole.undistort_px(whole.project(points)) == pytest.approx(
        points[:, :2] / points[:, 2:] * [5300.0, 5310.0] + [2040.0, 2050.0], abs=1e-5
    )


def test_binned_calibration_is_that_of_the_whole_detector() -> None:
    # Pixel centre 0 of 8 × 8 binned pixels is at 3.5 of the whole.
    found = camera.whole(known((0.0, 10.0)), 8)
    assert found.principal_point_px == pytest.approx([3.5, 83.5])
    assert found.focal_px == pytest.approx([42400.0, 42480.0])
    assert found.sigma[:5] == pytest.approx([8, 8, 8, 8, 1])


def test_scaled_images_and_their_camera_agree() -> None:
    scale = camera.Scaling(0.2, 120, 90)
    real = Camera(width_px=300, height_px=250, pixel_pitch_x_m=5e-6, pixel_pitch_y_m=5e-6)
    small = scale.camera(real)
    column, row = np.meshgrid(np.arange(300.0), np.arange(250.0))
    ramp = scale.image(100 + 2 * column + row)
    points = np.array([[0.0, 0.0, 1.0], [0.02, -0.015, 1.0], [-0.02, 0.02, 1.0]])
    before, after = real.project(points), small.project(points)
    for (x, y), (u, v) in zip(before, after, strict=True):
        i, j = int(v), int(u)
        four = ramp[i : i + 2, j : j + 2]
        value = np.array([1 - v + i, v - i]) @ four @ np.array([1 - u + j, u - j])
        assert value == pytest.approx(100 + 2 * x + y, abs=1e-3)
    # The rim is repeated.
    assert (ramp[:, 0] == ramp[:, 10]).all()
    assert ramp.shape == (90, 120)
    noise = scale.noise(NoiseModel(0.2, 5.0, 64.0, 4095.0))
    assert noise.variance(1064.0) == pytest.approx(NoiseModel(0.2, 5.0, 64.0, 4095.0).variance(1064.0) * 0.2**2)
    with pytest.raises(ValueError, match="expected to fit 120 × 90"):
        scale.image(np.zeros((600, 300)))


@pytest.fixture(scope="module")
def outcome() -> study.PhysicalResult:
    """One pass of three stations, with few chessboards."""
    plan = Plan(passes=1, steps=3, binning=16, boards=4, sharpness_px=(0.7, 3.0))
    return study.run(arm.load(), plan, workers=1)


def test_calibration_from_rendered_boards_is_within_its_own_interval(outcome: study.PhysicalResult) -> None:
    found, real = outcome.camera.found, outcome.scenario.camera
    truth = np.array([*real.focal_px, *real.principal_point_px, real.k1])
    values = np.array([*found.focal_px, *found.principal_point_px, found.distortion[0]])
    # Five quantities at once, and the standard deviations are estimates from some hundred corners.
    assert (np.abs(values - truth) < 5 * found.sigma[:5]).all()
    assert found.views >= 3


def test_mantis_is_found_and_right_in_eclipse_and_frames_are_numbered_there_and_back(
    outcome: study.PhysicalResult,
) -> None:
    frames = outcome.frames
    own = frames.sel(illumination="eclipse", by="mantis")
    assert float(own.found.min()) == 1
    assert float(own.virtual.min()) == 1
    assert float(np.abs(own.attitude_error_deg).max()) < 1.0
    # Corners lie where the true camera images them, but for the calibration's error of the principal point.
    apart = np.abs(np.subtract(outcome.camera.found.principal_point_px, outcome.scenario.camera.principal_point_px))
    assert float(own.point_error_px.sel(scale="full").max()) < np.hypot(*apart) + 0.5
    assert float(own.point_error_px.sel(scale="scaled").max()) < 0.5
    assert frames.yaw_deg.sel(by="mantis", illumination="eclipse", scale="full").values[0, 0] == pytest.approx(
        frames.true_yaw_deg.values[0], abs=0.5
    )
    assert frames.frame_number.values.tolist() == [[[0, 1, 2], [5, 4, 3]]]
    assert set(frames.by.values) == set(METHODS)
    # The lamp shines too, so the run under it is exposed for a shorter time.
    exposure = frames.exposure_s
    assert float(exposure.sel(illumination="sunlit")) < float(exposure.sel(illumination="eclipse"))


def test_page_tells_printed_reproduced_and_right(outcome: study.PhysicalResult, tmp_path: Path) -> None:
    told = page.page(outcome, "mantis physical --quick")
    said: dict[str, Claim] = {f"{s.where}: {s.what}": s for s in claims(outcome)}
    assert said["eq. 7.2: side of the detector"].agrees
    assert said["eq. 7.3: field of view at 24 mm"].reproduced == pytest.approx(42.01, abs=0.005)
    told.write(tmp_path)
    for name in ("physical.nc", "physical.md", "report.html", "data/physical-failures.csv", "figures/physical-yaw.svg"):
        assert (tmp_path / name).stat().st_size > 0


def test_frame_is_the_same_whatever_is_run_beside_it(outcome: study.PhysicalResult) -> None:
    lab = arm.equipped(outcome.scenario)
    reference = chain.view(arm.at(lab, arm.nearest()))
    led, sun = next(study.rates(lab, [reference]))
    crop = camera.cropped(camera.solved(outcome.scenario.camera, outcome.camera.found), reference.camera)
    model = CameraModel(lab, crop, camera.scaling(outcome.scenario), study.exposures_s(lab, reference, led, sun))
    station = StationRates(reference, led, sun, (1, 0, 0), {})
    first, second = (judge_station(model, s)[0] for s in (station, replace(station, levels={1.0: 1e-3})))
    assert np.array_equal(first, second, equal_nan=True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--set", "leds.count=abc"), "leds.count"),
        (("--set", "marker.size_m=3"), "marker.size_m"),
        (("--set", "leds.count=10"), "leds.count: 10, expected a multiple of the 3 clusters"),
    ],
)
def test_bad_input_is_one_line_with_status_2(
    mantis: Mantis, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    status, _, error = mantis("physical", "--quick", *arguments, "--out", tmp_path / "out")
    assert status == 2
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
