"""The feature pipeline that the thesis describes (section 5.4), as a baseline: OpenCV's ArUco, then a blob detector per element.

Written from the description and the settings it prints, for 8-bit frames. Where its OpenCV differs from today's, the difference
is named beside the line.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from detector.detect import Detection
from detector.features import Features
from detector.pattern.pattern import homography, project
from detector.pose.pose import solve_pose
from detector.rectify import ideal_camera, in_the_image, rectified
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign, aruco_dictionary

#: Margin kept from an element's edges, over the ArUco side (thesis, equations 5.1–5.4).
MARGIN = 0.05
#: Area of a blob over that of an element, inertia ratio, and distance of blobs over the ArUco side (thesis, appendix A).
BLOB_AREA, BLOB_INERTIA, BLOB_DISTANCE = (0.125, 0.25), 0.15, 1 / 30
#: Thresholds of the blob detector [DN of 8 bits]: first, last, step; a blob must show at this many (thesis, appendix A).
THRESHOLDS, REPEATABILITY = (10, 250, 1), 2
#: A blob this near to a corner of its element may be cut off, over the ArUco side (thesis, appendix A).
CORNER_CLEARANCE = 0.175
#: Corner refinements: the one the thesis names, and the search in a window that its faulty corners speak of (section 8.3).
REFINEMENTS = {"apriltag": cv2.aruco.CORNER_REFINE_APRILTAG, "subpix": cv2.aruco.CORNER_REFINE_SUBPIX}
#: Shift of OpenCV 5.0's AprilTag corner refinement along x and y [px], measured on rendered frames; earlier ones have none.
REFINEMENT_SHIFT_PX = 0.5 if int(cv2.__version__.split(".")[0]) >= 5 else 0.0
#: Standard deviation that a pose solver is told of corners and blobs, for the pipeline states none [px]. Assumption.
SIGMA_PX = 0.2


def to_eight_bits(image: ArrayLike, black_dn: float, white_dn: float) -> NDArray[np.uint8]:
    """An image (height, width) with its black and white level [DN] stretched to 0 and 255."""
    level = (np.asarray(image, float) - black_dn) / (white_dn - black_dn)
    return np.rint(255 * level.clip(0, 1)).astype(np.uint8)


def baseline_features(image: NDArray[np.uint8], marker: MarkerDesign, refinement: str = "apriltag") -> Features:
    """Corners by `cv2.aruco`, blobs by `cv2.SimpleBlobDetector` in a mask of each element.

    Args:
        image: (height, width), 8 bits; of a lens without distortion, which the thesis's pipeline does not know of.
        marker: the design that is looked for.
        refinement: of the corners, 'apriltag', or 'subpix' within a window.

    Raises:
        ValueError: when the image is not two-dimensional or not of 8 bits, or the refinement is unknown.
    """
    if refinement not in REFINEMENTS:
        raise ValueError(f"refinement: {refinement!r}, expected one of {', '.join(REFINEMENTS)}")
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError(f"image: shape {image.shape}, dtype {image.dtype}, expected (H, W) of uint8")
    found, identities, _ = _aruco(marker.dictionary, refinement).detectMarkers(image)
    seen = [] if identities is None else [int(k) for k in np.ravel(identities)]
    if marker.identity not in seen:
        reason = f"only identity {seen[0]} seen" if seen else "no marker found"
        return Features(
            identity=seen[0] if seen else None,
            corners_px=None,
            corners_covariance_px2=None,
            blobs_px=dict.fromkeys(ELEMENT_NAMES),
            blob_sigma_px={},
            virtual_points_px={},
            reason=reason,
        )
    corners = np.reshape(found[seen.index(marker.identity)], (4, 2)).astype(float)
    if refinement == "apriltag":
        corners -= REFINEMENT_SHIFT_PX
    blobs: dict[str, FloatArray | None] = {}
    missing = []
    for turn, name in enumerate(ELEMENT_NAMES):
        blob = _blob(image, np.roll(corners, -turn, axis=0), marker)
        blobs[name] = None if isinstance(blob, str) else blob
        missing += [f"{name} blob: {blob}"] if isinstance(blob, str) else []
    return Features(
        identity=marker.identity,
        corners_px=corners,
        corners_covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (4, 1, 1)),
        blobs_px=blobs,
        blob_sigma_px={name: SIGMA_PX for name, blob in blobs.items() if blob is not None},
        virtual_points_px=_virtual_points(corners, blobs, marker),
        reason="; ".join(missing) or None,
    )


def baseline_detect(image: NDArray[np.uint8], marker: MarkerDesign, camera: Camera) -> Detection:
    """The pipeline's features with this project's pose solver; the image of a distorted lens is rectified first.

    Args:
        marker: the design that is looked for.
        image: (height, width) of 8 bits.
        camera: its size must be the image's.

    Returns:
        Features at their places in the image, and the pose in the camera's frame.
    """
    ideal = ideal_camera(camera) if camera.distorted else camera
    seen = np.rint(rectified(image, camera, ideal, None)).astype(np.uint8) if camera.distorted else image
    features = baseline_features(seen, marker)
    pose = solve_pose(features, marker, ideal) if features.detected else None
    return Detection(in_the_image(features, camera, ideal) if camera.distorted else features, pose)


@lru_cache(maxsize=4)
def _aruco(dictionary: str, refinement: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = REFINEMENTS[refinement]
    return cv2.aruco.ArucoDetector(aruco_dictionary(dictionary), parameters)


def _blob(image: NDArray[np.uint8], corners: FloatArray, marker: MarkerDesign) -> FloatArray | str:
    """Blob (2,) [px] of the element beside the side from the first to the second corner, or why there is none."""
    width, gap = marker.element_width_fraction, marker.gap_fraction
    side = float(np.linalg.norm(corners[1] - corners[0]))
    outwards = corners[:2] - corners[[3, 2]]
    far, near = (corners[:2] + outwards * reach for reach in (width + gap - MARGIN, gap + MARGIN))
    outline = np.array([far[0], far[1], near[1], near[0]])
    low = np.maximum(np.floor(outline.min(0)).astype(int) - 2, 0)
    high = np.minimum(np.ceil(outline.max(0)).astype(int) + 3, image.shape[::-1])
    if (high - low < 4).any():
        return "outside the image"
    crop = image[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros_like(crop)
    cv2.fillPoly(mask, [np.rint(outline - low).astype(np.int32)], (255,))
    # Its Gaussian of 3 × 3 pixels and a deviation of 50 is a plain mean.
    blurred = cv2.GaussianBlur(cv2.bitwise_and(crop, mask), (3, 3), 50)
    area = width * marker.element_length_fraction * side**2
    points = [np.array(k.pt) + low for k in _blob_detector(area, side).detect(blurred)]
    if not points:
        return "no light"
    if np.linalg.norm(outline - points[0], axis=1).min() < CORNER_CLEARANCE * side:
        return "too close to the element's end"
    return np.asarray(points[0], float)


def _blob_detector(element_area_px2: float, side_px: float) -> cv2.SimpleBlobDetector:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.filterByColor, parameters.blobColor = True, 255
    parameters.filterByArea = True
    parameters.minArea, parameters.maxArea = (element_area_px2 * part for part in BLOB_AREA)
    parameters.filterByInertia = True
    parameters.minInertiaRatio, parameters.maxInertiaRatio = BLOB_INERTIA, 1.0
    parameters.filterByCircularity = parameters.filterByConvexity = False
    parameters.minDistBetweenBlobs = max(1.0, round(side_px * BLOB_DISTANCE))
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = THRESHOLDS
    parameters.minRepeatability = REPEATABILITY
    return cv2.SimpleBlobDetector.create(parameters)


def _virtual_points(
    corners: FloatArray, blobs: dict[str, FloatArray | None], marker: MarkerDesign
) -> dict[str, FloatArray]:
    """Where the lines through two blobs along the slats cross in the front plane (thesis, equations 5.6–5.11).

    The marker's own plane stands for the slopes of the ArUco's sides, which are one direction only without perspective.
    """
    matrix = homography(corners)
    back = np.linalg.inv(matrix)
    points = {}
    for key in marker.virtual_points_m:
        horizontal, vertical = (blobs[name] for name in key.split("_"))
        if horizontal is not None and vertical is not None:
            across = project(back, np.array([horizontal, vertical]))
            points[key] = project(matrix, np.array([across[0, 0], across[1, 1]]))
    return points
