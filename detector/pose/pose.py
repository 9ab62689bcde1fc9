"""Maximum-likelihood pose of a Mantis Marker from its corners and blobs.

The four corners are weighted by their joint covariance. Each blob is one scalar: where, along its element, the plane
through the camera and the virtual line cuts the front plane. That depends on the attitude in first order, where the
corners of a small frontal square depend on it in second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincc

from detector.compiled import invert_scaled
from detector.features import Features
from detector.pose.pose_fit import Problem, first_poses, minimise, residuals
from radiometry.geometry import FloatArray, faces_camera, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

#: Two attitudes further apart than this are distinct [rad].
DISTINCT_RAD = np.radians(5.0)
#: A distinct minimum within this chi-square of the best makes the pose ambiguous: odds better than 1 : 90.
AMBIGUOUS_CHI2 = 9.0
#: A residual chi-square less probable than this, if the noise model held, widens the covariance.
UNLIKELY = 0.01
#: One less probable than this is a contradiction of blobs and corners, no bad luck nor a deviation told a little too small.
CONTRADICTION = 1e-6
#: What the corners' model may miss under heavy defocus or uneven light: their deviation is widened by so much first [px].
#: Assumption; in focus and even light corners are biased by less than 0.01 px.
CORNER_DOUBT_PX = 0.05
#: Passes in which deviations of blobs that contradict corners are widened: each takes most of what is left.
WIDENINGS = 6


@dataclass(frozen=True)
class Pose:
    """Marker -> camera: X_camera = rotation · X_marker + translation_m."""

    rotation: FloatArray
    """(3, 3)."""
    translation_m: FloatArray
    """(3,) [m]."""
    covariance: FloatArray
    """(6, 6) of (ω, δt) [rad, m], left perturbation in the camera frame: R_true = exp([ω]×) R, t_true = t + δt.

    Inverse information matrix, times the reduced chi-square where the residual is improbably large."""
    residual: float
    """Reduced chi-square of corners and blobs."""
    ambiguous: bool
    """True where an attitude more than 5° off explains the features within Δχ² = 9, be it another minimum or the same one that is
    so wide, or where no attitude explains them."""


def solve_pose(features: Features, marker: MarkerDesign, camera: Camera) -> Pose | None:
    """Pose of a marker by maximum likelihood from its corners and blobs; blobs, where present, settle the attitude.

    Args:
        features: what was found, in the image of a lens without distortion.
        marker: its design.
        camera: focal length and principal point.

    Returns:
        Pose with its covariance, flagged where it is ambiguous or contradicts the features; None without corners or solution.
    """
    if features.corners_px is None or features.corners_covariance_px2 is None:
        return None
    problem = problem_of([(features, marker, np.zeros(3))], camera)
    pose = _from_first(problem, marker)
    if pose is None or _probability(pose, problem) > CONTRADICTION:
        return pose
    wider = _with_wider_blobs(features, marker, camera) if len(problem.blobs_px) else None
    if wider is not None:
        return wider
    # Corners and blobs that contradict each other by more than their models may miss belong to no pose.
    problem = _doubted(features, marker, camera)
    problem = problem._replace(blob_sigma_px=np.hypot(problem.blob_sigma_px, CORNER_DOUBT_PX))
    doubted = _from_first(problem, marker)
    contradicts = doubted is None or _probability(doubted, problem) < CONTRADICTION
    return replace(pose, ambiguous=bool(pose.ambiguous or contradicts))


def _from_first(problem: Problem, marker: MarkerDesign) -> Pose | None:
    rotations, translations = np.empty((2, 3, 3)), np.empty((2, 3))
    first_poses(problem, marker.aruco_m / 2, rotations, translations)
    return best_pose(problem, rotations, translations)


def _probability(pose: Pose, problem: Problem) -> float:
    """Of a residual at least as large, if the noise model held."""
    freedom = problem.measurements - 6
    return float(gammaincc(freedom / 2, pose.residual * freedom / 2))


def _with_wider_blobs(features: Features, marker: MarkerDesign, camera: Camera) -> Pose | None:
    """The pose where blobs contradict corners: the corners' deviations widened by what their model may miss, then the blobs'.

    A light beside the camera, a lamp or the Sun, shines into the slits from aside and moves the blobs, and nothing in their own
    light tells; it cannot move corners. None where the corners alone do not fit, and the fault is not the blobs'.
    """
    corners = problem_of([(replace(features, blobs_px={}), marker, np.zeros(3))], camera)
    alone = _from_first(corners, marker)
    if alone is None or _probability(alone, corners) < UNLIKELY:
        return None
    problem = _doubted(features, marker, camera)
    pose = _from_first(problem, marker)
    for _ in range(WIDENINGS):
        if pose is None or _probability(pose, problem) > UNLIKELY:
            break
        problem = problem._replace(blob_sigma_px=problem.blob_sigma_px * np.sqrt(pose.residual))
        pose = _from_first(problem, marker) or pose
    return pose


def _doubted(features: Features, marker: MarkerDesign, camera: Camera) -> Problem:
    """The measurements, with the corners' deviations widened by what their model may miss."""
    doubted = features.corner_covariance_px2 + CORNER_DOUBT_PX**2 * np.eye(8)
    return problem_of([(replace(features, joint_covariance_px2=doubted), marker, np.zeros(3))], camera)


def problem_of(found: Sequence[tuple[Features, MarkerDesign, FloatArray]], camera: Camera) -> Problem:
    """The measurements of markers at places (3,) [m] of one rigid face; features without corners do not count."""
    corners, whiten, blobs = [], [], []
    for features, marker, place_m in found:
        if features.corners_px is None:
            continue
        corners.append((marker.corners_m + place_m, features.corners_px))
        whiten.append(np.linalg.inv(np.linalg.cholesky(features.corner_covariance_px2)))
        blobs += [
            (at, features.blob_sigma_px[e.name], place_m, e)
            for e in marker.elements
            if (at := features.blobs_px.get(e.name)) is not None
        ]
    return Problem(
        corners_m=np.array([points for points, _ in corners], float).reshape(-1, 4, 3),
        corners_px=np.array([image for _, image in corners], float).reshape(-1, 4, 2),
        whiten=np.array(whiten, float).reshape(-1, 8, 8),
        blobs_px=np.array([at for at, _, _, _ in blobs], float).reshape(-1, 2),
        blob_sigma_px=np.array([sigma for _, sigma, _, _ in blobs], float),
        place_m=np.array([place for _, _, place, _ in blobs], float).reshape(-1, 3),
        element_m=np.array([e.centre_m for _, _, _, e in blobs], float).reshape(-1, 3),
        along=np.array([e.along for _, _, _, e in blobs], float).reshape(-1, 3),
        virtual_m=np.array([(e.virtual_offset_m, e.virtual_depth_m) for _, _, _, e in blobs], float).reshape(-1, 2),
        lens_px=np.array([*camera.focal_px, *camera.principal_point_px]),
    )


def best_pose(problem: Problem, rotations: FloatArray, translations: FloatArray) -> Pose | None:
    """The best of the minima that starts (k, 3, 3) and (k, 3), which it overwrites, lead to; None where all face away."""
    cost = np.empty(len(rotations))
    minimise(problem, problem.measurements, rotations, translations, cost)
    keep = [k for k in np.argsort(cost) if np.isfinite(cost[k]) and faces_camera(rotations[k], translations[k])]
    if not keep:
        return None
    best = keep[0]
    residual, jacobian = np.empty(problem.measurements), np.empty((problem.measurements, 6))
    residuals(problem, rotations[best], translations[best], residual, jacobian)
    covariance = np.empty((6, 6))
    if not invert_scaled(jacobian.T @ jacobian, covariance):
        return None
    reduced = float(cost[best] / (problem.measurements - 6))
    rivals = [k for k in keep[1:] if cost[k] - cost[best] < AMBIGUOUS_CHI2]
    ambiguous = any(rotation_angle(rotations[k], rotations[best]) > DISTINCT_RAD for k in rivals)
    pose = Pose(rotations[best], translations[best], (covariance + covariance.T) / 2, reduced, ambiguous)
    if _probability(pose, problem) < UNLIKELY:
        pose = replace(pose, covariance=pose.covariance * reduced)
    widest = float(np.linalg.eigvalsh(pose.covariance[:3, :3])[-1])
    return replace(pose, ambiguous=bool(ambiguous or AMBIGUOUS_CHI2 * widest > DISTINCT_RAD**2))
