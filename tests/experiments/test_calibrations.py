"""Both calibrations on rendered frames with sensor noise, and `mantis calibrate` on a folder of images."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from detector.calibration.elements import KnownPose
from experiments.reporting.files import write_png
from experiments.scenario import Scenario, load_scenario, validate
from experiments.studies.shared import calibrations

#: The thesis's case: the right element one millimetre off.
OFFSETS_M = (0.0, 1e-3, 0.0, 0.0)
VIEWS_DEG = ((-25, -20), (-25, 20), (0, -25), (0, 25), (25, -20), (25, 20))
#: A wide lens on a small detector: the same perspective from fewer pixels.
SMALL_CAMERA = ("range_m=0.6", "camera.width_px=320", "camera.height_px=240", "camera.focal_length_m=0.008")
DISTORTION = ("camera.k1=-0.15", "camera.p1=0.001")


@pytest.fixture(scope="module")
def marker_views() -> tuple[list[NDArray[np.uint16]], list[KnownPose], Scenario]:
    """Frames of the marker with its element off, the true poses, and the scenario of the design."""
    scenario = load_scenario(None, ("range_m=3", "render.marker_rays=400_000"))
    return calibrations.rendered_views(scenario, OFFSETS_M, VIEWS_DEG)


@pytest.mark.parametrize("known", [False, True])
def test_an_element_off_by_a_millimetre_is_found_within_a_twentieth(
    marker_views: tuple[list[NDArray[np.uint16]], list[KnownPose], Scenario], known: bool
) -> None:
    images, poses, scenario = marker_views
    found = calibrations.elements_from_images(images, scenario, poses if known else None)
    assert np.abs(found.offsets_m - OFFSETS_M).max() < 5e-5
    assert found.virtual_depth_m == pytest.approx(scenario.marker.elements[0].virtual_depth_m, abs=2e-4)
    assert found.sigma_m.max() < 1e-4
    assert found.used == tuple(range(len(VIEWS_DEG)))


def test_offsets_are_as_good_as_they_are_said_to_be() -> None:
    """Normalised error over seeds, offsets of any slit phase, and ranges where slits are resolved and where they are not.

    At 1.5 m the camera resolves the slits: a blob is then fitted between where it is and where the slits were thought to be, by
    nearly as much again on the other side, and half a pitch (1 mm) off it looks like no blob at all.
    """
    total, freedom = 0.0, 0
    for seed, range_m in ((11, 1.5), (12, 1.5), (13, 2.5), (14, 4.0)):
        rng = np.random.default_rng(seed)
        offsets = np.round(rng.normal(0, 7e-4, 4), 6)
        keys = (f"range_m={range_m}", "render.marker_rays=400_000", f"seed={seed}")
        images, _, scenario = calibrations.rendered_views(load_scenario(None, keys), offsets.tolist(), VIEWS_DEG)
        found = calibrations.elements_from_images(images, scenario)
        assert np.abs(found.offsets_m - offsets).max() < 3e-5, (seed, range_m)
        depth = scenario.marker.elements[0].virtual_depth_m
        error = np.append(found.offsets_m - offsets, found.virtual_depth_m - depth)
        total += float(error @ np.linalg.solve(found.covariance, error))
        freedom += len(error)
    # Covariances are widened by a residual, never narrowed.
    low, high = chi2.ppf([0.001, 0.999], freedom)
    assert 0.2 * low < total < high


def test_calibrate_elements_reads_a_folder_and_writes_scenario_keys(
    marker_views: tuple[list[NDArray[np.uint16]], list[KnownPose], Scenario],
    tmp_path: Path,
    mantis: Callable[..., tuple[int, str, str]],
) -> None:
    images, _, scenario = marker_views
    folder = tmp_path / "images"
    folder.mkdir()
    for k, image in enumerate(images):
        write_png(image, folder / f"{k}.png")
    size = [f"camera.{key}={getattr(scenario.camera, key)}" for key in ("width_px", "height_px")]
    overrides = [part for key in size for part in ("--set", key)]
    status, out, error = mantis("calibrate", "elements", folder, "--json", "-o", tmp_path / "built.toml", *overrides)
    assert (status, error) == (0, "")
    record = json.loads(out)
    assert record["offsets_m"][1] == pytest.approx(1e-3, abs=5e-5)
    assert record["images"] == len(images)
    keys = tomllib.loads((tmp_path / "built.toml").read_text(encoding="utf-8"))
    built = validate(keys).marker
    np.testing.assert_allclose(built.element_offsets_m, record["offsets_m"], atol=1e-7)


def test_calibrate_says_what_is_missing(tmp_path: Path, mantis: Callable[..., tuple[int, str, str]]) -> None:
    status, _, error = mantis("calibrate", "camera", tmp_path)
    assert status == 2
    assert "no image in it" in error
    write_png(np.zeros((580, 752), np.uint16), tmp_path / "dark.png")
    status, _, error = mantis("calibrate", "camera", tmp_path)
    assert status == 2
    assert "0 of 1 show a chessboard of 11 × 8 inner corners; expected three or more" in error
    status, _, error = mantis("calibrate", "camera", tmp_path, "--squares", "12")
    assert status == 2
    assert "expected two whole numbers, say 12x9" in error
    status, _, error = mantis("calibrate", "elements", tmp_path)
    assert status == 2
    assert "no blob of top, right, bottom, left in 0 images" in error


@pytest.mark.parametrize(("distorted", "roll_deg"), [(False, 0.0), (True, 8.0)])
def test_a_chessboard_gives_the_camera_back(distorted: bool, roll_deg: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the board's edges run along the rows of pixels in the mean over the views."""
    monkeypatch.setattr(calibrations, "BOARD_ROLL_DEG", roll_deg)
    scenario = load_scenario(None, (*SMALL_CAMERA, *(DISTORTION if distorted else ())))
    board = calibrations.board_for(scenario)
    images = calibrations.rendered_boards(scenario, board, calibrations.BOARD_VIEWS[:6])
    found = calibrations.camera_from_images(images, board, scenario.camera.psf_sigma_px, distorted)
    camera = scenario.camera
    assert np.abs(found.focal_px / camera.focal_px - 1).max() < 1e-3
    truth = np.array([*camera.focal_px, *camera.principal_point_px, camera.k1, camera.k2, camera.p1, camera.p2])
    values = np.array([*found.focal_px, *found.principal_point_px, *found.distortion[:4]])
    solved = found.sigma[:8] > 0
    assert solved.sum() == (8 if distorted else 4)
    assert np.all(np.abs(values - truth)[solved] < 4.5 * found.sigma[:8][solved])
    if distorted:
        assert found.distortion[0] == pytest.approx(camera.k1, abs=0.02)
