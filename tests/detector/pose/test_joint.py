"""The pose of a face from all of its markers, on exact and noisy features."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from detector.features import Features
from detector.pose.joint import FoundMarker, moved_to_face, solve_face_pose
from detector.pose.pose import solve_pose
from radiometry.geometry import FloatArray, attitude_matrix, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

CAMERA = Camera()
PLACES = ((-0.4, 0.4), (0.4, 0.4), (0.4, -0.4), (-0.4, -0.4))
CORNER_PX, BLOB_PX = 0.05, 0.08


def seen(
    marker: MarkerDesign,
    centre_m: tuple[float, float],
    rotation: FloatArray,
    translation_m: FloatArray,
    rng: np.random.Generator | None,
    blobs: bool = True,
) -> FoundMarker:
    """Features of a marker on a face at a pose, with noise where there is a generator."""
    own = translation_m + rotation @ np.array([*centre_m, 0.0])
    noise = rng.normal if rng is not None else (lambda *_: 0.0)

    def image(points: FloatArray) -> FloatArray:
        return CAMERA.project(points @ rotation.T + own)

    corners = image(marker.corners_m)
    corners = corners + (noise(0, CORNER_PX, (4, 2)) if rng is not None else 0.0)
    camera_m = -rotation.T @ own
    found: dict[str, FloatArray | None] = {}
    for e in marker.elements:
        u = e.blob_offset_m(camera_m)
        ends = image(e.centre_m + np.array([[u], [u + 1e-4]]) * e.along)
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        found[e.name] = ends[0] + along * (float(noise(0, BLOB_PX)) if rng is not None else 0.0) if blobs else None
    covariance = np.tile(np.eye(2) * CORNER_PX**2, (4, 1, 1))
    sigma = {name: BLOB_PX for name, at in found.items() if at is not None}
    features = Features(
        identity=marker.identity,
        corners_px=corners,
        corners_covariance_px2=covariance,
        blobs_px=found,
        blob_sigma_px=sigma,
        virtual_points_px={},
        reason=None,
    )
    return FoundMarker(features, marker, centre_m)


def pose(pitch: float, yaw: float, roll: float, range_m: float) -> tuple[FloatArray, FloatArray]:
    return attitude_matrix(*np.radians([pitch, yaw, roll])), np.array([0.05, -0.02, range_m])


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (30.0, -20.0, 100.0), (-45.0, 45.0, -170.0)])
def test_exact_features_give_the_exact_pose(angles: tuple[float, float, float]) -> None:
    rotation, translation = pose(*angles, 5.0)
    found = [seen(MarkerDesign(), place, rotation, translation, None) for place in PLACES]
    solved = solve_face_pose(found, CAMERA)
    assert solved is not None
    assert rotation_angle(solved.rotation, rotation) < 1e-6
    assert solved.translation_m == pytest.approx(translation, abs=1e-6)


def test_errors_are_what_the_covariance_says_and_smaller_than_any_single_markers() -> None:
    """Over draws eᵀ C⁻¹ e is chi-square with six degrees of freedom: its sum lies within 99.9 %."""
    rng, draws = np.random.default_rng(3), 120
    total, joint, single = 0.0, [], []
    for _ in range(draws):
        angles = rng.uniform(-1, 1, 3) * [40, 40, 180]
        rotation, translation = pose(*angles, 6.0)
        found = [seen(MarkerDesign(), place, rotation, translation, rng) for place in PLACES]
        solved = solve_face_pose(found, CAMERA)
        assert solved is not None
        turn = rotation @ solved.rotation.T
        axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        error = np.concatenate([axis, translation - solved.translation_m])
        # The covariance of a fit is widened where its residual is improbable, once in a hundred draws: little harm here.
        total += float(error @ np.linalg.solve(solved.covariance, error))
        joint.append(rotation_angle(solved.rotation, rotation))
        alone = solve_pose(found[0].features, found[0].marker, CAMERA)
        assert alone is not None
        single.append(rotation_angle(alone.rotation, rotation))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * draws)
    assert low < total < high
    assert np.median(single) > 5 * np.median(joint)


def test_one_marker_is_its_own_pose_moved_to_the_face() -> None:
    rotation, translation = pose(10.0, 20.0, 30.0, 4.0)
    only = seen(MarkerDesign(), (0.3, -0.2), rotation, translation, np.random.default_rng(1))
    solved, own = solve_face_pose([only], CAMERA), solve_pose(only.features, only.marker, CAMERA)
    assert solved is not None
    assert own is not None
    expected = moved_to_face(own, only.centre_m)
    assert solved.translation_m == pytest.approx(expected.translation_m)
    assert solved.covariance == pytest.approx(expected.covariance)


def test_moving_to_the_face_carries_the_covariance() -> None:
    """Against poses moved one by one: 4000 draws, five standard errors of a variance."""
    rotation, translation = pose(10.0, -25.0, 60.0, 4.0)
    own = solve_pose(seen(MarkerDesign(), (0.0, 0.0), rotation, translation, None).features, MarkerDesign(), CAMERA)
    assert own is not None
    rng, draws, centre = np.random.default_rng(2), 4000, (0.4, -0.3)
    moved = moved_to_face(own, centre)
    steps = rng.multivariate_normal(np.zeros(6), own.covariance, draws)
    arm = own.rotation @ np.array([*centre, 0.0])
    shifts = steps[:, 3:] - np.cross(steps[:, :3], arm)
    assert shifts.var(axis=0) == pytest.approx(np.diag(moved.covariance)[3:], rel=5 * np.sqrt(2 / draws))


def test_markers_without_blobs_or_corners_still_count_or_do_not() -> None:
    rotation, translation = pose(5.0, 5.0, 0.0, 8.0)
    rng = np.random.default_rng(4)
    bare = [seen(MarkerDesign(), place, rotation, translation, rng, blobs=False) for place in PLACES]
    nothing = Features(
        identity=None,
        corners_px=None,
        corners_covariance_px2=None,
        blobs_px={},
        blob_sigma_px={},
        virtual_points_px={},
        reason="no marker found",
    )
    lost = FoundMarker(nothing, MarkerDesign(), (0.0, 0.0))
    solved, again = solve_face_pose(bare, CAMERA), solve_face_pose([*bare, lost], CAMERA)
    assert solved is not None
    assert again is not None
    assert np.array_equal(again.rotation, solved.rotation)
    assert rotation_angle(solved.rotation, rotation) < np.radians(0.5)
    assert solve_face_pose([lost], CAMERA) is None
    assert solve_face_pose([], CAMERA) is None
