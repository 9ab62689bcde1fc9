"""Images of a distorted lens as an ideal one takes them, and what is found there brought back.

Detector and pose solver know straight lines only, so `chain.detect` gives them the rectified image.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from detector.features import Features
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray
from radiometry.optics import Camera

#: Most pixels along a side of a rectified image, over those of the frame: what lies further out is cut off.
MAX_GROWTH = 2.0


def ideal_camera(camera: Camera) -> Camera:
    """A camera of the same axis and focal length, without distortion, whose frame holds all that the distorted one shows."""
    right, bottom = camera.width_px - 1.0, camera.height_px - 1.0
    x, y = np.linspace(0, right, 33), np.linspace(0, bottom, 33)
    border = np.concatenate([np.stack([x, 0 * x + v], axis=-1) for v in (0.0, bottom)])
    border = np.concatenate([border, *(np.stack([0 * y + v, y], axis=-1) for v in (0.0, right))])
    out = np.abs(camera.undistort_px(border) - camera.principal_point_px).max(axis=0)
    size = {}
    for key, middle, half in zip(("width_px", "height_px"), camera.principal_point_px, out, strict=True):
        count = getattr(camera, key)
        # Whole pixels on either side keep the axis where it is between pixels.
        more = int(np.ceil(max(half - middle, 0.0)))
        size[key] = min(count + 2 * more, int(MAX_GROWTH * count) // 2 * 2 + count % 2)
    return camera.without_distortion.model_copy(update=size)


def rectified(image: NDArray[Any], camera: Camera, ideal: Camera, noise: NoiseModel | None) -> FloatArray:
    """What the ideal camera sees, by cubic splines between the image's pixels; its edge goes on where the image ends.

    Interpolation averages noise: between pixels its variance falls to half or so, and neighbours are no longer independent. What
    touches a saturated pixel stays saturated.
    """
    at = _places(camera, ideal)
    low, high = float(image.min()), float(image.max())
    # Splines overshoot at edges; light does not.
    result = map_coordinates(np.asarray(image, float), at, order=3, mode="nearest").clip(low, high)
    if noise is not None and high >= noise.saturated_above_dn:
        full = np.asarray(image >= noise.saturated_above_dn, float)
        result[map_coordinates(full, at, order=1, mode="nearest") > 0] = min(high, noise.saturation_dn)
    return result


def rectified_noise(noise: NoiseModel | None, camera: Camera, ideal: Camera) -> NoiseModel | None:
    """The noise of a rectified image: what is known by pixel goes where the pixel goes."""
    if noise is None or noise.extra_variance_dn2 is None:
        return noise
    at, blind = _places(camera, ideal), ~np.isfinite(noise.extra_variance_dn2)
    extra = map_coordinates(np.where(blind, 0.0, noise.extra_variance_dn2), at, order=1, mode="nearest")
    extra[map_coordinates(blind.astype(float), at, order=1, mode="nearest") > 0] = np.inf
    return replace(noise, extra_variance_dn2=extra)


def _places(camera: Camera, ideal: Camera) -> list[FloatArray]:
    """Rows and columns in the camera's image of every pixel of the ideal one [px]."""
    column, row = np.meshgrid(np.arange(ideal.width_px), np.arange(ideal.height_px))
    tangents = (np.stack([column, row], axis=-1) - ideal.principal_point_px) / ideal.focal_px
    places = camera.project(np.concatenate([tangents, np.ones((*column.shape, 1))], axis=-1))
    return [places[..., 1], places[..., 0]]


def in_the_image(found: Features, camera: Camera, ideal: Camera) -> Features:
    """Features of the rectified image at their places in the image itself, covariances with them.

    A blob's scatter along its element keeps its value: distortion changes scale by far less than the scatter is known to.
    """

    def back(points_px: FloatArray) -> FloatArray:
        tangents = (np.asarray(points_px, float) - ideal.principal_point_px) / ideal.focal_px
        return camera.project(np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1))

    blobs = {name: None if place is None else back(place) for name, place in found.blobs_px.items()}
    virtual = {name: back(place) for name, place in found.virtual_points_px.items()}
    if found.corners_px is None:
        return replace(found, blobs_px=blobs, virtual_points_px=virtual)
    if found.joint_covariance_px2 is None:
        return replace(found, corners_px=back(found.corners_px), blobs_px=blobs, virtual_points_px=virtual)
    step = 1e-3 * np.eye(2)
    turn = np.zeros((8, 8))
    for k, corner in enumerate(found.corners_px):
        slope = (back(corner + step) - back(corner - step)) / 2e-3
        turn[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = slope.T
    joint = turn @ found.joint_covariance_px2 @ turn.T
    return replace(
        found,
        corners_px=back(found.corners_px),
        corners_covariance_px2=np.array([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(4)]),
        blobs_px=blobs,
        virtual_points_px=virtual,
        joint_covariance_px2=joint,
    )
