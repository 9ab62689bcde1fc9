"""Features of a marker as they project, without an image: exact, or with Gaussian errors."""

from __future__ import annotations

import numpy as np

from detector.features import Features
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign

MARKER = MarkerDesign()
CAMERA = Camera()


def features(
    rotation: FloatArray,
    translation: FloatArray,
    blobs: tuple[str, ...],
    sigma_px: float = 0.02,
    rng: np.random.Generator | None = None,
) -> Features:
    """Features as they project, with Gaussian errors of `sigma_px` where a generator is given."""

    def error(*shape: int) -> FloatArray:
        return sigma_px * rng.standard_normal(shape) if rng else np.zeros(shape)

    corners = CAMERA.project(MARKER.corners_m @ rotation.T + translation) + error(4, 2)
    found: dict[str, FloatArray | None] = dict.fromkeys(ELEMENT_NAMES)
    for e in MARKER.elements:
        if e.name in blobs:
            u = e.blob_offset_m(-rotation.T @ translation)
            at, beside = CAMERA.project((e.centre_m + np.array([[u], [u + 1e-6]]) * e.along) @ rotation.T + translation)
            found[e.name] = at + error(1) * (beside - at) / np.linalg.norm(beside - at)
    covariance = np.broadcast_to(sigma_px**2 * np.eye(2), (4, 2, 2)).copy()
    return Features(
        identity=0,
        corners_px=corners,
        corners_covariance_px2=covariance,
        blobs_px=found,
        blob_sigma_px=dict.fromkeys(blobs, sigma_px),
        virtual_points_px={},
        reason=None,
    )
