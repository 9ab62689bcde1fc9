"""The one entrance to the detector: what is found of a marker, or of a face of several, in an image from any camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.features import Features, find_features
from detector.pose.joint import FoundMarker, moved_to_face, solve_face_pose
from detector.pose.pose import Pose, solve_pose
from detector.rectify import ideal_camera, in_the_image, rectified, rectified_noise
from detector.sensor.defects import mended, without
from detector.sensor.noise import NoiseModel, estimate_noise, noise_of
from detector.sensor.pair import difference, pair_noise
from detector.sensor.sensor import Sensor
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

#: A marker of a face, and the place of its centre there: x to the right, y up [m].
Placed = tuple[MarkerDesign, tuple[float, float]]


@dataclass(frozen=True)
class Detection:
    """What the detector and the pose solver make of one image.

    Attributes:
        features: identity, corners and blobs, at their places in the image.
        pose: of the marker in the camera's frame; None where the marker or its pose was not found.
    """

    features: Features
    pose: Pose | None

    @property
    def detected(self) -> bool:
        """True where the marker was decoded with the right identity and its corners were found."""
        return self.features.detected

    @property
    def usable(self) -> bool:
        """True where the marker was found with a pose that is not ambiguous: what a verdict counts."""
        return self.detected and self.pose is not None and not self.pose.ambiguous


@dataclass(frozen=True)
class FaceDetection:
    """What is found of a face that carries several markers.

    Attributes:
        markers: the markers that were found, features at their places in the image.
        surest: pose of the face from the one marker whose covariance gives the smallest attitude error; None without any.
        pose: pose of the face from all markers together; None without any.
    """

    markers: tuple[FoundMarker, ...]
    surest: Pose | None
    pose: Pose | None


def detect(
    image: NDArray[Any],
    marker: MarkerDesign,
    camera: Camera,
    *,
    sensor: Sensor | None = None,
    noise: NoiseModel | None = None,
    led_ring_radius_m: float | None = None,
    off: NDArray[Any] | None = None,
    bad_pixels: NDArray[np.bool_] | None = None,
) -> Detection:
    """Find a marker in an image and solve its pose. The image of a distorted lens is rectified first.

    Args:
        image: (height, width) digital numbers or electrons, integer or real, of any bit depth.
        marker: the design that is looked for.
        camera: its size must be the image's. The blur is measured in the image; the camera's point spread is a first guess of it.
        sensor: where the image can be its, its noise is known; else noise is estimated from the image.
        noise: of the image, where it is known otherwise; it wins over `sensor`.
        led_ring_radius_m: radius of the LED ring about the lens; None where it is not known.
        off: a frame without the LEDs, taken as the image was: it is subtracted, and the noise of both counts.
        bad_pixels: (height, width), true where a pixel is known to be hot or dead; its readings do not count.

    Returns:
        Features at their places in the image, and the pose in the camera's frame.

    Raises:
        ValueError: when the image is not two-dimensional, not of the camera's size, or holds NaN or infinity; or when `off` or
            `bad_pixels` is of another size, or `off` of another kind of number than the image.
    """
    if bad_pixels is not None and bad_pixels.shape != image.shape:
        raise ValueError(
            f"bad_pixels: {'×'.join(map(str, bad_pixels.shape[::-1]))} px, expected {'×'.join(map(str, image.shape[::-1]))} px "
            "as the image"
        )
    if bad_pixels is not None and bad_pixels.any():
        image, off = mended(image, bad_pixels), None if off is None else mended(off, bad_pixels)
    seen, ideal, known = _ideal(image, camera, sensor, noise, off, bad_pixels)
    features = find_features(seen, marker, ideal, known, led_ring_radius_m)
    pose = solve_pose(features, marker, ideal) if features.detected else None
    return Detection(_placed_back(features, camera, ideal), pose)


def detect_face(
    image: NDArray[Any],
    placed: Sequence[Placed],
    camera: Camera,
    *,
    sensor: Sensor | None = None,
    noise: NoiseModel | None = None,
    led_ring_radius_m: float | None = None,
) -> FaceDetection:
    """Find every marker of a face in an image and solve the face's pose from each and from all; arguments as `detect`.

    Args:
        image: (height, width) digital numbers or electrons.
        camera: its size must be the image's.
        sensor: where the image can be its, its noise is known.
        noise: of the image, where it is known otherwise.
        led_ring_radius_m: radius of the LED ring about the lens; None where it is not known [m].
        placed: each marker of the face with the place of its centre there [m].

    Raises:
        ValueError: as `detect`.
    """
    seen, ideal, known = _ideal(image, camera, sensor, noise, None, None)
    found = []
    for marker, centre_m in placed:
        features = find_features(seen, marker, ideal, known, led_ring_radius_m)
        if features.detected:
            found.append(FoundMarker(features, marker, centre_m))
    alone = ((f, solve_pose(f.features, f.marker, ideal)) for f in found)
    singles = [moved_to_face(pose, f.centre_m) for f, pose in alone if pose is not None]
    surest = min(singles, key=lambda pose: float(np.trace(pose.covariance[:3, :3])), default=None)
    markers = tuple(replace(f, features=_placed_back(f.features, camera, ideal)) for f in found)
    return FaceDetection(markers, surest, solve_face_pose(found, ideal))


def _ideal(
    image: NDArray[Any],
    camera: Camera,
    sensor: Sensor | None,
    noise: NoiseModel | None,
    off: NDArray[Any] | None,
    bad_pixels: NDArray[np.bool_] | None,
) -> tuple[NDArray[Any], Camera, NoiseModel | None]:
    """The image as a camera without distortion takes it, that camera, and the noise; less `off` where it is given."""
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"image is {'×'.join(map(str, image.shape[::-1]))} px, the camera {camera.width_px}×{camera.height_px} px "
            "(camera.width_px, camera.height_px)"
        )
    if noise is None and sensor is not None:
        noise = noise_of(sensor, image)
    if off is not None:
        known = noise if sensor is None or noise_of(sensor, off) is not None else None
        image, noise = difference(image, off, known or pair_noise(image, off))
    if bad_pixels is not None and bad_pixels.any():
        noise = without(noise or estimate_noise(image), bad_pixels)
    if not camera.distorted:
        return image, camera, noise
    ideal = ideal_camera(camera)
    return rectified(image, camera, ideal, noise), ideal, rectified_noise(noise, camera, ideal)


def _placed_back(features: Features, camera: Camera, ideal: Camera) -> Features:
    return in_the_image(features, camera, ideal) if camera.distorted else features
