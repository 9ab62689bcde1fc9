"""Pose from points, many scenes at once: refinement, the two-start solver, and OpenCV's solvers behind one signature.

Every solver takes points (n, m, 3) [m] in the marker frame, pixels (n, m, 2), visible (n, m) and a camera, and returns
rotations (n, 3, 3) and translations (n, 3) [m], marker to camera; NaN where it found no pose.

References:
----------
Terzakis and Lourakis, "A consistently fast and globally optimal solution to the PnP problem" (SQPnP), ECCV 2020.
Collins and Bartoli, "Infinitesimal plane-based pose estimation" (IPPE), IJCV 109 (2014) 252-286.
Schweighofer and Pinz, "Robust pose estimation from a planar target", IEEE PAMI 28 (2006) 2024-2030: the two minima.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from detector.pnp.epnp import BoolArray, Poses, epnp
from detector.pnp.posit import posit
from radiometry.geometry import FloatArray
from radiometry.optics import Camera

Solver = Callable[[FloatArray, FloatArray, BoolArray, Camera], Poses]

#: Scenes refined at a time: what fits a core's cache.
_CHUNK = 1024
_STEPS = 20
#: A step below this change of the pose [rad and fraction of range] is the last.
_CONVERGED = 1e-9


def geodesic_angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles |log(aᵀ b)| between rotations (n, 3, 3), (n,) [rad]."""
    relative = np.swapaxes(a, 1, 2) @ b
    axis = np.stack(
        [
            relative[:, 2, 1] - relative[:, 1, 2],
            relative[:, 0, 2] - relative[:, 2, 0],
            relative[:, 1, 0] - relative[:, 0, 1],
        ],
        1,
    )
    return np.arctan2(np.linalg.norm(axis, axis=1) / 2, (np.trace(relative, axis1=1, axis2=2) - 1) / 2)


def squared_error(
    points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera, poses: Poses
) -> FloatArray:
    """Sum of squared reprojection errors (n,) [px²]; infinite where a visible point lies behind the camera."""
    rotation, translation = poses
    there = points_m @ np.swapaxes(rotation, 1, 2) + translation[:, None]
    behind = np.any(visible & ~(there[..., 2] > 0), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sum((camera.project(there) - pixels) ** 2, axis=-1)
    return np.where(behind, np.inf, np.sum(np.where(visible, error, 0.0), axis=1))


def refine(
    points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera, poses: Poses
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Levenberg-Marquardt on the reprojection error of n scenes at once: rotations, translations, squared errors (n,) [px²].

    The pose moves by R -> exp(ω) R, t -> t + δ; every scene has a damping of its own. Scenes that start behind the camera
    or without a pose are returned as they came, with an infinite error.
    """
    rotation, translation = poses[0].copy(), poses[1].copy()
    error = np.full(len(points_m), np.inf)
    for first in range(0, len(points_m), _CHUNK):
        part = slice(first, first + _CHUNK)
        rotation[part], translation[part], error[part] = _refine_chunk(
            points_m[part], pixels[part], visible[part], camera, rotation[part], translation[part]
        )
    return rotation, translation, error


def _refine_chunk(
    points: FloatArray,
    pixels: FloatArray,
    visible: BoolArray,
    camera: Camera,
    rotation: FloatArray,
    translation: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    error = squared_error(points, pixels, visible, camera, (rotation, translation))
    damping = np.full(len(points), 1e-3)
    active = np.flatnonzero(np.isfinite(error))
    for _ in range(_STEPS):
        if not active.size:
            break
        p, x, v, r, t = points[active], pixels[active], visible[active], rotation[active], translation[active]
        normal, gradient = _normal_equations(p, x, v, camera, r, t)
        scaled = normal.copy()
        diagonal = np.arange(6)
        scaled[:, diagonal, diagonal] *= 1 + damping[active, None]
        scaled[:, diagonal, diagonal] += 1e-12
        step = np.linalg.solve(scaled, gradient[..., None])[..., 0]
        tried_r = Rotation.from_rotvec(step[:, :3]).as_matrix() @ r
        tried_t = t + step[:, 3:]
        tried = squared_error(p, x, v, camera, (tried_r, tried_t))
        better = tried <= error[active]
        taken = active[better]
        rotation[taken], translation[taken], error[taken] = tried_r[better], tried_t[better], tried[better]
        damping[active] = np.where(better, damping[active] * 0.1, damping[active] * 10)
        size = np.abs(step[:, :3]).max(axis=1) + np.abs(step[:, 3:]).max(axis=1) / np.linalg.norm(t, axis=1)
        active = active[(size > _CONVERGED) & (damping[active] < 1e8)]
    return rotation, translation, error


def _normal_equations(
    points: FloatArray,
    pixels: FloatArray,
    visible: BoolArray,
    camera: Camera,
    rotation: FloatArray,
    translation: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """JᵀJ (n, 6, 6) and Jᵀr (n, 6) of the residual pixels − projection, for (ω, δ)."""
    turned = points @ np.swapaxes(rotation, 1, 2)
    x, y, z = np.moveaxis(turned + translation[:, None], -1, 0)
    residual = np.where(visible[..., None], pixels - camera.project(np.stack([x, y, z], axis=-1)), 0.0)
    rows = []
    for axis, along in ((0, x), (1, y)):
        scale = np.where(visible, camera.focal_px[axis] / z, 0.0)
        direction = np.zeros((*z.shape, 3))
        direction[..., axis] = scale
        direction[..., 2] = -scale * along / z
        # d(ω × Rp) = direction · (ω × Rp) = ω · (Rp × direction)
        rows.append(np.concatenate([np.cross(turned, direction), direction], axis=-1))
    jacobian = np.concatenate(rows, axis=1)
    stacked = np.concatenate([residual[..., 0], residual[..., 1]], axis=1)
    transposed = np.swapaxes(jacobian, 1, 2)
    return transposed @ jacobian, (transposed @ stacked[..., None])[..., 0]


def covariance(
    points_m: FloatArray, sigma_px: FloatArray, visible: BoolArray, camera: Camera, poses: Poses
) -> FloatArray:
    """Covariance (n, 6, 6) of (ω [rad], t [m]) to first order, for `sigma_px` (n,) per image axis: σ² (JᵀJ)⁻¹."""
    normal, _ = _normal_equations(points_m, np.zeros((*points_m.shape[:2], 2)), visible, camera, *poses)
    return np.linalg.inv(normal) * sigma_px[:, None, None] ** 2


def mirrored(poses: Poses) -> Poses:
    """The pose a distant camera can hardly tell from this one: the points reflected through a plane across the line of sight.

    X -> (1 − 2 v vᵀ) X for the unit vector v along t, and z -> −z on the marker to stay a rotation.
    """
    rotation, translation = poses
    sight = translation / np.linalg.norm(translation, axis=1, keepdims=True)
    reflection = np.eye(3) - 2 * sight[:, :, None] * sight[:, None, :]
    return reflection @ rotation @ np.diag([1.0, 1.0, -1.0]), translation


def epnp_refined(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """EPnP, then Levenberg-Marquardt from that one start."""
    return refine(points_m, pixels, visible, camera, epnp(points_m, pixels, visible, camera))[:2]


def opencv_solver(flag: int, fewest_points: int = 4) -> Solver:
    """One of OpenCV's solvers (`cv2.SOLVEPNP_...`), called once for each scene, as a batched one."""

    def solve(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
        matrix = camera.matrix
        rotation, translation = np.full((len(points_m), 3, 3), np.nan), np.full((len(points_m), 3), np.nan)
        for i in np.flatnonzero(visible.sum(axis=1) >= fewest_points):
            seen = visible[i]
            try:
                found, vector, offset = cv2.solvePnP(points_m[i, seen], pixels[i, seen], matrix, None, flags=flag)
            except cv2.error:  # OpenCV throws where a decomposition fails: no pose
                continue
            if found:
                rotation[i], translation[i] = cv2.Rodrigues(vector)[0], offset[:, 0]
        return rotation, translation

    return solve


sqpnp = opencv_solver(cv2.SOLVEPNP_SQPNP)
opencv_epnp = opencv_solver(cv2.SOLVEPNP_EPNP)
iterative = opencv_solver(cv2.SOLVEPNP_ITERATIVE, fewest_points=6)


def two_start(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """SQPnP refined, its mirror pose refined, and of these the smaller reprojection error before the camera.

    Any points from four on, coplanar or not. POSIT starts where SQPnP refuses: OpenCV's asks for a variance of the image points
    that a 10 cm marker no longer has at 20 m, and there scaled orthography is all but exact.
    """
    start_r, start_t = sqpnp(points_m, pixels, visible, camera)
    lost = np.isnan(start_t[:, 0]) & (visible.sum(axis=1) >= 4)
    if lost.any():
        start_r[lost], start_t[lost] = posit(points_m[lost], pixels[lost], visible[lost], camera)
    r, t, error = refine(points_m, pixels, visible, camera, (start_r, start_t))
    return _better((r, t), error, refine(points_m, pixels, visible, camera, mirrored((r, t))))


def _better(poses: Poses, error: FloatArray, other: tuple[FloatArray, FloatArray, FloatArray]) -> Poses:
    """Of two sets of refined poses the ones of smaller error; NaN where both are infinite."""
    (r, t), (other_r, other_t, other_error) = poses, other
    better, lost = other_error < error, ~np.isfinite(np.minimum(error, other_error))
    r[better], t[better] = other_r[better], other_t[better]
    r[lost], t[lost] = np.nan, np.nan
    return r, t


def ippe_refined(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """Both of OpenCV's IPPE poses of coplanar points, each refined; the smaller reprojection error wins."""
    n = len(points_m)
    starts = np.full((2, n, 3, 3), np.nan), np.full((2, n, 3), np.nan)
    matrix = camera.matrix
    for i in np.flatnonzero(visible.sum(axis=1) >= 4):
        seen = visible[i]
        found = cv2.solvePnPGeneric(points_m[i, seen], pixels[i, seen], matrix, None, flags=cv2.SOLVEPNP_IPPE)
        for k, (vector, offset) in enumerate(zip(found[1][:2], found[2][:2], strict=True)):
            starts[0][k, i], starts[1][k, i] = cv2.Rodrigues(vector)[0], offset[:, 0]
    r, t, error = refine(points_m, pixels, visible, camera, (starts[0][0], starts[1][0]))
    return _better((r, t), error, refine(points_m, pixels, visible, camera, (starts[0][1], starts[1][1])))
