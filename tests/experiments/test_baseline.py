"""The thesis's feature pipeline on synthetic frames of known geometry."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import NOISE, electrons, expose, pose_at

from experiments.studies.shared.baseline import baseline_features, to_eight_bits
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

MARKER = MarkerDesign()
CAMERA = Camera(width_px=128, height_px=128)
POSE = {"range_m": 3.0, "pitch_deg": -8.0, "yaw_deg": 12.0, "roll_deg": 3.0}


def frame(seed: int = 1, **kwargs: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return expose(electrons(MARKER, CAMERA, *pose_at(**POSE), rng, white=20_000.0, foil_level=0.05, **kwargs), rng)


def eight_bits(image: np.ndarray, white_electrons: float = 28_000.0) -> np.ndarray:
    return to_eight_bits(image, NOISE.offset_dn, NOISE.offset_dn + NOISE.gain_dn_per_electron * white_electrons)


def true_blobs() -> dict[str, FloatArray]:
    rotation, translation = pose_at(**POSE)
    camera_m = -rotation.T @ translation
    points = np.array([e.centre_m + e.blob_offset_m(camera_m) * e.along for e in MARKER.elements])
    return dict(zip([e.name for e in MARKER.elements], CAMERA.project(points @ rotation.T + translation), strict=True))


def test_corners_have_no_common_shift_and_blobs_lie_near_the_truth() -> None:
    rotation, translation = pose_at(**POSE)
    truth = CAMERA.project(MARKER.corners_m @ rotation.T + translation)
    errors = []
    for seed in range(8):
        features = baseline_features(eight_bits(frame(seed)), MARKER)
        assert features.corners_px is not None
        errors.append((features.corners_px - truth).mean(axis=0))
        blobs = {name: blob for name, blob in features.blobs_px.items() if blob is not None}
        assert len(blobs) >= 2
        for name, blob in blobs.items():
            assert np.linalg.norm(blob - true_blobs()[name]) < 1.0
    # Within 0.2 px of the truth: half a pixel, its library's shift, is far outside.
    assert np.abs(np.mean(errors, axis=0)).max() < 0.2


def test_blobs_are_lost_where_they_stay_below_the_first_threshold() -> None:
    features = baseline_features(eight_bits(frame(), white_electrons=20_000.0 * 255 / 9), MARKER)
    assert all(blob is None for blob in features.blobs_px.values())


def test_says_what_is_missing() -> None:
    blank = baseline_features(np.zeros((64, 64), np.uint8), MARKER)
    assert not blank.detected
    assert blank.reason == "no marker found"
    other = baseline_features(eight_bits(frame()), MARKER.model_copy(update={"identity": 7}))
    assert not other.detected
    assert other.reason == "only identity 0 seen"


def test_stretches_black_to_zero_and_white_to_255() -> None:
    assert to_eight_bits(np.array([[0, 64, 2064, 4064, 9999]]), 64, 4064).tolist() == [[0, 0, 128, 255, 255]]


def test_corners_may_be_refined_within_a_window_instead() -> None:
    """The half pixel that the AprilTag refinement is off by must not be taken from the other."""
    rotation, translation = pose_at(**POSE)
    truth = CAMERA.project(MARKER.corners_m @ rotation.T + translation)
    errors = [
        (baseline_features(eight_bits(frame(seed)), MARKER, "subpix").corners_px - truth).mean(axis=0)
        for seed in range(8)
    ]
    assert np.abs(np.mean(errors, axis=0)).max() < 0.25
    with pytest.raises(ValueError, match="refinement: 'none', expected one of apriltag, subpix"):
        baseline_features(eight_bits(frame()), MARKER, "none")


@pytest.mark.parametrize("image", [np.zeros((8, 8), np.uint16), np.zeros((8, 8, 3), np.uint8)])
def test_refuses_what_is_no_eight_bit_frame(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected \\(H, W\\) of uint8"):
        baseline_features(image, MARKER)
