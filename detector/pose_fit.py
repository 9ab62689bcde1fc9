"""Loops of the pose solver: residuals of corners and blobs, Levenberg–Marquardt, and where to start."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from detector.compiled import kernel, solve_scaled
from detector.pattern import homography_through, inverse3, plane_point
from radiometry.geometry import FloatArray

MAX_ITERATIONS = 25
#: Relative change of chi-square that ends a descent.
SETTLED = 1e-6
#: Both starts of IPPE are tilted by this much at least, or a frontal marker's would be one and the same [rad].
LEAST_TILT_RAD = 0.1


class Problem(NamedTuple):
    """Measurements of q quadrilaterals and b blobs, places in the frame whose pose is sought."""

    corners_m: FloatArray  # (q, 4, 3)
    corners_px: FloatArray  # (q, 4, 2)
    whiten: FloatArray  # (q, 8, 8): inverses of the lower Cholesky factors of the corners' covariances
    blobs_px: FloatArray  # (b, 2)
    blob_sigma_px: FloatArray  # (b,)
    place_m: FloatArray  # centre of the blob's marker, (b, 3)
    element_m: FloatArray  # centre of the blob's element from its marker's, (b, 3)
    along: FloatArray  # (b, 3)
    virtual_m: FloatArray  # offset and depth of the virtual line, (b, 2)
    lens_px: FloatArray  # focal lengths and principal point: fx, fy, cx, cy

    @property
    def measurements(self) -> int:
        """Measurements."""
        return 8 * len(self.corners_px) + len(self.blobs_px)


@kernel
def _image(x, by_pose, arm, lens_px):
    """Projection (2,) of a camera point (3,), and its derivatives (2, 6) by (ω, t) where it is R·p + t with R·p = `arm`."""
    image = np.empty(2)
    for axis in range(2):
        flat, focal = x[axis] / x[2], lens_px[axis] / x[2]
        image[axis] = flat * lens_px[axis] + lens_px[2 + axis]
        by_pose[axis, 3:] = 0.0
        by_pose[axis, 3 + axis], by_pose[axis, 5] = focal, -focal * flat
        # d(ω × arm) = −[arm]× ω
        gx, gy, gz = by_pose[axis, 3], by_pose[axis, 4], by_pose[axis, 5]
        by_pose[axis, 0] = gz * arm[1] - gy * arm[2]
        by_pose[axis, 1] = gx * arm[2] - gz * arm[0]
        by_pose[axis, 2] = gy * arm[0] - gx * arm[1]
    return image


@kernel
def residuals(problem, rotation, translation, residual, jacobian):
    """Whitened residuals (m,) of a pose and their derivatives (m, 6) by (ω, t)."""
    by_pose, plain, slope = np.empty((2, 6)), np.empty(8), np.empty((8, 6))
    for q in range(len(problem.corners_px)):
        for k in range(4):
            arm = _times(rotation, problem.corners_m[q, k])
            image = _image(arm + translation, by_pose, arm, problem.lens_px)
            for axis in range(2):
                plain[2 * k + axis] = problem.corners_px[q, k, axis] - image[axis]
                slope[2 * k + axis] = -by_pose[axis]
        for i in range(8):
            row = 8 * q + i
            residual[row], jacobian[row] = 0.0, 0.0
            for j in range(i + 1):
                residual[row] += problem.whiten[q, i, j] * plain[j]
                jacobian[row] += problem.whiten[q, i, j] * slope[j]
    camera = -_times(rotation.T, translation)
    camera_by_pose = np.zeros(6)
    for b in range(len(problem.blobs_px)):
        along, (offset, depth) = problem.along[b], problem.virtual_m[b]
        seat = camera - problem.place_m[b]
        # The plane through camera and virtual line cuts the front plane at u = u₀ + (C·along − u₀) V / (V + C_z).
        height = depth + seat[2]
        travel = along[0] * seat[0] + along[1] * seat[1] - offset
        u = offset + travel * depth / height
        axis, normal = _times(rotation, along), rotation[:, 2]
        # C = −Rᵀt moves by Rᵀ(ω × t − δt).
        for j in range(3):
            camera_by_pose[3 + j] = -depth / height * (axis[j] - travel / height * normal[j])
        for j in range(3):
            a, c = (j + 1) % 3, (j + 2) % 3
            camera_by_pose[j] = camera_by_pose[3 + a] * translation[c] - camera_by_pose[3 + c] * translation[a]
        arm = _times(rotation, problem.place_m[b] + problem.element_m[b] + u * along)
        point = arm + translation
        image = _image(point, by_pose, arm, problem.lens_px)
        along_px = np.empty(2)
        for k in range(2):
            along_px[k] = problem.lens_px[k] / point[2] * (axis[k] - point[k] / point[2] * axis[2])
        length = math.hypot(along_px[0], along_px[1])
        row = 8 * len(problem.corners_px) + b
        residual[row], jacobian[row] = 0.0, 0.0
        for k in range(2):
            part = along_px[k] / length / problem.blob_sigma_px[b]
            residual[row] += part * (problem.blobs_px[b, k] - image[k])
            jacobian[row] -= part * (by_pose[k] + along_px[k] * camera_by_pose)


@kernel
def _times(matrix, vector):
    """Product of a (3, 3) matrix and a vector (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]
    return out


@kernel
def minimise(problem, count, rotations, translations, cost):
    """Levenberg–Marquardt from each start, rotations (k, 3, 3) and translations (k, 3) in place; chi-square in `cost` (k,)."""
    residual, jacobian, step = np.empty(count), np.empty((count, 6)), np.empty(6)
    trial, slope = np.empty(count), np.empty((count, 6))
    normal, rhs = np.empty((6, 6)), np.empty(6)
    for k in range(len(cost)):
        rotation, translation, damping = rotations[k], translations[k], 1e-3
        residuals(problem, rotation, translation, residual, jacobian)
        cost[k] = (residual * residual).sum()
        for _ in range(MAX_ITERATIONS):
            for i in range(6):
                rhs[i] = -(jacobian[:, i] * residual).sum()
                for j in range(6):
                    normal[i, j] = (jacobian[:, i] * jacobian[:, j]).sum()
            if not (math.isfinite(cost[k]) and solve_scaled(normal, rhs, damping, step)):
                cost[k] = np.inf
                break
            turned = np.empty((3, 3))
            turn = exponential(step[:3])
            for j in range(3):
                turned[:, j] = _times(turn, rotation[:, j])
            moved = translation + step[3:]
            new = np.inf
            if moved[2] > 0:
                residuals(problem, turned, moved, trial, slope)
                new = (trial * trial).sum()
            settled = abs(cost[k] - new) < SETTLED * (1 + cost[k])
            if new < cost[k]:
                rotation[:], translation[:], residual[:], jacobian[:], cost[k] = turned, moved, trial, slope, new
                damping /= 10
            else:
                damping *= 10
            if settled or damping > 1e8:
                break


@kernel
def exponential(omega):
    """Rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues's formula."""
    angle = math.sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2)
    sine = math.sin(angle) / angle if angle > 1e-8 else 1.0
    versine = 2 * (math.sin(angle / 2) / angle) ** 2 if angle > 1e-8 else 0.5
    x, y, z = omega
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.eye(3)
    for i in range(3):
        out[i] += sine * cross[i] + versine * _times(cross.T, cross[i])
    return out


@kernel
def first_poses(problem, half_m, rotations, translations) -> int:
    """Poses to start from, as many as it returns: both of IPPE, and the one that blobs along both axes point at.

    IPPE: Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014), from the homography's derivative at
    the marker's centre.
    """
    fx, fy, cx, cy = problem.lens_px
    image = homography_through(problem.corners_px[0])
    plane = image.copy()
    plane[0], plane[1] = (image[0] - cx * image[2]) / fx, (image[1] - cy * image[2]) / fy
    plane[:, 2] *= half_m
    plane /= plane[2, 2]
    sight = np.array([plane[0, 2], plane[1, 2], 1.0])
    slope = np.empty((2, 2))  # of the image, in tangents of the field angle per metre
    for i in range(2):
        for j in range(2):
            slope[i, j] = plane[i, j] - plane[i, 2] * plane[2, j]
    turn = _onto(sight)
    # [I | −v] turn: how a plane square to the line of sight appears.
    b00, b01 = turn[0, 0] - sight[0] * turn[2, 0], turn[0, 1] - sight[0] * turn[2, 1]
    b10, b11 = turn[1, 0] - sight[1] * turn[2, 0], turn[1, 1] - sight[1] * turn[2, 1]
    area = b00 * b11 - b01 * b10
    a00, a01 = (b11 * slope[0, 0] - b01 * slope[1, 0]) / area, (b11 * slope[0, 1] - b01 * slope[1, 1]) / area
    a10, a11 = (b00 * slope[1, 0] - b10 * slope[0, 0]) / area, (b00 * slope[1, 1] - b10 * slope[0, 1]) / area
    # A = Rz(left) diag(s₀, s₁) Rz(right), s₁ negative as the marker's y points up.
    even, odd = math.atan2(a10 - a01, a00 + a11), math.atan2(a10 + a01, a00 - a11)
    large, small = math.hypot(a00 + a11, a10 - a01) / 2, math.hypot(a00 - a11, a10 + a01) / 2
    scale = large + small
    tip = math.acos(min(max((large - small) / scale, math.cos(math.pi - LEAST_TILT_RAD)), 1.0))
    for k in range(2):
        sign = 1.0 if k == 0 else -1.0
        rotations[k] = _product(
            _product(turn, _about_z((even + odd) / 2)), _product(_about_x(sign * tip), _about_z((even - odd) / 2))
        )
        translations[k] = sight / scale
    towards = _camera_direction(problem, image, half_m, 1.0 / scale)
    if not (math.isfinite(towards[0]) and math.isfinite(towards[1])):
        return 2
    across = np.array([slope[0, 0], slope[1, 0], 0.0])
    rotations[2] = _product(_basis(-sight, across), _basis(towards, np.array([1.0, 0.0, 0.0])).T)
    translations[2] = sight / scale
    return 3


@kernel
def _camera_direction(problem, matrix, half_m, range_m):
    """Camera in the marker frame (3,) [m] from the blobs, for a height above the plane; NaN along an axis without any."""
    back, place, weight = inverse3(matrix), np.array([0.0, 0.0, range_m]), np.zeros(2)
    for b in range(len(problem.blobs_px)):
        x, y, _, _, _, _, _ = plane_point(back, problem.blobs_px[b, 0], problem.blobs_px[b, 1])
        axis = 0 if abs(problem.along[b, 0]) > 0.5 else 1
        offset, depth = problem.virtual_m[b]
        known = 1 / problem.blob_sigma_px[b] ** 2
        travel = (x if axis == 0 else y) * half_m - offset
        place[axis] += known * (offset + travel * (1 + range_m / depth))
        weight[axis] += known
    place[:2] /= weight
    return place


@kernel
def _onto(sight):
    """Smallest rotation (3, 3) that takes the optical axis to a line of sight (3,)."""
    x, y = sight[0], sight[1]
    sine = math.hypot(x, y)
    angle = math.atan2(sine, sight[2])
    scale = angle / sine if sine > 0 else 0.0
    return exponential(np.array([-y * scale, x * scale, 0.0]))


@kernel
def _about_z(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@kernel
def _about_x(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


@kernel
def _product(a, b):
    """Product of two (3, 3) matrices."""
    out = np.empty((3, 3))
    for j in range(3):
        out[:, j] = _times(a, b[:, j])
    return out


@kernel
def _basis(first, second):
    """Right-handed orthonormal columns (3, 3): along a vector, then along another made perpendicular to it."""
    out = np.empty((3, 3))
    one = first / math.sqrt((first * first).sum())
    two = second - (second * one).sum() * one
    two /= math.sqrt((two * two).sum())
    out[:, 0], out[:, 1] = one, two
    out[0, 2] = one[1] * two[2] - one[2] * two[1]
    out[1, 2] = one[2] * two[0] - one[0] * two[2]
    out[2, 2] = one[0] * two[1] - one[1] * two[0]
    return out
