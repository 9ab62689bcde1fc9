"""Maximum-likelihood pose of a Mantis Marker from its corners and blobs.

The four corners are weighted by their joint covariance. Each blob is one scalar: where, along its element, the plane
through the camera and the virtual line cuts the front plane. That depends on the attitude in first order, where the
corners of a small frontal square depend on it in second.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detector.features import Features
from detector.pattern import homography
from radiometry.geometry import FloatArray, faces_camera, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

#: Two attitudes further apart than this are distinct [rad].
DISTINCT_RAD = np.radians(5.0)
#: A distinct minimum within this chi-square of the best makes the pose ambiguous: odds better than 1 : 90.
AMBIGUOUS_CHI2 = 9.0
MAX_ITERATIONS = 25
#: A residual chi-square less probable than this, if the noise model held, widens the covariance.
UNLIKELY = 0.01


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
    """True where an attitude more than 5° off explains the features within Δχ² = 9."""


def solve_pose(features: Features, marker: MarkerDesign, camera: Camera) -> Pose | None:
    """Pose from any features with corners; blobs, where present, settle the attitude. None without corners or solution."""
    if features.corners_px is None or features.corners_covariance_px2 is None:
        return None
    problem = _Problem(features, marker, camera)
    rotation, translation = _starts(features, marker, camera)
    rotation, translation, cost = problem.minimise(rotation, translation)
    keep = [k for k in np.argsort(cost) if np.isfinite(cost[k]) and faces_camera(rotation[k], translation[k])]
    if not keep:
        return None
    best = keep[0]
    residual, jacobian = problem.residuals(rotation[best : best + 1], translation[best : best + 1])
    try:
        covariance = np.linalg.inv(jacobian[0].T @ jacobian[0])
    except np.linalg.LinAlgError:
        return None
    freedom = len(residual[0]) - 6
    reduced = float(cost[best] / freedom)
    if _chance(float(cost[best]), freedom) < UNLIKELY:
        covariance = covariance * reduced
    rivals = [k for k in keep[1:] if cost[k] - cost[best] < AMBIGUOUS_CHI2]
    ambiguous = any(rotation_angle(rotation[k], rotation[best]) > DISTINCT_RAD for k in rivals)
    return Pose(rotation[best], translation[best], (covariance + covariance.T) / 2, reduced, ambiguous)


def _chance(chi2: float, freedom: int) -> float:
    from scipy.special import gammaincc

    return float(gammaincc(freedom / 2, chi2 / 2))


class _Problem:
    """Whitened residuals and their derivatives for a batch of poses."""

    def __init__(self, features: Features, marker: MarkerDesign, camera: Camera):
        assert features.corners_px is not None
        assert features.corners_covariance_px2 is not None
        covariance = features.joint_covariance_px2
        if covariance is None:
            covariance = np.zeros((8, 8))
            for k, block in enumerate(features.corners_covariance_px2):
                covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        self.whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        self.corners_px = features.corners_px
        self.corners_m = marker.corners_m
        self.focal = np.array(camera.focal_px)
        self.centre = np.array(camera.principal_point_px)
        seen = [e for e in marker.elements if features.blobs_px.get(e.name) is not None]
        self.blobs_px = np.array([features.blobs_px[e.name] for e in seen]).reshape(-1, 2)
        self.sigma = np.array([features.blob_sigma_px[e.name] for e in seen])
        self.element_m = np.array([e.centre_m for e in seen]).reshape(-1, 3)
        self.along = np.array([e.along for e in seen]).reshape(-1, 3)
        self.offset = np.array([e.virtual_offset_m for e in seen])
        self.depth = np.array([e.virtual_depth_m for e in seen])

    def _image(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Projection (k, n, 2) of camera points (k, n, 3), and its derivative (k, n, 2, 3)."""
        z = x[..., 2:]
        flat = x[..., :2] / z
        derivative = np.zeros((*x.shape[:-1], 2, 3))
        derivative[..., 0, 0] = self.focal[0] / z[..., 0]
        derivative[..., 1, 1] = self.focal[1] / z[..., 0]
        derivative[..., :, 2] = -self.focal * flat / z
        return flat * self.focal + self.centre, derivative

    def residuals(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residuals (k, m) of poses (k, 3, 3), (k, 3), and their derivatives (k, m, 6) by (ω, t)."""
        arm = self.corners_m @ rotation.transpose(0, 2, 1)
        image, by_point = self._image(arm + translation[:, None])
        count = len(rotation)
        # d(ω × arm) = −[arm]× ω
        by_pose = np.concatenate([-by_point @ _cross(arm), by_point], axis=-1).reshape(count, 8, 6)
        residual = (self.corners_px - image).reshape(count, 8) @ self.whiten.T
        jacobian = -self.whiten @ by_pose
        if not len(self.sigma):
            return residual, jacobian
        camera = -np.einsum("kji,kj->ki", rotation, translation)
        back = rotation.transpose(0, 2, 1)
        camera_by_pose = np.concatenate([-back @ _cross(translation[:, None])[:, 0], -back], axis=-1)
        height = self.depth + camera[:, 2:]
        travel = camera @ self.along.T - self.offset
        u = self.offset + travel * self.depth / height
        u_by_pose = (self.depth / height)[..., None] * (
            self.along @ camera_by_pose - (travel / height)[..., None] * camera_by_pose[:, 2:3]
        )
        arm = (self.element_m + u[..., None] * self.along) @ back
        axis = self.along @ back
        image, by_point = self._image(arm + translation[:, None])
        slope = (by_point @ axis[..., None])[..., 0]
        direction = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
        by_pose = (
            np.concatenate([-by_point @ _cross(arm), by_point], axis=-1) + slope[..., None] * u_by_pose[:, :, None]
        )
        pull = ((self.blobs_px - image) * direction).sum(-1) / self.sigma
        by_pose = -(direction[..., None] * by_pose).sum(-2) / self.sigma[:, None]
        return np.concatenate([residual, pull], axis=1), np.concatenate([jacobian, by_pose], axis=1)

    def minimise(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Levenberg–Marquardt on all starts at once: poses and chi-square (k,)."""
        damping = np.full(len(rotation), 1e-3)
        residual, jacobian = self.residuals(rotation, translation)
        cost = (residual**2).sum(1)
        active = np.isfinite(cost)
        for _ in range(MAX_ITERATIONS):
            if not active.any():
                break
            a = np.flatnonzero(active)
            normal = jacobian[a].transpose(0, 2, 1) @ jacobian[a]
            diagonal = np.einsum("kii->ki", normal)
            diagonal *= 1 + damping[a, None]
            step = -np.linalg.solve(normal, (jacobian[a].transpose(0, 2, 1) @ residual[a][..., None]))[..., 0]
            turned = _exponential(step[:, :3]) @ rotation[a]
            moved = translation[a] + step[:, 3:]
            trial, slope = self.residuals(turned, moved)
            new = np.where(moved[:, 2] > 0, (trial**2).sum(1), np.inf)
            better = new < cost[a]
            settled = np.abs(cost[a] - new) < 1e-6 * (1 + cost[a])
            up = a[better]
            rotation[up], translation[up], cost[up] = turned[better], moved[better], new[better]
            residual[up], jacobian[up] = trial[better], slope[better]
            damping[a] = np.where(better, damping[a] / 10, damping[a] * 10)
            active[a[settled | (damping[a] > 1e8)]] = False
        return rotation, translation, cost


def _cross(v: FloatArray) -> FloatArray:
    """Matrices [v]× (..., 3, 3) of vectors (..., 3)."""
    out = np.zeros((*v.shape, 3))
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def _exponential(omega: FloatArray) -> FloatArray:
    """Rotation matrices (k, 3, 3) of rotation vectors (k, 3), by Rodrigues's formula."""
    angle = np.linalg.norm(omega, axis=1)[:, None, None]
    k = _cross(omega)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


def _starts(features: Features, marker: MarkerDesign, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Poses to start from: both of IPPE, both of weak perspective, and the one the blobs point at."""
    assert features.corners_px is not None
    half = marker.aruco_m / 2
    inverse = np.linalg.inv(camera.matrix)
    matrix = homography(features.corners_px)
    plane = inverse @ matrix / (half, half, 1)
    plane /= plane[2, 2]
    # Image slopes at the marker's centre, in tangents of the field angle per metre.
    slope = plane[:2, :2] - plane[:2, 2:] * plane[2, :2]
    sight = np.append(plane[:2, 2], 1.0)
    turns, singular, axes = np.linalg.svd(slope)
    translation = sight / singular[0]
    found: list[tuple[FloatArray, FloatArray]] = []
    tilt = max(float(np.arccos(np.clip(singular[1] / singular[0], -1, 1))), 0.1)
    for sign in (-1, 1):
        found.append((_tilted(turns, axes, sign * tilt, sight), translation))
    towards = _camera_direction(features, marker, matrix, float(translation[2]))
    if towards is not None:
        found.append((_facing(towards, slope[:, 0], sight), translation))
    points = cv2.solvePnPGeneric(
        marker.corners_m, features.corners_px.reshape(-1, 1, 2), camera.matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    for rotation_vector, at in zip(points[1], points[2], strict=True):
        if np.isfinite(rotation_vector).all() and np.isfinite(at).all():
            rotation = cv2.Rodrigues(rotation_vector)[0]
            if faces_camera(rotation, at.ravel()):
                found.append((rotation, at.ravel()))
    return np.array([r for r, _ in found]), np.array([t for _, t in found])


def _tilted(turns: FloatArray, axes: FloatArray, tilt: float, sight: FloatArray) -> FloatArray:
    """Attitude under weak perspective: slopes = turns · diag(1, cos tilt) · axes, tilted about the long axis."""
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    left, right = np.eye(3), np.eye(3)
    left[:2, :2], right[:2, :2] = turns, axes
    # One reflection is left over, as the marker's y points up: the third axis takes it.
    left[2, 2] = np.linalg.det(turns)
    right[2, 2] = np.linalg.det(axes)
    return _onto(sight) @ left @ about_x @ right


def _onto(sight: FloatArray) -> FloatArray:
    """Smallest rotation that takes the optical axis to a line of sight."""
    unit = sight / np.linalg.norm(sight)
    axis = np.cross([0.0, 0.0, 1.0], unit)
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, unit[2])
    return _exponential((axis / sine * angle if sine > 0 else axis)[None])[0]


def _camera_direction(
    features: Features, marker: MarkerDesign, matrix: FloatArray, range_m: float
) -> FloatArray | None:
    """Camera in the marker frame (3,) [m] from one blob of each direction, where there are, for a height above the plane."""
    back = np.linalg.inv(matrix)
    place = np.array([np.nan, np.nan, range_m])
    for element in marker.elements:
        blob = features.blobs_px.get(element.name)
        if blob is not None:
            flat = back @ np.append(blob, 1.0)
            axis = int(abs(element.along[1]) > 0.5)
            travel = flat[axis] / flat[2] * marker.aruco_m / 2 - element.virtual_offset_m
            place[axis] = element.virtual_offset_m + travel * (1 + range_m / element.virtual_depth_m)
    return place if np.isfinite(place).all() else None


def _facing(towards: FloatArray, slope_x: FloatArray, sight: FloatArray) -> FloatArray:
    """Attitude that turns the marker's direction `towards` to the camera and its x axis along an image direction."""
    unit = sight / np.linalg.norm(sight)
    return (
        _basis(-unit, np.append(slope_x, 0.0)) @ _basis(towards / np.linalg.norm(towards), np.array([1.0, 0.0, 0.0])).T
    )


def _basis(first: FloatArray, second: FloatArray) -> FloatArray:
    """Right-handed orthonormal columns: a unit vector, then another made perpendicular to it."""
    beside = second - (second @ first) * first
    beside /= np.linalg.norm(beside)
    return np.column_stack([first, beside, np.cross(first, beside)])
