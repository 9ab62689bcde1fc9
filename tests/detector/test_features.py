"""Detection and features on synthetic frames of known geometry."""

from __future__ import annotations

import numpy as np
import pytest
from marker_frames import MARKER, MEDIUM, POSES, SMALL, blob_error, frame, true_corners
from scipy.stats import beta, chi2
from synthetic import NOISE, electrons, expose, foil, pose_at, range_for

from detector.features import find_features
from detector.sensor.noise import NoiseModel
from radiometry.optics import Camera
from scenes.marker import MarkerDesign


@pytest.mark.parametrize("pose", POSES)
def test_corners_are_unbiased_and_in_the_marker_s_order(pose):
    mean = frame(pose, MEDIUM)
    rng = np.random.default_rng(2)
    found = [find_features(expose(mean, rng), MARKER, MEDIUM, NOISE) for _ in range(8)]
    assert all(f.detected and f.identity == 0 for f in found)
    error = np.array([f.corners_px for f in found]) - true_corners(pose, MEDIUM)
    assert np.abs(error.mean(0)).max() < 0.05
    assert np.sqrt((error**2).mean()) < (0.02 if pose[0] < 5 else 0.04)


def test_the_reported_covariance_is_the_scatter():
    # Few electrons, so that noise rules over what the model of the blur leaves.
    pose = (4.4, 12.0, -8.0, 25.0, (0.3, 0.2))
    mean = frame(pose, SMALL, white=600.0, foil_level=0.0, samples=16)
    rng = np.random.default_rng(4)
    found = [find_features(expose(mean, rng), MARKER, SMALL, NOISE, light_ring_m=0.0) for _ in range(120)]
    assert all(f.detected for f in found)
    error = np.array([f.corners_px for f in found]) - true_corners(pose, SMALL)
    joint = sum(
        e.ravel() @ np.linalg.solve(f.joint_covariance_px2, e.ravel()) for e, f in zip(error, found, strict=True)
    )
    freedom = error.size
    # The covariance is widened by the reduced chi-square, never narrowed: a few per cent on the safe side.
    low, high = chi2.ppf([5e-4, 1 - 5e-4], freedom)
    assert 0.9 * low < joint < high
    single = sum(
        error[n, k] @ np.linalg.solve(f.corners_covariance_px2[k], error[n, k])
        for n, f in enumerate(found)
        for k in range(4)
    )
    assert 0.75 * freedom < single < 1.25 * freedom
    pulls = [
        blob_error(f, e, pose, SMALL) / f.blob_sigma_px[e.name]
        for f in found
        for e in MARKER.elements
        if f.blobs_px[e.name] is not None
    ]
    assert len(pulls) > 200
    low, high = chi2.ppf([5e-4, 1 - 5e-4], len(pulls))
    assert 0.8 * low < float(np.square(pulls).sum()) < high


def _found(
    bit_px: float, camera: Camera, poses: int, shots: int, seed: int, white: float = 20_000.0, **options: float
) -> tuple[int, int]:
    rng = np.random.default_rng(seed)
    detected = 0
    for _ in range(poses):
        roll, shift = float(rng.uniform(-180, 180)), (float(rng.uniform(-2, 2)), float(rng.uniform(-2, 2)))
        pose = (range_for(bit_px, MARKER, camera), 0.0, 0.0, roll, shift)
        rotation, translation = pose_at(*pose, camera=camera)
        mean = electrons(MARKER, camera, rotation, translation, rng, white=white, samples=6, **options)
        for _ in range(shots):
            f = find_features(expose(mean, rng), MARKER, camera, NOISE)
            if f.detected:
                assert np.abs(f.corners_px - true_corners(pose, camera)).max() < 0.5
                detected += 1
    return detected, poses * shots


def test_detects_99_of_100_at_two_pixels_per_bit():
    detected, trials = _found(2.0, Camera(width_px=72, height_px=72), 100, 3, 5, foil_level=0.3)
    # Lower end of the one-sided 95 % Clopper–Pearson interval.
    assert beta.ppf(0.05, detected, trials - detected + 1) >= 0.99


@pytest.mark.parametrize("bit_px", [2.5, 3.0, 5.0, 20.0])
def test_detects_every_larger_marker(bit_px):
    camera = MEDIUM if bit_px > 10 else SMALL
    detected, trials = _found(bit_px, camera, 4 if bit_px > 10 else 12, 2, 6, foil_level=0.0 if bit_px > 10 else 0.3)
    assert detected == trials


@pytest.mark.parametrize("level", [1.0, 3.0, 10.0])
def test_detects_before_foil_brighter_than_itself(level):
    detected, trials = _found(2.5, SMALL, 12, 1, 7, foil_level=level)
    assert detected == trials


@pytest.mark.parametrize("times", [1, 3, 10, 100, 1000])
def test_decodes_white_far_beyond_saturation(times):
    # The well holds 32 600 electrons. At 2e7 the absorber must stay dark for anything to be seen.
    pose = (range_for(8.0, MARKER, MEDIUM), 8.0, -6.0, 30.0, (0.4, 0.1))
    mean = frame(pose, MEDIUM, white=32_600.0 * times, foil_level=0.0, absorber=1e-5)
    f = find_features(expose(mean, np.random.default_rng(8)), MARKER, MEDIUM, NOISE)
    assert f.detected, f.reason
    error = f.corners_px - true_corners(pose, MEDIUM)
    assert np.abs(error).max() < 0.15
    assert np.abs(error.mean(0)).max() < 0.05


def test_detects_low_contrast_in_full_bit_depth():
    # 4 DN over 1.4 DN of noise, four pixels a bit: below one grey level of the frame mapped to eight bits.
    faint = NoiseModel(gain_dn_per_electron=1.0, read_noise_dn=1.0, offset_dn=200.0, saturation_dn=16383.0)
    pose = (range_for(4.0, MARKER, SMALL), 10.0, 5.0, 20.0, (0.0, 0.0))
    mean = frame(pose, SMALL, white=5.0, foil_level=0.0, samples=6)
    rng = np.random.default_rng(9)
    found = [find_features(expose(mean, rng, faint), MARKER, SMALL, faint) for _ in range(20)]
    assert sum(f.detected for f in found) >= 19


@pytest.mark.parametrize("kind", ["noise", "foil", "bright foil", "glints", "saturated foil", "checks"])
def test_finds_no_marker_where_there_is_none(kind):
    rng = np.random.default_rng(10)
    shape = (SMALL.height_px, SMALL.width_px)
    for _ in range(50):
        if kind == "noise":
            mean = np.full(shape, rng.choice([0.0, 8000.0]))
        elif kind == "glints":
            mean = np.zeros(shape)
            mean[tuple(rng.integers(0, 128, (2, 60)))] = 10 ** rng.uniform(3, 7, 60)
        elif kind == "checks":
            mean = 6500.0 * np.kron(rng.random((43, 43)) > 0.5, np.ones((3, 3)))[:128, :128]
        else:
            mean = 6500.0 * foil(shape, {"foil": 0.3, "bright foil": 2.0, "saturated foil": 30.0}[kind], rng)
        f = find_features(expose(mean, rng), MARKER, SMALL, NOISE)
        assert not f.detected
        assert f.reason
        assert f.corners_px is None


def test_another_identity_is_named_but_not_detected():
    other = MarkerDesign(identity=7)
    mean = frame((4.0, 5.0, 5.0, 10.0, (0.0, 0.0)), SMALL, foil_level=0.0, marker=other)
    image = expose(mean, np.random.default_rng(11))
    assert find_features(image, other, SMALL, NOISE).identity == 7
    f = find_features(image, MARKER, SMALL, NOISE)
    assert not f.detected
    assert f.identity == 7
    assert "7" in (f.reason or "")


def test_virtual_points_lie_where_they_project():
    pose = (3.0, 6.0, -5.0, 30.0, (1.0, -0.5))
    f = find_features(expose(frame(pose, MEDIUM), np.random.default_rng(13)), MARKER, MEDIUM, NOISE)
    rotation, translation = pose_at(*pose, camera=MEDIUM)
    assert f.reason is None
    for key, point in MARKER.virtual_points_m.items():
        assert f.virtual_points_px[key] == pytest.approx(MEDIUM.project(rotation @ point + translation), abs=0.1)


def test_kinds_of_numbers_and_an_unknown_noise_make_little_difference():
    pose = (4.4, 5.0, -4.0, 12.0, (0.3, 0.2))
    image = expose(frame(pose, SMALL), np.random.default_rng(16))
    reference = find_features(image, MARKER, SMALL, NOISE)
    for other, noise in (
        (image.astype(float), NOISE),
        (image.astype(np.float32), None),
        (image, None),
        ((image / 32).astype(np.uint8), None),
    ):
        f = find_features(other, MARKER, SMALL, noise)
        assert f.detected
        assert np.abs(f.corners_px - reference.corners_px).max() < 0.1


NO_IMAGES = [
    np.zeros((40, 40, 3)),
    np.zeros(40),
    np.full((40, 40), np.nan),
    np.full((40, 40), np.inf),
    np.zeros((4, 4)),
    np.full((40, 40), "a"),
    np.zeros((40, 40), complex),
]


@pytest.mark.parametrize("image", NO_IMAGES)
def test_refuses_what_is_no_image(image):
    with pytest.raises(ValueError, match="image"):
        find_features(image, MARKER, SMALL, NOISE)


@pytest.mark.parametrize(
    "image", [np.zeros((64, 64)), np.full((64, 64), 255, np.uint8), np.eye(64), np.full((64, 64), -5.0)]
)
@pytest.mark.parametrize("noise", [None, NOISE])
def test_degenerate_frames_hold_no_marker(image, noise):
    assert not find_features(image, MARKER, SMALL, noise).detected


def test_a_marker_cut_by_the_image_s_edge_is_not_detected_and_does_no_harm():
    mean = frame((3.0, 5.0, 5.0, 0.0, (60.0, 0.0)), SMALL)
    assert not find_features(expose(mean, np.random.default_rng(17)), MARKER, SMALL, NOISE).detected
