"""POSIT and SoftPOSIT: pose by iterated scaled orthography, with known and with unknown correspondences.

References:
----------
[1] DeMenthon and Davis, "Model-based object pose in 25 lines of code", IJCV 15 (1995) 123-141.
[2] Oberkampf, DeMenthon and Davis, "Iterative pose estimation using coplanar feature points", CVIU 63 (1996) 495-511.
[3] David, DeMenthon, Duraiswami and Samet, "SoftPOSIT", IJCV 59 (2004) 259-284.
"""

from __future__ import annotations

import numpy as np

from detector.pnp.epnp import BoolArray, Poses
from radiometry.geometry import FloatArray
from radiometry.optics import Camera

_STEPS = 60
#: β at the start over the inverse mean squared image radius, and steps of annealing.
_FIRST_BETA, _ANNEALING_STEPS = 8.0, 150


def posit(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """Poses of n scenes [1], for coplanar points by the two branches of [2]; arguments and result as in `detector.pnp.pnp`.

    The fit runs over all visible points about their centroid. A branch is followed to its end; the smaller reprojection
    error wins.
    """
    weight = visible / visible.sum(axis=1, keepdims=True)
    centre = np.einsum("nm,nmi->ni", weight, points_m)
    offset = (points_m - centre[:, None]) * visible[..., None]
    image = (pixels - camera.principal_point_px) / camera.focal_px
    _, singular, axes = np.linalg.svd(offset, full_matrices=False)
    planar = singular[:, 2] < 1e-6 * singular[:, 0]
    normal = axes[:, 2] * planar[:, None]
    inverse = np.linalg.pinv(offset, rcond=1e-6)
    best, rotation, translation = (
        np.full(len(offset), np.inf),
        np.zeros((len(offset), 3, 3)),
        np.zeros((len(offset), 3)),
    )
    for branch in (1.0, -1.0):
        r, t = _iterate(offset, image, weight, inverse, normal, branch)
        t = t - np.einsum("nij,nj->ni", r, centre)
        there = points_m @ np.swapaxes(r, 1, 2) + t[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sum(np.where(visible, np.sum((camera.project(there) - pixels) ** 2, axis=-1), 0), axis=1)
        better = error < best
        best[better], rotation[better], translation[better] = error[better], r[better], t[better]
    lost = ~np.isfinite(best)
    rotation[lost], translation[lost] = np.nan, np.nan
    return rotation, translation


def _iterate(
    offset: FloatArray, image: FloatArray, weight: FloatArray, inverse: FloatArray, normal: FloatArray, branch: float
) -> Poses:
    depth_ratio = np.zeros(offset.shape[:2])
    for _ in range(_STEPS):
        scaled = image * (1 + depth_ratio)[..., None]
        origin = np.einsum("nm,nmi->ni", weight, scaled)
        i, j = np.moveaxis(inverse @ (scaled - origin[:, None]), -1, 0)
        i, j = _out_of_plane(i, j, normal, branch)
        rotation, scale = _orthonormal(i, j)
        depth_ratio = (offset @ rotation[:, 2, :, None])[..., 0] * scale[:, None]
    return rotation, np.concatenate([origin, np.ones((len(origin), 1))], axis=1) / scale[:, None]


def _out_of_plane(i: FloatArray, j: FloatArray, normal: FloatArray, branch: float) -> Poses:
    """Add λ and μ along the normal of coplanar points so that i ⊥ j and |i| = |j|: (λ + i μ)² = −z for complex z [2]."""
    difference = np.sum(j**2 - i**2, axis=1)
    root = np.sqrt(difference - 2j * np.sum(i * j, axis=1)) * branch
    return i + root.real[:, None] * normal, j + root.imag[:, None] * normal


def _orthonormal(i: FloatArray, j: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation with the two rows nearest to i and j, and the scale f/Z they share."""
    scale = np.sqrt(np.linalg.norm(i, axis=1) * np.linalg.norm(j, axis=1))
    u, _, vt = np.linalg.svd(np.stack([i, j], axis=1), full_matrices=False)
    rows = u @ vt
    return np.concatenate([rows, np.cross(rows[:, 0], rows[:, 1])[:, None]], axis=1), np.maximum(scale, 1e-12)


def softposit(
    points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera, start: Poses
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses and assignments (n, m, m), model point to image point, without given correspondences [3].

    It needs a first pose. Every point must be visible, and every image point belong to the model. Annealing as in [3] by
    1.05 a step, an assignment further than 1 px costs more than none. [3] starts at β = 4e-4 px⁻² for images some hundred
    pixels wide; here the start follows the image's size, or small images would collapse to a point.
    """
    if not visible.all():
        raise ValueError("softposit: every point must be visible")
    n, m, _ = points_m.shape
    focal = float(np.mean(camera.focal_px))
    image = (pixels - camera.principal_point_px) / camera.focal_px * focal
    homogeneous = np.concatenate([points_m, np.ones((n, m, 1))], axis=-1)
    rotation, translation = start[0].copy(), start[1].copy()
    spread = np.mean(np.sum((image - image.mean(axis=1, keepdims=True)) ** 2, axis=-1), axis=1)
    beta = _FIRST_BETA / spread
    match = np.full((n, m, m), 1 / m)
    for _ in range(_ANNEALING_STEPS):
        scale = focal / translation[:, 2]
        rows = np.concatenate([rotation[:, :2], translation[:, :2, None]], axis=2) * scale[:, None, None]
        ratio = (points_m @ rotation[:, 2, :, None])[..., 0] / translation[:, 2, None] + 1
        there = homogeneous @ np.swapaxes(rows, 1, 2)
        distance = np.sum((there[:, :, None] - ratio[:, :, None, None] * image[:, None]) ** 2, axis=-1)
        match = _softassign(-beta[:, None, None] * (distance - 1.0))
        total = match.sum(axis=2)
        system = np.einsum("nm,nmi,nmj->nij", total, homogeneous, homogeneous)
        right = np.einsum("nmk,nm,nkc,nmi->nic", match, ratio, image, homogeneous)
        solved = np.linalg.pinv(system, rcond=1e-9) @ right
        rotation, scale = _orthonormal(solved[:, :3, 0], solved[:, :3, 1])
        translation = np.concatenate([solved[:, 3], np.full((n, 1), focal)], axis=1) / scale[:, None]
        beta = np.minimum(1.05 * beta, 0.5)
    return rotation, translation, match


def _softassign(log_match: FloatArray) -> FloatArray:
    """Sinkhorn's alternating normalisation with a slack row and column that stand for "no match", (n, m, m)."""
    n, m, _ = log_match.shape
    padded = np.zeros((n, m + 1, m + 1))
    padded[:, :m, :m] = log_match
    padded = np.exp(padded - padded.max(axis=(1, 2), keepdims=True))
    for _ in range(30):
        padded[:, :m] /= padded[:, :m].sum(axis=2, keepdims=True) + 1e-300
        padded[:, :, :m] /= padded[:, :, :m].sum(axis=1, keepdims=True) + 1e-300
    return padded[:, :m, :m]
