"""Maximum-likelihood pose of a face from all of its markers that were found: one pose, every feature of every marker.

Each marker keeps its own corners, blobs and covariances (`detector.pose.pose`); that it stands at a known place on the face turns
its pose into the face's, t_marker = t + R c. The markers' mutual distances then measure the attitude, which the corners of a
single small square hardly do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from detector.features import Features
from detector.pose.pose import Pose, best_pose, problem_of, solve_pose
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign


@dataclass(frozen=True)
class FoundMarker:
    """A marker that was found, and where its centre is on the face: x to the right, y up [m]."""

    features: Features
    marker: MarkerDesign
    centre_m: tuple[float, float]

    @property
    def place_m(self) -> FloatArray:
        """The centre in the face's frame, (3,) [m]."""
        return np.array([*self.centre_m, 0.0])


def moved_to_face(pose: Pose, centre_m: tuple[float, float]) -> Pose:
    """A marker's pose as the face's: t_face = t − R c, with the covariance that follows to first order."""
    arm = pose.rotation @ np.array([*centre_m, 0.0])
    carry = np.eye(6)
    # δt_face = δt − ω × arm
    carry[3:, :3] = np.cross(arm, np.eye(3)).T
    return Pose(
        pose.rotation, pose.translation_m - arm, carry @ pose.covariance @ carry.T, pose.residual, pose.ambiguous
    )


def solve_face_pose(found: Sequence[FoundMarker], camera: Camera) -> Pose | None:
    """Pose of the face from every marker with corners; None without one, or without a solution.

    With one marker it is `solve_pose`'s, moved to the face's centre.
    """
    seen = [f for f in found if f.features.corners_px is not None]
    singles = [(f, pose) for f in seen if (pose := solve_pose(f.features, f.marker, camera)) is not None]
    if len(seen) < 2:
        return moved_to_face(singles[0][1], singles[0][0].centre_m) if singles else None
    starts = _starts(seen, [moved_to_face(pose, f.centre_m) for f, pose in singles], camera)
    if not starts:
        return None
    rotations, translations = (np.array(part) for part in zip(*starts, strict=True))
    return best_pose(problem_of([(f.features, f.marker, f.place_m) for f in seen], camera), rotations, translations)


def _starts(
    seen: Sequence[FoundMarker], singles: Sequence[Pose], camera: Camera
) -> list[tuple[FloatArray, FloatArray]]:
    """Poses to start from: every marker's own, and both of IPPE on the corners of all."""
    found = [(pose.rotation, pose.translation_m) for pose in singles]
    points = np.concatenate([f.marker.corners_m + f.place_m for f in seen])
    corners = np.concatenate([f.features.corners_px for f in seen if f.features.corners_px is not None])
    solved = cv2.solvePnPGeneric(points, corners.reshape(-1, 1, 2), camera.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    for vector, at in zip(solved[1], solved[2], strict=True):
        if np.isfinite(vector).all() and np.isfinite(at).all():
            found.append((cv2.Rodrigues(vector)[0], at.ravel()))
    return found
