"""Calibration of elements on exact features with drawn errors: recovery, honest covariances, and what cannot be told."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from detector.calibration.elements import ElementCalibration, KnownPose, calibrate_elements
from detector.features import Features
from radiometry.geometry import attitude_matrix
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign

CAMERA, DESIGN = Camera(), MarkerDesign()
OFFSETS = (2e-4, 1e-3, -3e-4, 0.0)
BUILT = MarkerDesign(element_offsets_m=OFFSETS, virtual_depth_fraction=0.51)
TILTS = [(p, y) for p in (-25, 0, 25) for y in (-25, 0, 25)]
CORNER_PX, BLOB_PX = 0.01, 0.02


def observed(
    rng: np.random.Generator, tilts: list[tuple[float, float]], range_m: float = 2.0
) -> tuple[list[Features], list[KnownPose]]:
    """What a camera sees of the marker as built, with errors drawn."""
    seen, poses = [], []
    for pitch, yaw in tilts:
        rotation = attitude_matrix(*np.radians([pitch, yaw, rng.uniform(-20, 20)]))
        translation = np.array([*rng.uniform(-0.05, 0.05, 2), range_m])
        corners = CAMERA.project(BUILT.corners_m @ rotation.T + translation) + rng.normal(0, CORNER_PX, (4, 2))
        blobs, sigma = {}, {}
        for element in BUILT.elements:
            u = float(element.blob_offset_m(-rotation.T @ translation))
            ends = CAMERA.project(
                (element.centre_m + np.array([[u], [u + 1e-6]]) * element.along) @ rotation.T + translation
            )
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            visible = abs(u - element.shift_m) < 0.42 * element.length_m
            blobs[element.name] = ends[0] + rng.normal(0, BLOB_PX) * along if visible else None
            if visible:
                sigma[element.name] = BLOB_PX
        features = Features(
            identity=0,
            corners_px=corners,
            corners_covariance_px2=np.tile(CORNER_PX**2 * np.eye(2), (4, 1, 1)),
            blobs_px=blobs,
            blob_sigma_px=sigma,
            virtual_points_px={},
            reason=None,
            joint_covariance_px2=CORNER_PX**2 * np.eye(8),
        )
        seen.append(features)
        poses.append((rotation, translation))
    return seen, poses


def normalised(found: ElementCalibration) -> float:
    error = np.append(found.offsets_m - OFFSETS, found.virtual_depth_m - BUILT.elements[0].virtual_depth_m)
    return float(error @ np.linalg.solve(found.covariance, error))


@pytest.mark.parametrize("known", [False, True])
def test_offsets_and_depth_are_recovered_with_honest_covariances(known: bool) -> None:
    rng, statistic, freedom, chi_square = np.random.default_rng(3), 0.0, 0, []
    for _ in range(25):
        seen, poses = observed(rng, TILTS)
        found = calibrate_elements(seen, DESIGN, CAMERA, poses if known else None)
        assert np.abs(found.offsets_m - OFFSETS).max() < 5e-5
        statistic, freedom = statistic + normalised(found), freedom + 5
        chi_square.append(found.reduced_chi2)
    # The covariance is widened by a residual above one, which is one on average: at most a few percent.
    low, high = chi2.ppf([5e-4, 0.9995], freedom)
    assert low * 0.85 < statistic < high
    assert np.mean(chi_square) == pytest.approx(1.0, abs=0.1)


def test_the_calibrated_marker_is_the_one_that_was_built() -> None:
    seen, _ = observed(np.random.default_rng(4), TILTS)
    found = calibrate_elements(seen, DESIGN, CAMERA)
    built = found.marker(DESIGN)
    np.testing.assert_allclose(built.element_offsets_m, OFFSETS, atol=5e-5)
    assert built.virtual_depth_fraction == pytest.approx(0.51, abs=2e-3)
    again = calibrate_elements(seen, built, CAMERA)
    np.testing.assert_allclose(again.offsets_m, found.offsets_m, atol=1e-8)


def test_unknown_poses_leave_a_common_shift_of_opposite_elements_to_perspective() -> None:
    seen, poses = observed(np.random.default_rng(5), TILTS)
    common = np.array([1, 0, 1, 0, 0]) / np.sqrt(2)
    opposed = np.array([1, 0, -1, 0, 0]) / np.sqrt(2)
    free, given = calibrate_elements(seen, DESIGN, CAMERA), calibrate_elements(seen, DESIGN, CAMERA, poses)
    assert common @ free.covariance @ common > 2 * (common @ given.covariance @ common)
    assert common @ free.covariance @ common > opposed @ free.covariance @ opposed
    assert opposed @ free.covariance @ opposed == pytest.approx(opposed @ given.covariance @ opposed, rel=0.5)


def test_images_without_the_marker_are_passed_over() -> None:
    seen, _ = observed(np.random.default_rng(6), TILTS)
    nothing = Features(
        identity=None,
        corners_px=None,
        corners_covariance_px2=None,
        blobs_px=dict.fromkeys(ELEMENT_NAMES),
        blob_sigma_px={},
        virtual_points_px={},
        reason="no marker found",
    )
    found = calibrate_elements([nothing, *seen], DESIGN, CAMERA)
    assert found.used == tuple(range(1, len(seen) + 1))
    assert found.rotations.shape == (len(seen), 3, 3)


def test_what_the_images_do_not_tell_is_refused() -> None:
    seen, poses = observed(np.random.default_rng(7), TILTS)
    with pytest.raises(ValueError, match="poses: 2, expected one for each of 9 observations"):
        calibrate_elements(seen, DESIGN, CAMERA, poses[:2])
    with pytest.raises(ValueError, match="no blob of top, right, bottom, left in 0 images"):
        calibrate_elements([], DESIGN, CAMERA)
    blind = [Features(**{**vars(s), "blobs_px": {**s.blobs_px, "left": None}}) for s in seen]
    with pytest.raises(ValueError, match="no blob of left"):
        calibrate_elements(blind, DESIGN, CAMERA)
    one, _ = observed(np.random.default_rng(8), [(0, 0)])
    with pytest.raises(ValueError, match="expected"):
        calibrate_elements(one, DESIGN, CAMERA)
