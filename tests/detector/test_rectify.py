"""Images of a distorted lens as an ideal one takes them, and features brought back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from projected import MARKER, features
from synthetic import NOISE, pose_at

from detector.rectify import MAX_GROWTH, ideal_camera, in_the_image, rectified, rectified_noise
from detector.sensor.noise import noise_of
from detector.sensor.sensor import Sensor
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES

#: Few pixels over a field of 29° by 23°, through a barrel.
BARREL = Camera(width_px=240, height_px=200, focal_length_m=4e-3, k1=-0.4, k2=0.05, p1=1e-3, p2=-2e-3)


def pixels_of(camera: Camera) -> FloatArray:
    """Places (height, width, 2) of all pixels."""
    return np.stack(np.meshgrid(np.arange(float(camera.width_px)), np.arange(float(camera.height_px))), axis=-1)


def test_features_far_from_the_axis_keep_their_place_and_spread() -> None:
    """A rectified frame holds all of a barrel's, and saturation survives the interpolation."""
    camera = BARREL.model_copy(update={"k1": -0.6})
    ideal = ideal_camera(camera)
    assert ideal.width_px > camera.width_px
    assert (ideal.width_px - camera.width_px) % 2 == 0
    noise = noise_of(Sensor(), np.zeros((200, 240), np.uint16))
    assert noise is not None
    image = np.full((200, 240), 200, np.uint16)
    image[60:90, 80:120] = Sensor().saturation_dn
    flat = rectified(image, camera, ideal, noise)
    assert flat.shape == (ideal.height_px, ideal.width_px)
    assert (flat.min(), flat.max()) == (200, noise.saturation_dn)
    assert np.count_nonzero(flat >= noise.saturated_above_dn) > 30 * 40


def test_ideal_camera_shows_every_pixel_of_the_distorted_one() -> None:
    ideal = ideal_camera(BARREL)
    assert not ideal.distorted
    assert ideal.focal_px == BARREL.focal_px
    shift = np.subtract(ideal.principal_point_px, BARREL.principal_point_px)
    place = BARREL.undistort_px(pixels_of(BARREL)) + shift
    assert place.min() >= 0
    assert np.all(place.max(axis=(0, 1)) <= [ideal.width_px - 1, ideal.height_px - 1])


def test_ideal_camera_grows_no_further_than_stated() -> None:
    wild = BARREL.model_copy(update={"focal_length_m": 1.2e-3, "k1": -0.2, "k2": 0.0})
    ideal = ideal_camera(wild)
    assert ideal.width_px <= MAX_GROWTH * wild.width_px
    assert ideal.height_px <= MAX_GROWTH * wild.height_px


def rings(places_px: FloatArray, camera: Camera) -> FloatArray:
    """Smooth light at places (..., 2) of an ideal image, in waves of 20 px about a point off the axis."""
    away = places_px - camera.principal_point_px - np.array([20.0, -15.0])
    return 1000 + 500 * np.cos(2 * np.pi * np.linalg.norm(away, axis=-1) / 20)


def test_rectified_image_shows_what_the_ideal_lens_would() -> None:
    image = rings(BARREL.undistort_px(pixels_of(BARREL)), BARREL)
    ideal = ideal_camera(BARREL)
    off = rectified(image, BARREL, ideal, None) - rings(pixels_of(ideal), ideal)
    # Where the ideal image reaches beyond the frame, the frame's edge goes on: only its middle can agree.
    assert np.abs(off[40:-40, 40:-40]).max() < 5.0
    without = image - rings(pixels_of(BARREL), BARREL)
    assert np.abs(without[40:-40, 40:-40]).max() > 50.0


def test_variance_goes_where_its_pixel_goes_and_blind_pixels_stay_blind() -> None:
    extra = np.full((200, 240), 9.0)
    extra[100:104, 120:124] = np.inf
    ideal = ideal_camera(BARREL)
    moved = rectified_noise(replace(NOISE, extra_variance_dn2=extra), BARREL, ideal)
    assert moved is not None
    assert moved.extra_variance_dn2 is not None
    assert moved.extra_variance_dn2.shape == (ideal.height_px, ideal.width_px)
    blind = ~np.isfinite(moved.extra_variance_dn2)
    assert 16 <= np.count_nonzero(blind) <= 36  # and the neighbours that their interpolation touches
    assert np.median(moved.extra_variance_dn2) == pytest.approx(9.0)
    assert rectified_noise(NOISE, BARREL, ideal) is NOISE
    assert rectified_noise(None, BARREL, ideal) is None


def test_features_return_to_the_image_with_their_covariance() -> None:
    """Against the lens's own projection, and scattered corners brought back one by one: 4000 draws, five standard errors."""
    ideal = ideal_camera(BARREL)
    rotation, translation = pose_at(0.4, 10.0, -15.0, 20.0, (50.0, 40.0), ideal)
    seen = features(rotation, translation, ELEMENT_NAMES)
    corners = ideal.project(MARKER.corners_m @ rotation.T + translation)
    rng, draws = np.random.default_rng(4), 4000
    root = 0.05 * rng.normal(size=(8, 8))
    seen = replace(seen, corners_px=corners, joint_covariance_px2=root @ root.T)
    back = in_the_image(seen, BARREL, ideal)
    expected = BARREL.project(MARKER.corners_m @ rotation.T + translation)
    assert back.corners_px == pytest.approx(expected, abs=1e-9)
    assert np.linalg.norm(expected - corners, axis=1).max() > 1.0
    shaken = [replace(seen, corners_px=corners + e.reshape(4, 2)) for e in rng.normal(size=(draws, 8)) @ root.T]
    scatter = np.array([in_the_image(s, BARREL, ideal).corners_px for s in shaken]).reshape(draws, 8)
    assert back.joint_covariance_px2 is not None
    assert back.corners_covariance_px2 is not None
    assert scatter.var(axis=0) == pytest.approx(np.diag(back.joint_covariance_px2), rel=5 * np.sqrt(2 / draws))
    for k in range(4):
        block = back.joint_covariance_px2[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        assert np.array_equal(back.corners_covariance_px2[k], block)
