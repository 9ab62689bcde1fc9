"""EPnP with Gauss-Newton, vectorised over scenes, from the paper.

Every reference point is a weighted sum of four control points (three for a plane). The projection equations are linear in
the control points' camera coordinates, which therefore lie in the kernel of a matrix M; the kernel's coefficients β follow
from the known distances between control points, and Gauss-Newton on these distances refines them.

Reference
---------
Lepetit, Moreno-Noguer and Fua, "EPnP: an accurate O(n) solution to the PnP problem", IJCV 81 (2009) 155-166.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement, product

import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray
from radiometry.optics import Camera

BoolArray = NDArray[np.bool_]
Poses = tuple[FloatArray, FloatArray]

_GAUSS_NEWTON_STEPS = 10
#: Smallest over largest variance of the points below which they count as a plane.
_PLANAR_RATIO = 1e-8


def epnp(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """Poses of n scenes: rotations (n, 3, 3) and translations (n, 3) [m], marker to camera.

    `points_m` (n, m, 3), `pixels` (n, m, 2), `visible` (n, m): points that are not visible are ignored.
    Control points lie at the centroid and along the principal axes, three of them for coplanar points. Every dimension of
    the kernel is tried and refined, and the smallest reprojection error wins.
    """
    rotation, translation = np.full((len(points_m), 3, 3), np.nan), np.full((len(points_m), 3), np.nan)
    control, planar = _principal_control_points(points_m, visible)
    for chosen, count in ((~planar, 4), (planar, 3)):
        if chosen.any():
            problem = _Problem(points_m[chosen], pixels[chosen], visible[chosen], camera, control[chosen, :count])
            best = _Best(problem)
            for start in problem.starts():
                best.offer(problem.gauss_newton(start))
            rotation[chosen], translation[chosen] = best.rotation, best.translation
    return rotation, translation


def epnp_as_used(
    points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera, gauss_newton: bool = True
) -> Poses:
    """EPnP with the choices of the Matlab routine that the thesis calls, as far as they are known; otherwise as `epnp`.

    It departs from the paper in that the control points stay at the origin and the unit axes, coplanar points or not; that a
    closed form is scaled to the size of the point set; that only the best closed form goes through Gauss-Newton, whose
    result then stands, with the sign for which the control points keep their handedness; and that a fitted orthogonal
    matrix Q becomes −Q where it is a reflection. Without `gauss_newton` the best closed form stands.

    Two of these are fatal for points on z = 0, where the image says nothing about the fourth control point:

    - Gauss-Newton starts it near the camera and leaves it on the camera's side of the plane. Where the z axis points
      away from the camera the handedness is thus wrong, and the pose comes out behind the camera.
    - The fit fixes two columns of Q and the singular value decomposition the sign of the third. With LAPACK's
      Householder reflections, and points spread evenly over the plane, det Q has the sign of sign(r_11) r_22 + r_33 for the true
      rotation r. Where that is negative, Q → −Q turns the pose by 180° about the plane's normal.
    """
    control = np.broadcast_to(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), (len(points_m), 4, 3))
    problem = _Problem(points_m, pixels, visible, camera, control)
    best = _Best(problem, reflect=True)
    for start in problem.starts():
        best.offer(start, rescale=True)
    if not gauss_newton:
        return best.rotation, best.translation
    return problem.pose(problem.gauss_newton(best.beta), rescale=False, by_handedness=True, reflect=True)


def _principal_control_points(points: FloatArray, visible: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Centroid, and one standard deviation along each axis, widest first, (n, 4, 3); which sets are planar (n,)."""
    weight = visible / visible.sum(axis=1, keepdims=True)
    centre = np.einsum("nm,nmi->ni", weight, points)
    offset = points - centre[:, None]
    variance, axes = np.linalg.eigh(np.swapaxes(offset * weight[..., None], 1, 2) @ offset)
    planar = variance[:, 0] < _PLANAR_RATIO * variance[:, 2]
    length = np.sqrt(np.maximum(variance, 1e-300))
    arms = np.swapaxes(axes * length[:, None, :], 1, 2)[:, ::-1]
    return np.concatenate([centre[:, None], centre[:, None] + arms], axis=1), planar


class _Problem:
    """The linear algebra of n scenes with c control points (n, c, 3) and k kernel vectors."""

    def __init__(
        self, points: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera, control: FloatArray
    ) -> None:
        self.points, self.pixels, self.visible, self.camera, self.control = points, pixels, visible, camera, control
        self.weight = visible / visible.sum(axis=1, keepdims=True)
        arms = control[:, 1:] - control[:, :1]
        rest = (points - control[:, :1]) @ np.linalg.pinv(arms)
        self.barycentric = np.concatenate([1 - rest.sum(axis=-1, keepdims=True), rest], axis=-1)  # (n, m, c)
        self.kernel = self._kernel()  # (n, k, c, 3)
        a, b = np.array(list(combinations(range(control.shape[1]), 2))).T
        self.squared = np.sum((control[:, a] - control[:, b]) ** 2, axis=-1)  # (n, pairs)
        edges = self.kernel[:, :, a] - self.kernel[:, :, b]
        self.products = np.einsum("nkpi,nlpi->npkl", edges, edges)

    def _kernel(self) -> FloatArray:
        """Right singular vectors of M, by singular value from the smallest (the paper's equation 7)."""
        n, m, count = self.barycentric.shape
        system = np.zeros((n, 2, m, count, 3))
        weights = np.where(self.visible[..., None], self.barycentric, 0.0)
        offset = np.asarray(self.camera.principal_point_px) - self.pixels
        for axis in (0, 1):
            system[:, axis, :, :, axis] = weights * self.camera.focal_px[axis]
            system[:, axis, :, :, 2] = weights * offset[..., axis, None]
        flat = system.reshape(n, 2 * m, 3 * count)
        _, vectors = np.linalg.eigh(np.swapaxes(flat, 1, 2) @ flat)
        size = 4 if count == 4 else 2  # a plane's three distances fix no more than two coefficients linearly
        return np.swapaxes(vectors[:, :, :size], 1, 2).reshape(n, size, count, 3)

    def starts(self) -> list[FloatArray]:
        """First β (n, k) for an effective kernel of dimension 1, 2, ... (the paper's section 3.3)."""
        n, _, size, _ = self.products.shape
        lengths = np.sqrt(np.maximum(self.products[:, :, 0, 0], 0))
        norm = np.sum(lengths**2, axis=1)
        first = np.zeros((n, size))
        first[:, 0] = np.sum(lengths * np.sqrt(self.squared), axis=1) / np.maximum(norm, 1e-300)
        starts = [first]
        for dimension in range(2, size + 1):
            terms = list(combinations_with_replacement(range(dimension), 2))
            matrix = np.stack([self.products[:, :, k, i] * (1 if k == i else 2) for k, i in terms], axis=-1)
            solution = _relinearised(matrix, self.squared) if dimension == 4 else _least_squares(matrix, self.squared)
            outer = np.zeros((n, dimension, dimension))
            for index, (k, i) in enumerate(terms):
                outer[:, k, i] = outer[:, i, k] = solution[:, index]
            # β is the vector whose outer product comes closest: all signs and magnitudes at once.
            values, vectors = np.linalg.eigh(outer)
            beta = np.zeros((n, size))
            beta[:, :dimension] = vectors[:, :, -1] * np.sqrt(np.maximum(values[:, -1:], 0))
            starts.append(beta)
        return starts

    def gauss_newton(self, beta: FloatArray) -> FloatArray:
        """β (n, k) refined so that the control points keep their distances (the paper's section 3.4)."""
        identity = np.eye(beta.shape[1])
        for _ in range(_GAUSS_NEWTON_STEPS):
            half = np.einsum("npkl,nl->npk", self.products, beta)
            residual = self.squared - np.einsum("npk,nk->np", half, beta)
            normal = 4 * np.swapaxes(half, 1, 2) @ half
            # A trace of damping: the step is undetermined where a coefficient is still zero.
            normal += (1e-10 * np.trace(normal, axis1=1, axis2=2) + 1e-30)[:, None, None] * identity
            beta = beta + np.linalg.solve(normal, 2 * np.einsum("npk,np->nk", half, residual)[..., None])[..., 0]
        return beta

    def pose(self, beta: FloatArray, rescale: bool, by_handedness: bool, reflect: bool) -> Poses:
        """Rotation and translation that carry the points to where β puts them."""
        control = np.einsum("nk,nkci->nci", beta, self.kernel)
        if by_handedness:
            sign = np.sign(np.linalg.det(control[:, 1:] - control[:, :1]))
            sign *= np.sign(np.linalg.det(self.control[:, 1:] - self.control[:, :1]))
        else:
            sign = np.sign(np.einsum("nm,nmc,nc->n", self.weight, self.barycentric, control[..., 2]))
        there = self.barycentric @ (control * np.where(sign < 0, -1.0, 1.0)[:, None, None])
        centre, centre_there = (np.einsum("nm,nmi->ni", self.weight, x) for x in (self.points, there))
        offset, offset_there = self.points - centre[:, None], there - centre_there[:, None]
        if rescale:
            size, size_there = (np.sqrt(np.einsum("nm,nmi->n", self.weight, x**2)) for x in (offset, offset_there))
            ratio = (size / np.maximum(size_there, 1e-300))[:, None]
            centre_there, offset_there = centre_there * ratio, offset_there * ratio[..., None]
        u, _, vt = np.linalg.svd(np.swapaxes(offset_there * self.weight[..., None], 1, 2) @ offset)
        turned = np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)
        if not reflect:
            u[:, :, 2] *= turned[:, None]
        rotation = u @ vt * (turned[:, None, None] if reflect else 1.0)
        return rotation, centre_there - np.einsum("nij,nj->ni", rotation, centre)

    def squared_error(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Sum of squared reprojection errors (n,) [px²]; points behind the camera project as the equations have it."""
        there = self.points @ np.swapaxes(rotation, 1, 2) + translation[:, None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            error = np.sum((self.camera.project(there) - self.pixels) ** 2, axis=-1)
        return np.sum(np.where(self.visible, error, 0.0), axis=1)


class _Best:
    """The solution of smallest reprojection error among those offered."""

    def __init__(self, problem: _Problem, reflect: bool = False) -> None:
        n, size = problem.kernel.shape[:2]
        self.problem, self.reflect = problem, reflect
        self.error = np.full(n, np.inf)
        self.beta = np.zeros((n, size))
        self.rotation, self.translation = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan)

    def offer(self, beta: FloatArray, rescale: bool = False) -> None:
        rotation, translation = self.problem.pose(beta, rescale, by_handedness=False, reflect=self.reflect)
        error = self.problem.squared_error(rotation, translation)
        better = error < self.error
        self.error[better], self.beta[better] = error[better], beta[better]
        self.rotation[better], self.translation[better] = rotation[better], translation[better]


def _least_squares(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Minimum-norm solutions (n, columns) of n systems."""
    return np.einsum("ncr,nr->nc", np.linalg.pinv(matrix), right)


def _relinearised(matrix: FloatArray, squared: FloatArray) -> FloatArray:
    """Ten products β_k β_l (n, 10) from six equations: β_ab β_cd = β_ac β_bd settles the four free directions."""
    particular = _least_squares(matrix, squared)
    basis = np.linalg.svd(matrix)[2][:, 6:]
    unknowns = list(combinations_with_replacement(range(4), 2))
    left, right = [], []
    for (p, q), (r, s) in _commutativity():
        columns = [
            particular[:, p] * basis[:, k, q]
            + particular[:, q] * basis[:, k, p]
            - particular[:, r] * basis[:, k, s]
            - particular[:, s] * basis[:, k, r]
            for k in range(4)
        ]
        for k, i in unknowns:
            once = basis[:, k, p] * basis[:, i, q] - basis[:, k, r] * basis[:, i, s]
            twice = basis[:, i, p] * basis[:, k, q] - basis[:, i, r] * basis[:, k, s]
            columns.append(once if k == i else once + twice)
        left.append(np.stack(columns, axis=-1))
        right.append(particular[:, r] * particular[:, s] - particular[:, p] * particular[:, q])
    free = _least_squares(np.stack(left, axis=1), np.stack(right, axis=1))[:, :4]
    return particular + np.einsum("nk,nkt->nt", free, basis)


def _commutativity() -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Pairs of equal products of products, by place among the ten β_k β_l."""
    place = {}
    for index, (k, i) in enumerate(combinations_with_replacement(range(4), 2)):
        place[k, i] = place[i, k] = index
    equal = set()
    for a, b, c, d in product(range(4), repeat=4):
        one = (min(place[a, b], place[c, d]), max(place[a, b], place[c, d]))
        other = (min(place[a, c], place[b, d]), max(place[a, c], place[b, d]))
        if one < other:
            equal.add((one, other))
    return sorted(equal)
