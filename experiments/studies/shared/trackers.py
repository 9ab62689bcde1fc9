"""Trackers that are compared on the same frames: what each finds of its target, and the pose it gives.

Planar methods end in a planar solver, so that what is compared is the fiducial: this project's corners with the
maximum-likelihood solver from both IPPE poses; OpenCV's and pupil-apriltags' own corners with both IPPE poses refined; and
OpenCV's with the iterative solver that the thesis used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.detect import Detection, detect
from detector.features import Features
from detector.pattern.corners import fit_pattern
from detector.pattern.pattern import Pattern, kernel_sigma_px
from detector.pnp.pnp import ippe_refined, squared_error, two_start
from detector.pose.pose import solve_pose
from detector.rectify import ideal_camera, rectified, rectified_noise
from detector.sensor.noise import NoiseModel
from experiments.studies.shared.baseline import REFINEMENT_SHIFT_PX, baseline_features, to_eight_bits
from radiometry.geometry import FloatArray, faces_camera
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign, aruco_dictionary
from scenes.tags import DotPlate, TagPlate

#: pupil-apriltags counts pixels from their corner, this project from their centre [px].
_APRILTAG_SHIFT_PX = 0.5
#: Order of the virtual points of which the thesis's solver takes the first. Listing A.1 numbers them by their signs; which
#: elements make them follows from section 8.1: the left one serves wherever its blob is found, the right one beyond.
_THESIS_ORDER = ("bottom_left", "top_left", "top_right", "bottom_right")
#: A dot is measured in a circle about it, larger than the dot by this much [px].
_DOT_MARGIN_PX = 2.0

Image = NDArray[Any]
#: What may be looked for.
Design = MarkerDesign | TagPlate | DotPlate


@dataclass(frozen=True)
class TrackerFrame:
    """One frame of a camera without distortion, and what may be known of it.

    Attributes:
        image: digital numbers (height, width).
        design: of the target that is looked for.
        camera: without distortion, which OpenCV's trackers do not know of; `rectify` makes such a frame.
        noise: of the image.
        light_ring_m: radius of the ring of LEDs around the lens.
        truth_px: true image of the design's feature points, which only the idealised protrusion may use, to associate its dots.
    """

    image: Image
    design: Design
    camera: Camera
    noise: NoiseModel
    light_ring_m: float
    truth_px: FloatArray

    def __post_init__(self) -> None:
        if self.camera.distorted:
            raise ValueError("camera: its lens distorts; expected a rectified image and its ideal camera")

    @property
    def eight_bits(self) -> NDArray[np.uint8]:
        """The frame with its black level at 0 and its brightest pixel at 255."""
        return to_eight_bits(self.image, self.noise.offset_dn, max(float(self.image.max()), self.noise.offset_dn + 1))


@dataclass(frozen=True)
class TrackerResult:
    """What a method makes of a frame.

    Attributes:
        points_px: feature points (n, 2), corners first; None where nothing was found.
        rotation, translation_m: pose, None without.
        blobs: elements whose blob was found; None for methods without elements.
        virtual: whether two blobs make a virtual point.
        other: whether another identity, or a second marker, was seen.
        sigma_pitch_rad: standard deviation about the marker's x axis that the solver states; NaN where it states none.
    """

    points_px: FloatArray | None = None
    rotation: FloatArray | None = None
    translation_m: FloatArray | None = None
    blobs: frozenset[str] | None = None
    virtual: bool = False
    other: bool = False
    sigma_pitch_rad: float = np.nan


def rectify(image: Image, camera: Camera, noise: NoiseModel) -> tuple[Image, Camera, NoiseModel]:
    """An image (height, width) as a camera without distortion takes it, that camera, and the noise there.

    `detect` does so by itself. All trackers are to look at the same frame, though, and the foreign ones know no distortion.
    """
    if not camera.distorted:
        return image, camera, noise
    ideal = ideal_camera(camera)
    there = rectified_noise(noise, camera, ideal)
    assert there is not None
    return rectified(image, camera, ideal, noise), ideal, there


def mantis(frame: TrackerFrame) -> TrackerResult:
    """This project's features and pose."""
    marker = cast(MarkerDesign, frame.design)
    return of_detection(detection(frame), marker)


def detection(frame: TrackerFrame) -> Detection:
    """What this project's detector finds of a Mantis Marker."""
    marker = cast(MarkerDesign, frame.design)
    return detect(frame.image, marker, frame.camera, noise=frame.noise, led_ring_radius_m=frame.light_ring_m)


def of_detection(found: Detection, marker: MarkerDesign) -> TrackerResult:
    """A detection as the result of a tracker."""
    features, pose = found.features, found.pose
    blobs = frozenset(name for name in ELEMENT_NAMES if features.blobs_px.get(name) is not None)
    other = features.identity not in (None, marker.identity)
    if pose is None:
        return TrackerResult(features.corners_px, blobs=blobs, other=other)
    about_x = pose.rotation[:, 0]
    return TrackerResult(
        points_px=features.corners_px,
        rotation=pose.rotation,
        translation_m=pose.translation_m,
        blobs=blobs,
        virtual=bool(features.virtual_points_px),
        other=other,
        sigma_pitch_rad=float(np.sqrt(about_x @ pose.covariance[:3, :3] @ about_x)),
    )


def of_features(features: Features, marker: MarkerDesign, camera: Camera) -> TrackerResult:
    """The maximum-likelihood pose from features that were found in another way than by `detect`."""
    pose = solve_pose(features, marker, camera) if features.detected else None
    return of_detection(Detection(features, pose), marker)


def thesis(frame: TrackerFrame) -> TrackerResult:
    """The thesis's pipeline: its features, an iterative solution from the corners, then again with one virtual point."""
    marker = cast(MarkerDesign, frame.design)
    features = baseline_features(frame.eight_bits, marker)
    blobs = frozenset(name for name in ELEMENT_NAMES if features.blobs_px.get(name) is not None)
    if features.corners_px is None:
        return TrackerResult(blobs=blobs, other=features.identity is not None)
    points, image = marker.corners_m, features.corners_px
    start = _iterative(points, image, frame.camera, None)
    chosen = next((key for key in _THESIS_ORDER if key in features.virtual_points_px), None)
    if chosen is not None and start is not None:
        points = np.vstack([points, marker.virtual_points_m[chosen]])
        image = np.vstack([image, features.virtual_points_px[chosen]])
        start = _iterative(points, image, frame.camera, start)
    if start is None:
        return TrackerResult(features.corners_px, blobs=blobs, virtual=chosen is not None)
    rotation = cv2.Rodrigues(start[0])[0]
    return TrackerResult(features.corners_px, rotation, start[1].ravel(), blobs, virtual=chosen is not None)


def _iterative(
    points_m: FloatArray, image_px: FloatArray, camera: Camera, start: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray] | None:
    """OpenCV's iterative solution, rotation vector and translation; from a pose where one is given."""
    first, second = (None, None) if start is None else (start[0].copy(), start[1].copy())
    found, vector, offset = cv2.solvePnP(
        points_m,
        image_px.reshape(-1, 1, 2),
        cameraMatrix=camera.matrix,
        distCoeffs=None,
        rvec=first,
        tvec=second,
        useExtrinsicGuess=start is not None,
        flags=cv2.SOLVEPNP_ITERATIVE,
    )
    good = found and np.isfinite(vector).all() and np.isfinite(offset).all()
    return (np.asarray(vector, float), np.asarray(offset, float)) if good else None


def aruco(frame: TrackerFrame) -> TrackerResult:
    """Best effort: OpenCV decodes, with settings for small markers; our corner fit; both IPPE poses to maximum likelihood."""
    tag = cast(TagPlate, frame.design)
    corners, other = _decoded(frame, cv2.aruco.CORNER_REFINE_NONE)
    if corners is None:
        return TrackerResult(other=other)
    fit = fit_pattern(frame.image, _pattern(tag), corners, kernel_sigma_px(frame.camera.psf_sigma_px), frame.noise)
    if fit is None:
        return _planar(tag, corners, frame.camera, other)
    covariance = fit.covariance_px2
    blocks = np.array([covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(4)])
    features = Features(
        identity=tag.identity,
        corners_px=fit.corners_px,
        corners_covariance_px2=blocks,
        blobs_px=dict.fromkeys(ELEMENT_NAMES),
        blob_sigma_px={},
        virtual_points_px={},
        reason=None,
        joint_covariance_px2=covariance,
    )
    return replace(of_features(features, cast(MarkerDesign, tag), frame.camera), blobs=None, other=other)


@lru_cache(maxsize=4)
def _pattern(tag: TagPlate) -> Pattern:
    """A tag's print as the corner fit knows it: no encoding elements, so no openings (0, 4)."""
    pattern = Pattern(cast(MarkerDesign, tag))
    pattern.openings = np.reshape(pattern.openings, (-1, 4))
    return pattern


def aruco_opencv(frame: TrackerFrame) -> TrackerResult:
    """OpenCV's default detection with AprilTag refinement; both IPPE poses refined."""
    corners, other = _decoded(frame, cv2.aruco.CORNER_REFINE_APRILTAG)
    if corners is None:
        return TrackerResult(other=other)
    return _planar(cast(TagPlate, frame.design), corners - REFINEMENT_SHIFT_PX, frame.camera, other)


def aruco_thesis(frame: TrackerFrame) -> TrackerResult:
    """The thesis's benchmark: the same corners, but OpenCV's iterative solver from its one start."""
    corners, other = _decoded(frame, cv2.aruco.CORNER_REFINE_APRILTAG)
    return TrackerResult(other=other) if corners is None else _four_corners(frame, corners - REFINEMENT_SHIFT_PX, other)


def inner_aruco(frame: TrackerFrame) -> TrackerResult:
    """The Mantis Marker's ArUco alone, refined within a window (cornerSubPix): what the thesis's faulty corners look like."""
    corners, other = _decoded(frame, cv2.aruco.CORNER_REFINE_SUBPIX)
    return TrackerResult(other=other) if corners is None else _four_corners(frame, corners, other)


def _four_corners(frame: TrackerFrame, corners: FloatArray, other: bool) -> TrackerResult:
    pose = _iterative(cast(TagPlate, frame.design).corners_m, corners, frame.camera, None)
    if pose is None:
        return TrackerResult(corners, other=other)
    return TrackerResult(corners, cv2.Rodrigues(pose[0])[0], pose[1].ravel(), other=other)


def _decoded(frame: TrackerFrame, refinement: int) -> tuple[FloatArray | None, bool]:
    """Corners of the tag by OpenCV, and whether it saw anything else."""
    tag = cast(TagPlate, frame.design)
    found, identities, _ = _aruco(tag.dictionary, refinement).detectMarkers(frame.eight_bits)
    seen = [] if identities is None else [int(k) for k in np.ravel(identities)]
    if tag.identity not in seen:
        return None, bool(seen)
    return np.reshape(found[seen.index(tag.identity)], (4, 2)).astype(float), len(seen) > 1


@lru_cache(maxsize=4)
def _aruco(dictionary: str, refinement: int) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    if refinement == cv2.aruco.CORNER_REFINE_NONE:
        parameters.minMarkerPerimeterRate = 0.01
        parameters.perspectiveRemovePixelPerCell = 8
    return cv2.aruco.ArucoDetector(aruco_dictionary(dictionary), parameters)


def apriltag(frame: TrackerFrame) -> TrackerResult:
    """pupil-apriltags without decimation; both IPPE poses refined."""
    tag = cast(TagPlate, frame.design)
    found = _apriltag_detector().detect(frame.eight_bits)
    own = next((d for d in found if d.tag_id == tag.identity), None)
    if own is None:
        return TrackerResult(other=bool(found))
    # From the tag's bottom left, counter-clockwise, in its own frame, which is OpenCV's turned by half a turn.
    corners = np.asarray(own.corners, float)[[1, 0, 3, 2]] - _APRILTAG_SHIFT_PX
    return _planar(tag, corners, frame.camera, len(found) > 1)


def apriltag_available() -> bool:
    """True where pupil-apriltags, a development extra, is installed."""
    return find_spec("pupil_apriltags") is not None


@lru_cache(maxsize=1)
def _apriltag_detector() -> Any:
    from pupil_apriltags import Detector

    return Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)


def _planar(tag: TagPlate, corners_px: FloatArray, camera: Camera, other: bool) -> TrackerResult:
    """Both IPPE poses of four corners refined, and as IPPE degenerates at frontal SQPnP's and its mirror; least error wins."""
    points, pixels, every = tag.corners_m[None], corners_px[None], np.ones((1, 4), bool)
    poses = [solve(points, pixels, every, camera) for solve in (ippe_refined, two_start)]
    error = [float(squared_error(points, pixels, every, camera, pose)[0]) for pose in poses]
    rotation, translation = (part[0] for part in poses[int(np.argmin(np.nan_to_num(error, nan=np.inf)))])
    good = np.isfinite(rotation).all() and np.isfinite(translation).all() and faces_camera(rotation, translation)
    return (
        TrackerResult(corners_px, rotation, translation, other=other)
        if good
        else TrackerResult(corners_px, other=other)
    )


def svms(frame: TrackerFrame) -> TrackerResult:
    """Centroids of the dots about their true places: an idealised detector, which never confuses or loses one."""
    plate, places = cast(DotPlate, frame.design), frame.truth_px
    sides_px = np.linalg.norm(places[:4] - np.roll(places[:4], 1, axis=0), axis=1)
    sides_m = np.linalg.norm(plate.points_m[:4] - np.roll(plate.points_m[:4], 1, axis=0), axis=1)
    reach = plate.dot_radius_m * float((sides_px / sides_m).max()) + _DOT_MARGIN_PX
    for _ in range(2):
        places = np.array([_centroid(frame, places, k, reach) for k in range(len(places))])
    every = np.ones((1, len(places)), bool)
    rotation, translation = two_start(plate.points_m[None], places[None], every, frame.camera)
    if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        return TrackerResult(places)
    return TrackerResult(places, rotation[0], translation[0])


def _centroid(frame: TrackerFrame, places_px: FloatArray, k: int, reach_px: float) -> FloatArray:
    """Centre (2,) of the light within a circle about one of some places, less the level of a ring around it [px]."""
    low = np.floor(places_px[k] - reach_px - 2).astype(int)
    size = int(np.ceil(2 * reach_px)) + 5
    column, row = np.meshgrid(low[0] + np.arange(size), low[1] + np.arange(size))
    away = np.hypot(column - places_px[:, :1, None], row - places_px[:, 1:, None])
    own = away[k] <= away.min(axis=0)
    inside, around = own & (away[k] <= reach_px), own & (away[k] > reach_px) & (away[k] <= reach_px + 2)
    illumination = frame.image[row[inside], column[inside]] - np.median(frame.image[row[around], column[around]])
    return np.array([illumination @ column[inside], illumination @ row[inside]]) / illumination.sum()


Method = Callable[[TrackerFrame], TrackerResult]

#: The Mantis Marker in all its variants.
_MARKERS = ("mantis", "improved", "misplaced", "calibrated")
#: Methods by name: function, what it is called, and the targets that it is for.
METHODS: dict[str, tuple[Method, str, tuple[str, ...]]] = {
    "mantis": (mantis, "Mantis", _MARKERS),
    "thesis": (thesis, "thesis's pipeline", _MARKERS),
    "aruco": (aruco, "ArUco, best effort", ("aruco",)),
    "inner_aruco": (inner_aruco, "inner ArUco, window-refined", ("mantis", "improved")),
    "aruco_opencv": (aruco_opencv, "ArUco, OpenCV's corners", ("aruco",)),
    "aruco_thesis": (aruco_thesis, "ArUco as in the thesis", ("aruco",)),
    "apriltag": (apriltag, "AprilTag 36h11", ("apriltag",)),
    "svms": (svms, "protrusion (SVMS)", ("svms",)),
}


def methods_of(target: str) -> tuple[str, ...]:
    """Names of the methods that can be tried on a target here."""
    names = tuple(name for name, (_, _, targets) in METHODS.items() if target in targets)
    return tuple(n for n in names if n != "apriltag" or apriltag_available())
