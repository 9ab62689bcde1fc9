"""The detector's entrance: ideal and distorted lenses, an off frame, a face of several markers, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from synthetic import NOISE, electrons, expose, foil, pose_at

from detector.detect import detect, detect_face
from detector.features import find_features
from detector.pose.pose import solve_pose
from detector.rectify import ideal_camera
from detector.sensor.noise import sensor_noise
from detector.sensor.sensor import Sensor
from radiometry.geometry import FloatArray, rotation_angle
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign

MARKER = MarkerDesign()
CAMERA = Camera(width_px=200, height_px=200)
POSE = (4.0, 12.0, -9.0, 20.0, (0.3, -0.2))
#: A barrel over a wide field.
BARREL = Camera(width_px=240, height_px=200, focal_length_m=4e-3, k1=-0.4, k2=0.05)


def rate(camera: Camera = CAMERA, pose: tuple = POSE, foil_level: float = 0.0) -> FloatArray:
    """Mean electrons of a frame."""
    rotation, translation = pose_at(*pose, camera=camera)
    return electrons(MARKER, camera, rotation, translation, np.random.default_rng(1), foil_level=foil_level)


def shot(mean: FloatArray) -> np.ndarray:
    return expose(mean, np.random.default_rng(2))


def test_an_ideal_lens_s_image_goes_as_it_is_to_detector_and_solver() -> None:
    image = shot(rate())
    seen = detect(image, MARKER, CAMERA, noise=NOISE, led_ring_radius_m=0.0)
    features = find_features(image, MARKER, CAMERA, NOISE, 0.0)
    assert seen.detected
    assert np.array_equal(seen.features.corners_px, features.corners_px)
    pose = solve_pose(features, MARKER, CAMERA)
    assert pose is not None
    assert seen.pose is not None
    assert np.array_equal(seen.pose.rotation, pose.rotation)


def test_through_a_distorted_lens_features_lie_in_the_image_and_the_pose_is_right() -> None:
    ideal = ideal_camera(BARREL)
    pose = (0.5, 10.0, -12.0, 20.0, (45.0, -30.0))
    column, row = np.meshgrid(np.arange(float(BARREL.width_px)), np.arange(float(BARREL.height_px)))
    shift = np.subtract(ideal.principal_point_px, BARREL.principal_point_px)
    place = BARREL.undistort_px(np.stack([column, row], axis=-1)) + shift
    bent = map_coordinates(rate(ideal, pose), [place[..., 1], place[..., 0]], order=3, mode="nearest")
    image = shot(bent.clip(0))
    rotation, translation = pose_at(*pose, camera=ideal)
    corners = BARREL.project(MARKER.corners_m @ rotation.T + translation)
    seen = detect(image, MARKER, BARREL, noise=NOISE, led_ring_radius_m=0.0)
    assert seen.detected
    assert seen.features.corners_px == pytest.approx(corners, abs=0.1)
    assert seen.pose is not None
    assert np.degrees(rotation_angle(seen.pose.rotation, rotation)) < 0.3
    assert seen.pose.translation_m == pytest.approx(translation, rel=2e-3)
    # Taken for an ideal lens's, the image would put a corner ten times as far off as is asked for here.
    straight = BARREL.without_distortion.project(MARKER.corners_m @ rotation.T + translation)
    assert np.linalg.norm(straight - corners, axis=1).max() > 1.0


def test_an_off_frame_takes_away_the_light_it_shares() -> None:
    rng = np.random.default_rng(3)
    glare = np.minimum(foil((CAMERA.height_px, CAMERA.width_px), 6000.0, rng), 20_000.0)
    image, off = shot(0.6 * rate() + glare), expose(glare, rng)
    seen = detect(image, MARKER, CAMERA, noise=NOISE, led_ring_radius_m=0.0, off=off)
    assert seen.detected
    assert seen.pose is not None
    rotation, translation = pose_at(*POSE, camera=CAMERA)
    assert np.degrees(rotation_angle(seen.pose.rotation, rotation)) < 1.0
    assert np.linalg.norm(seen.pose.translation_m - translation) < 0.005 * POSE[0]
    alone = detect(image, MARKER, CAMERA, noise=NOISE, led_ring_radius_m=0.0)
    assert not alone.detected or _worst(alone.features.corners_px) > _worst(seen.features.corners_px)


def _worst(corners_px: FloatArray | None) -> float:
    """Furthest distance of a corner from the truth [px]."""
    rotation, translation = pose_at(*POSE, camera=CAMERA)
    assert corners_px is not None
    return float(np.abs(corners_px - CAMERA.project(MARKER.corners_m @ rotation.T + translation)).max())


def test_a_sensor_tells_the_noise_of_its_own_images_alone() -> None:
    sensor = Sensor()
    known = sensor_noise(sensor)
    image = expose(rate(), np.random.default_rng(4), known)
    told = detect(image, MARKER, CAMERA, noise=known)
    assert np.array_equal(detect(image, MARKER, CAMERA, sensor=sensor).features.corners_px, told.features.corners_px)
    # Real numbers are none that this sensor gives: the noise is estimated, with or without it.
    real, estimated = (detect(image.astype(float), MARKER, CAMERA, sensor=s) for s in (sensor, None))
    assert np.array_equal(real.features.corners_px, estimated.features.corners_px)
    assert not np.array_equal(real.features.corners_px, told.features.corners_px)


def test_no_marker_no_pose() -> None:
    seen = detect(shot(np.full((200, 200), 500.0)), MARKER, CAMERA, noise=NOISE)
    assert not seen.detected
    assert seen.pose is None
    assert seen.features.blobs_px == dict.fromkeys(ELEMENT_NAMES)
    assert seen.features.reason


def test_a_face_of_two_markers_has_one_pose_from_both() -> None:
    camera, aside = Camera(width_px=320, height_px=200), 0.07
    rotation, translation = pose_at(*POSE, camera=camera)
    placed = [(MARKER, (-aside, 0.0)), (MarkerDesign(identity=5), (aside, 0.0))]
    mean = np.zeros((200, 320))
    for marker, place in placed:
        at = translation + rotation @ np.array([*place, 0.0])
        mean += electrons(marker, camera, rotation, at, np.random.default_rng(1), foil_level=0.0)
    absent = (MarkerDesign(identity=9), (0.0, 0.3))
    seen = detect_face(shot(mean), [*placed, absent], camera, noise=NOISE, led_ring_radius_m=0.0)
    assert [found.marker.identity for found in seen.markers] == [MARKER.identity, 5]
    assert seen.pose is not None
    assert seen.surest is not None
    for pose in (seen.pose, seen.surest):
        assert np.degrees(rotation_angle(pose.rotation, rotation)) < 0.5
        assert np.linalg.norm(pose.translation_m - translation) < 0.005 * POSE[0]
    assert np.trace(seen.pose.covariance[:3, :3]) < np.trace(seen.surest.covariance[:3, :3])


def test_a_face_without_its_markers_has_no_pose() -> None:
    seen = detect_face(shot(np.full((200, 200), 500.0)), [(MARKER, (0.0, 0.0))], CAMERA, noise=NOISE)
    assert (seen.markers, seen.surest, seen.pose) == ((), None, None)


@pytest.mark.parametrize("shape", [(200, 199), (199, 200), (200, 200, 3), (200,)])
def test_an_image_of_another_size_than_the_camera_s_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"the camera 200×200 px \(camera\.width_px, camera\.height_px\)"):
        detect(np.zeros(shape), MARKER, CAMERA)
    with pytest.raises(ValueError, match="the camera 200×200 px"):
        detect_face(np.zeros(shape), [(MARKER, (0.0, 0.0))], CAMERA)


@pytest.mark.parametrize("off", [np.zeros((200, 100), np.uint16), np.zeros((200, 200), float)])
def test_an_off_frame_of_another_size_or_kind_is_refused(off: np.ndarray) -> None:
    with pytest.raises(ValueError, match="off"):
        detect(shot(rate()), MARKER, CAMERA, noise=NOISE, off=off)
