"""Loops of the pose solver: residuals of corners and blobs, Levenberg–Marquardt, and where to start."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from detector.compiled import inlined, kernel, solve_scaled
from detector.pattern.pattern import homography_through, inverse3, plane_point
from radiometry.geometry import FloatArray

MAX_ITERATIONS = 25
#: Relative change of chi-square that ends a descent.
SETTLED = 1e-5
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


@inlined
def _times(m, x, y, z):
    """Product of a (3, 3) matrix and a vector."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z,
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z,
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z,
    )


@inlined
def _image(lens_px, translation, ax, ay, az, by_pose):
    """Projection of a point, its arm R·p from the origin given, and in `by_pose` its derivatives (2, 6) by (ω, t)."""
    x, y, z = ax + translation[0], ay + translation[1], az + translation[2]
    fx, fy = lens_px[0] / z, lens_px[1] / z
    gz, hz = -fx * x / z, -fy * y / z
    # d(ω × arm) = −[arm]× ω
    by_pose[0, 0], by_pose[0, 1], by_pose[0, 2] = gz * ay, fx * az - gz * ax, -fx * ay
    by_pose[0, 3], by_pose[0, 4], by_pose[0, 5] = fx, 0.0, gz
    by_pose[1, 0], by_pose[1, 1], by_pose[1, 2] = hz * ay - fy * az, -hz * ax, fy * ax
    by_pose[1, 3], by_pose[1, 4], by_pose[1, 5] = 0.0, fy, hz
    return fx * x + lens_px[2], fy * y + lens_px[3]


@kernel
def residuals(problem, rotation, translation, residual, jacobian):
    """Whitened residuals (m,) of a pose and their derivatives (m, 6) by (ω, t)."""
    lens_px, r = problem.lens_px, rotation
    by_pose, plain, slope = np.empty((2, 6)), np.empty(8), np.empty((8, 6))
    for q in range(len(problem.corners_px)):
        for k in range(4):
            place = problem.corners_m[q, k]
            ax, ay, az = _times(r, place[0], place[1], place[2])
            u, v = _image(lens_px, translation, ax, ay, az, by_pose)
            plain[2 * k], plain[2 * k + 1] = problem.corners_px[q, k, 0] - u, problem.corners_px[q, k, 1] - v
            for c in range(6):
                slope[2 * k, c], slope[2 * k + 1, c] = -by_pose[0, c], -by_pose[1, c]
        for i in range(8):
            row = 8 * q + i
            residual[row] = 0.0
            for c in range(6):
                jacobian[row, c] = 0.0
            for j in range(i + 1):
                part = problem.whiten[q, i, j]
                residual[row] += part * plain[j]
                for c in range(6):
                    jacobian[row, c] += part * slope[j, c]
    tx, ty, tz = translation
    # The camera in the marker's frame, C = −Rᵀt.
    camera_x = -(r[0, 0] * tx + r[1, 0] * ty + r[2, 0] * tz)
    camera_y = -(r[0, 1] * tx + r[1, 1] * ty + r[2, 1] * tz)
    camera_z = -(r[0, 2] * tx + r[1, 2] * ty + r[2, 2] * tz)
    for b in range(len(problem.blobs_px)):
        along, place, element = problem.along[b], problem.place_m[b], problem.element_m[b]
        offset, depth = problem.virtual_m[b]
        # The plane through camera and virtual line cuts the front plane at u = u₀ + (C·along − u₀) V / (V + C_z).
        height = depth + camera_z - place[2]
        travel = along[0] * (camera_x - place[0]) + along[1] * (camera_y - place[1]) - offset
        u = offset + travel * depth / height
        ex, ey, ez = _times(r, along[0], along[1], along[2])
        # C moves by Rᵀ(ω × t − δt), and u by its part along the element less what it gains in height.
        rate, lift = depth / height, travel / height
        mx, my, mz = -rate * (ex - lift * r[0, 2]), -rate * (ey - lift * r[1, 2]), -rate * (ez - lift * r[2, 2])
        ax, ay, az = _times(
            r,
            place[0] + element[0] + u * along[0],
            place[1] + element[1] + u * along[1],
            place[2] + element[2] + u * along[2],
        )
        seen_u, seen_v = _image(lens_px, translation, ax, ay, az, by_pose)
        z = az + tz
        px, py = lens_px[0] / z * (ex - (ax + tx) / z * ez), lens_px[1] / z * (ey - (ay + ty) / z * ez)
        scale = 1 / (math.sqrt(px * px + py * py) * problem.blob_sigma_px[b])
        row = 8 * len(problem.corners_px) + b
        residual[row] = scale * (px * (problem.blobs_px[b, 0] - seen_u) + py * (problem.blobs_px[b, 1] - seen_v))
        slide = px * px + py * py  # how the image moves as u does, along the element's image
        moves = (my * tz - mz * ty, mz * tx - mx * tz, mx * ty - my * tx, mx, my, mz)
        for c in range(6):
            jacobian[row, c] = -scale * (px * by_pose[0, c] + py * by_pose[1, c] + slide * moves[c])


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
                rhs[i] = 0.0
                for m in range(count):
                    rhs[i] -= jacobian[m, i] * residual[m]
                for j in range(i + 1):
                    total = 0.0
                    for m in range(count):
                        total += jacobian[m, i] * jacobian[m, j]
                    normal[i, j] = normal[j, i] = total
            if not (math.isfinite(cost[k]) and solve_scaled(normal, rhs, damping, step)):
                cost[k] = np.inf
                break
            turned = _product(exponential(step[:3]), rotation)
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
        for j in range(3):
            square = cross[i, 0] * cross[0, j] + cross[i, 1] * cross[1, j] + cross[i, 2] * cross[2, j]
            out[i, j] += sine * cross[i, j] + versine * square
    return out


@kernel
def first_poses(problem, half_m, rotations, translations) -> None:
    """Both poses (2, 3, 3) and (2, 3) to start from.

    They are those of IPPE; or the one that blobs along both axes point at, and the one of IPPE's that is further from it.

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
        return
    across = np.array([slope[0, 0], slope[1, 0], 0.0])
    pointed = _product(_basis(-sight, across), _basis(towards, np.array([1.0, 0.0, 0.0])).T)
    # The nearer one would only lead to the same minimum: that with the larger trace of Rᵀ R'.
    nearer = 0 if (rotations[0] * pointed).sum() > (rotations[1] * pointed).sum() else 1
    rotations[nearer] = pointed


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
        out[0, j], out[1, j], out[2, j] = _times(a, b[0, j], b[1, j], b[2, j])
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
