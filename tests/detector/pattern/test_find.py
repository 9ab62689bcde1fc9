"""A detector that is told no truth: blur, noise, saturation and defects are found in the image itself.

Frames have exact projection and noise (`synthetic.py`); the detector's camera always says that the lens is in focus.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest
from scipy.stats import chi2
from synthetic import NOISE, electrons, expose, pose_at, range_for

from detector.detect import Detection, detect
from detector.features import find_features
from detector.pose.pose import solve_pose
from radiometry.geometry import FloatArray, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign, aruco_dictionary

MARKER = MarkerDesign()
#: What the detector is told of the lens, whatever the truth [px].
TOLD_PX = 0.5


@lru_cache(maxsize=64)
def scene(
    bit_px: float, blur_px: float, seed: int, samples: int = 4
) -> tuple[FloatArray, Camera, FloatArray, FloatArray]:
    """Mean electrons of a marker at a place of its own, the camera as it is, and the pose."""
    rng = np.random.default_rng((seed, int(100 * bit_px), int(100 * blur_px)))
    side = int(11.5 * bit_px + 8 * blur_px + 30) // 2 * 2
    camera = Camera(width_px=side, height_px=side, psf_sigma_px=blur_px)
    pitch, yaw = rng.uniform(-15, 15, 2)
    place = tuple(rng.uniform(-2, 2, 2))
    rotation, translation = pose_at(range_for(bit_px, MARKER, camera), pitch, yaw, rng.uniform(0, 360), place, camera)
    mean = electrons(MARKER, camera, rotation, translation, rng, foil_level=0.1, samples=samples)
    return mean, camera, rotation, translation


def blind(camera: Camera) -> Camera:
    """What the detector knows of a camera: not its blur."""
    return camera.model_copy(update={"psf_sigma_px": TOLD_PX})


def found(image: np.ndarray, camera: Camera, **known: object) -> Detection:
    return detect(image, MARKER, blind(camera), **{"noise": NOISE, "led_ring_radius_m": 0.0, **known})


def attitude_deg(detection: Detection, rotation: FloatArray) -> float:
    """Attitude error; infinite without a usable pose."""
    if detection.pose is None or detection.pose.ambiguous:
        return np.inf
    return float(np.degrees(rotation_angle(detection.pose.rotation, rotation)))


def opencv_finds(image: np.ndarray) -> bool:
    """Whether OpenCV's ArUco decodes the marker in the frame stretched to 8 bits."""
    low, high = float(image.min()), float(image.max())
    eight = ((image - low) * (255 / (high - low))).astype(np.uint8)
    _, identities, _ = cv2.aruco.ArucoDetector(aruco_dictionary(MARKER.dictionary)).detectMarkers(eight)
    return identities is not None and MARKER.identity in identities.ravel().tolist()


@pytest.mark.parametrize("blur_px", [0.3, 1.0, 2.0, 4.0, 12.0])
@pytest.mark.parametrize("blur_bits", [0.3, 0.7])
def test_a_marker_is_found_through_any_blur_that_a_bit_spans(blur_px: float, blur_bits: float) -> None:
    """OpenCV's ArUco loses it from 0.3 to 0.4 bits of blur on."""
    bit_px = max(blur_px / blur_bits, 2.2)
    theirs = 0
    for seed in range(2):
        mean, camera, rotation, _ = scene(bit_px, blur_px, seed, 1 if blur_px > 5 else 3 if blur_px > 3 else 5)
        image = expose(mean, np.random.default_rng(seed))
        ours = found(image, camera)
        assert ours.detected, ours.features.reason
        assert attitude_deg(ours, rotation) < 3.0
        assert ours.features.blur_px == pytest.approx(blur_px, rel=0.05, abs=0.08)
        theirs += opencv_finds(image)
    if blur_bits > 0.5 and blur_px >= 2:
        assert theirs == 0


@pytest.mark.parametrize("blur_px", [0.3, 0.5, 0.65, 0.8])
def test_a_point_spread_that_is_not_the_told_one_leaves_the_attitude_right(blur_px: float) -> None:
    for seed in range(4):
        mean, camera, rotation, _ = scene(2.6, blur_px, seed, 12)
        assert attitude_deg(found(expose(mean, np.random.default_rng(seed)), camera), rotation) < 1.5


def test_the_measured_blur_has_the_deviation_it_says() -> None:
    off = []
    for seed in range(24):
        mean, camera, _, _ = scene(4.0, 1.0, seed % 4, 12)
        features = find_features(expose(mean, np.random.default_rng(seed)), MARKER, blind(camera), NOISE, 0.0)
        off.append((features.blur_px - 1.0) / features.blur_deviation_px)
    low, high = chi2.ppf([0.005, 0.995], len(off)) / len(off)
    # The frame itself is sampled, and part of the deviation is the model's, hence the allowances beside the statistics.
    assert 0.7 * low < np.mean(np.square(off)) < 1.3 * high


def test_a_defocus_disc_is_found_with_honest_corners() -> None:
    """A kernel that is no Gaussian: the corners' errors stay within what their covariance says."""
    errors = []
    for seed in range(6):
        mean, camera, rotation, translation = scene(8.0, 0.3, seed, 8)
        radius = 3.0
        x = np.arange(-20, 21) / 5
        fine = (np.hypot(*np.meshgrid(x, x)) < radius).astype(float)
        disc = cv2.resize(fine[:40, :40], (8, 8), interpolation=cv2.INTER_AREA)
        image = expose(cv2.filter2D(mean, -1, disc / disc.sum(), anchor=(4, 4)), np.random.default_rng(seed))
        ours = found(image, camera)
        assert ours.detected, ours.features.reason
        truth = camera.project(MARKER.corners_m @ rotation.T + translation)
        assert ours.features.corners_px is not None
        error = ours.features.corners_px - truth
        errors.append(error - error.mean(axis=0))  # the disc itself stands a part of a pixel aside
        assert ours.features.blur_px == pytest.approx(radius / 2, rel=0.25)
    assert np.sqrt(np.mean(np.square(errors))) < 0.05


DEFECTS = ["hot pixel", "dead column", "flare"]


@pytest.mark.parametrize("defect", DEFECTS)
def test_defects_leave_a_dim_marker_found_and_in_place(defect: str) -> None:
    for seed in range(3):
        mean, camera, rotation, translation = scene(6.0, 0.5, seed, 5)
        image = expose(mean * 0.15, np.random.default_rng(seed))
        corners = camera.project(MARKER.corners_m @ rotation.T + translation)
        column, row = np.rint(corners.mean(axis=0) + np.array([4.0 + seed, -3.0])).astype(int)
        if defect == "hot pixel":
            image[row, column] = 16_000
        elif defect == "dead column":
            image[:, column] = 0
        else:
            v, u = np.mgrid[: image.shape[0], : image.shape[1]]
            glow = np.exp(-0.5 * ((u - corners[0, 0]) ** 2 + (v - corners[0, 1]) ** 2) / 3.0**2)
            image = (image + 1000 * glow).astype(np.uint16)
        ours = found(image, camera)
        assert ours.detected, ours.features.reason
        assert ours.features.corners_px is not None
        assert np.abs(ours.features.corners_px - corners).max() < 0.3
        assert attitude_deg(ours, rotation) < 1.5


def test_a_map_of_bad_pixels_is_heeded() -> None:
    mean, camera, rotation, _ = scene(4.0, 0.5, 1, 5)
    rng = np.random.default_rng(1)
    image = expose(mean, rng)
    bad = rng.random(image.shape) < 0.04
    image[bad] = rng.integers(0, 16_000, int(bad.sum()))
    assert attitude_deg(found(image, camera, bad_pixels=bad), rotation) < 1.0
    with pytest.raises(ValueError, match="bad_pixels: 3×3 px, expected"):
        found(image, camera, bad_pixels=bad[:3, :3])


@pytest.mark.parametrize("shift", [1, 4])
def test_a_noisy_plateau_is_seen_as_saturated(shift: int) -> None:
    """The well is full before read noise is added, and the converter's bits lie in the upper part of a number."""
    for seed in range(3):
        mean, camera, rotation, translation = scene(5.0, 0.5, seed, 5)
        rng = np.random.default_rng(seed)
        full = np.minimum(rng.poisson(4 * mean), 10_000)
        image = np.rint(64 + 0.1 * full + 3 * rng.normal(size=mean.shape)).clip(0, 4095).astype(np.uint16) * shift
        ours = found(image, camera, noise=None)
        assert ours.detected, ours.features.reason
        assert attitude_deg(ours, rotation) < 1.0
        error = ours.features.corners_px - camera.project(MARKER.corners_m @ rotation.T + translation)
        nees = error.ravel() @ np.linalg.solve(ours.features.corner_covariance_px2, error.ravel())
        assert nees < 2 * chi2.ppf(0.999, 8)


def test_reasons_say_what_to_change() -> None:
    mean, camera, _, _ = scene(4.0, 4.0, 1)
    assert "blurred: σ" in _reason(mean, camera)
    mean, camera, _, _ = scene(4.0, 0.5, 1)
    assert _reason(mean * 1e4, camera).startswith("saturated: ")
    assert "contrast" in _reason(mean * 3e-3, camera)
    close = Camera(width_px=128, height_px=128)
    rotation, translation = pose_at(0.5, 3.0, 2.0, 10.0, camera=close)
    mean = electrons(MARKER, close, rotation, translation, np.random.default_rng(1), samples=2)
    assert _reason(mean, close) == "marker larger than the frame"


def _reason(mean: FloatArray, camera: Camera) -> str:
    ours = found(expose(mean, np.random.default_rng(1)), camera)
    assert not ours.detected
    assert ours.features.reason is not None
    return ours.features.reason


def test_corners_blobs_and_pose_are_as_far_off_as_they_say() -> None:
    """The matched case, blur measured: means of the normalised squared errors lie within their 99 % intervals."""
    corner, blob, pose = [], [], []
    for seed in range(24):
        mean, camera, rotation, translation = scene(5.0, 0.8, seed % 6, 14)
        features = find_features(expose(mean, np.random.default_rng(seed)), MARKER, blind(camera), NOISE, 0.0)
        solved = solve_pose(features, MARKER, camera)
        assert features.corners_px is not None
        assert solved is not None
        error = (features.corners_px - camera.project(MARKER.corners_m @ rotation.T + translation)).ravel()
        corner.append(error @ np.linalg.solve(features.corner_covariance_px2, error))
        turned = cv2.Rodrigues(rotation @ solved.rotation.T)[0].ravel()
        off = np.concatenate([turned, translation - solved.translation_m])
        pose.append(off @ np.linalg.solve(solved.covariance, off))
        for element in MARKER.elements:
            place = features.blobs_px[element.name]
            if place is None:
                continue
            u = element.blob_offset_m(-rotation.T @ translation)
            points = element.centre_m + np.array([[u], [u + 1e-5]]) * element.along
            at, beside = camera.project(points @ rotation.T + translation)
            along = (beside - at) / np.linalg.norm(beside - at)
            blob.append((float((place - at) @ along) / features.blob_sigma_px[element.name]) ** 2)
    for squares, freedom in ((corner, 8), (blob, 1), (pose, 6)):
        high = chi2.ppf(0.995, freedom * len(squares)) / len(squares)
        # The frame is sampled at a finite number of places, hence the allowance beside the statistics.
        assert np.mean(squares) < 1.25 * high, (freedom, np.mean(squares))
