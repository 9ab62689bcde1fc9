"""The direct least-squares method for pose: every stationary point of the object-space error, by polynomial elimination.

With the rotation as Cayley's C(s) = ((1 − sᵀs) 1 + 2 [s]ₓ + 2 s sᵀ)/(1 + sᵀs), and the translation eliminated, the cost
without its denominator is a quartic in s. Its gradient is three cubics with 27 common roots; they follow from the null
space of all multiples of the cubics up to degree 7, as eigenvectors of multiplication by a linear form.

Reference
---------
Hesch and Roumeliotis, "A direct least-squares (DLS) method for PnP", ICCV 2011, 383-390. The paper finds the roots by a Macaulay
resultant's Schur complement; the null space gives the same roots and needs no choice of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from detector.pnp.epnp import BoolArray, Poses
from radiometry.geometry import FRONTAL, FloatArray
from radiometry.optics import Camera


def _monomials(degree: int) -> list[tuple[int, int, int]]:
    """Exponents of the monomials in three variables up to a degree, by degree."""
    every = range(degree + 1)
    found = [(a, b, c) for a in every for b in every for c in every if a + b + c <= degree]
    return sorted(found, key=lambda e: (sum(e), e))


_SECOND, _FOURTH, _SIXTH, _SEVENTH = (_monomials(d) for d in (2, 4, 6, 7))
_PLACE = {e: i for i, e in enumerate(_SEVENTH)}
_ROOTS = 27


def _times(a: Sequence[int], b: Sequence[int]) -> tuple[int, int, int]:
    return int(a[0] + b[0]), int(a[1] + b[1]), int(a[2] + b[2])


def _cayley() -> FloatArray:
    """(9, 10): row-major entries of (1 + sᵀs) C(s) in the monomials up to degree 2."""
    rows = np.zeros((3, 3, len(_SECOND)))
    unit = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    place = {e: i for i, e in enumerate(_SECOND)}
    for i in range(3):
        rows[i, i, place[0, 0, 0]] = 1
        for k in range(3):
            rows[i, i, place[_times(unit[k], unit[k])]] -= 1
            rows[i, k, place[_times(unit[i], unit[k])]] += 2
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        rows[i, j, place[_times(unit[k], (0, 0, 0))]] = -2
        rows[j, i, place[_times(unit[k], (0, 0, 0))]] = 2
    return rows.reshape(9, -1)


_CAYLEY = _cayley()
#: Where each product of two monomials up to degree 2 stands among those up to degree 4, (10, 10).
_PRODUCT = np.array([[_FOURTH.index(_times(a, b)) for b in _SECOND] for a in _SECOND])


def _gradient_places() -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """Row, column, coefficient of the quartic and factor of every entry of the cubics' multiples."""
    entries = []
    for axis, (row, multiple), (term, exponents) in product(range(3), enumerate(_FOURTH), enumerate(_FOURTH)):
        if exponents[axis]:
            lowered = [power - (k == axis) for k, power in enumerate(exponents)]
            place = _PLACE[_times(lowered, multiple)]
            entries.append((axis * len(_FOURTH) + row, place, term, exponents[axis]))
    row, column, term, factor = np.array(entries).T
    return row, column, term, factor.astype(float)


_ROW, _COLUMN, _TERM, _FACTOR = _gradient_places()
#: The linear form whose eigenvectors are sought: any that tells the roots apart.
_FORM = (0.3, 0.7312, -0.4513, 0.2179)
#: Places of the monomials up to degree 6 after multiplication by s1, s2 and s3.
_SHIFTED = [[_PLACE[_times(e, unit)] for e in _SIXTH] for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
#: Cayley's rotation cannot turn by 180°: the paper's remedy is to start from several attitudes.
_ATTITUDES = FRONTAL @ Rotation.from_rotvec(np.deg2rad(120.0) * np.outer([0, 1, 2], [0, 0, 1])).as_matrix()


def dls(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """Poses of n scenes; arguments and result as in `detector.pnp.pnp`. The least object-space error before the camera wins."""
    bearing = np.concatenate(
        [(pixels - camera.principal_point_px) / camera.focal_px, np.ones((*pixels.shape[:2], 1))], axis=-1
    )
    bearing /= np.linalg.norm(bearing, axis=-1, keepdims=True)
    across = (np.eye(3) - bearing[..., :, None] * bearing[..., None, :]) * visible[..., None, None]
    rotation, translation = np.full((len(points_m), 3, 3), np.nan), np.full((len(points_m), 3), np.nan)
    least = np.full(len(points_m), np.inf)
    for attitude in _ATTITUDES:
        points = points_m @ attitude.T
        # R p = lift · vec(R), so t = eliminate · vec(R) and the cost is vec(R)ᵀ Q vec(R).
        lift = np.einsum("ij,nmk->nmijk", np.eye(3), points).reshape(*points.shape[:2], 3, 9)
        eliminate = -np.linalg.solve(across.sum(axis=1), np.einsum("nmij,nmjk->nik", across, lift))
        residual = lift + eliminate[:, None]
        quadratic = np.einsum("nmji,nmjk,nmkl->nil", residual, across, residual)
        for i in range(len(points)):
            for root in _stationary(quadratic[i]):
                turn = (_CAYLEY @ np.prod(root ** np.array(_SECOND), axis=1)).reshape(3, 3) / (1 + root @ root)
                t = eliminate[i] @ turn.ravel()
                cost = turn.ravel() @ quadratic[i] @ turn.ravel()
                behind = ((points[i, visible[i]] @ turn.T + t)[:, 2] <= 0).any()
                if cost < least[i] and not behind:
                    least[i], rotation[i], translation[i] = cost, turn @ attitude, t
    return rotation, translation


def _stationary(quadratic: FloatArray) -> list[FloatArray]:
    """Real stationary points s (3,) of the quartic."""
    form = _CAYLEY.T @ (quadratic / np.trace(quadratic)) @ _CAYLEY
    quartic = np.bincount(_PRODUCT.ravel(), form.ravel(), len(_FOURTH))
    rows = np.zeros((3 * len(_FOURTH), len(_SEVENTH)))
    rows[_ROW, _COLUMN] = _FACTOR * quartic[_TERM]
    null = np.linalg.svd(rows)[2][-_ROOTS:].T
    shifted = _FORM[0] * null[: len(_SIXTH)] + sum(
        w * null[places] for w, places in zip(_FORM[1:], _SHIFTED, strict=True)
    )
    multiplication = np.linalg.lstsq(null[: len(_SIXTH)], shifted, rcond=None)[0]
    values = null[:4] @ np.linalg.eig(multiplication)[1]  # 1, then s3, s2, s1: the order of `_monomials`
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = (values[[3, 2, 1]] / values[0]).T
    return [r.real for r in roots if np.isfinite(r).all() and np.abs(r.imag).max() < 1e-3 * (1 + np.abs(r).max())]
