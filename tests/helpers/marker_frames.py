"""Frames of the default marker at stated poses, and where its corners and blobs are in them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from synthetic import electrons, pose_at

from detector.features import Features
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import Element, MarkerDesign

MARKER = MarkerDesign()
#: The default optics behind fewer pixels, to keep the frames quick.
SMALL = Camera(width_px=128, height_px=128)
MEDIUM = Camera(width_px=256, height_px=256)
#: Range [m], pitch, yaw, roll [deg], and the shift of the marker's centre off the principal point [px].
PoseAt = tuple[float, float, float, float, tuple[float, float]]

POSES: list[PoseAt] = [
    (2.0, 20.0, -12.0, 10.0, (3.3, -2.1)),
    (3.0, -35.0, 10.0, 80.0, (0.4, 1.7)),
    (4.4, 15.0, 35.0, -20.0, (-1.2, 0.6)),
    (6.0, 0.0, 0.0, 0.0, (0.0, 0.0)),
    (8.0, 10.0, -20.0, 200.0, (0.25, 0.75)),
    (10.0, 0.0, 5.0, 45.0, (0.5, 0.5)),
]


@lru_cache(maxsize=64)
def frame(
    pose: PoseAt,
    camera: Camera,
    *,
    white: float = 6500.0,
    foil_level: float = 0.2,
    absorber: float = 0.02,
    samples: int = 8,
    marker: MarkerDesign = MARKER,
    ring_radius_m: float = 0.0,
) -> FloatArray:
    """Mean electrons of a marker at some place, see `synthetic.electrons`; the same frame is drawn once."""
    rotation, translation = pose_at(*pose, camera=camera)
    return electrons(
        marker,
        camera,
        rotation,
        translation,
        np.random.default_rng(1),
        white=white,
        foil_level=foil_level,
        absorber=absorber,
        samples=samples,
        ring_radius_m=ring_radius_m,
    )


def true_corners(pose: PoseAt, camera: Camera) -> FloatArray:
    """Corners (4, 2) of the marker as they project [px]."""
    rotation, translation = pose_at(*pose, camera=camera)
    return camera.project(MARKER.corners_m @ rotation.T + translation)


def blob_error(found: Features, element: Element, pose: PoseAt, camera: Camera) -> float:
    """Signed distance of a found blob from the true one along the element [px]."""
    rotation, translation = pose_at(*pose, camera=camera)
    u = element.blob_offset_m(-rotation.T @ translation)
    points = element.centre_m + np.array([[u], [u + 1e-5]]) * element.along
    at, beside = camera.project(points @ rotation.T + translation)
    direction = (beside - at) / np.linalg.norm(beside - at)
    blob = found.blobs_px[element.name]
    assert blob is not None
    return float((blob - at) @ direction)
