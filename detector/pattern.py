"""The printed pattern as the camera sees it: analytic image of the ArUco and its ring through a homography.

Plane coordinates are in half ArUco sides: x right, y up, the ArUco's corners at ±1. The blur of lens and pixel is
taken as one Gaussian of the same variance, σ² + 1/12 px²; carried into the plane it is a Gaussian again, whose
covariance has a small off-diagonal term when the marker is skewed. With that term to first order, the image of a
chequered plane is a bilinear form of one-dimensional edge responses.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

#: Corners of the ArUco in plane coordinates, top left first, clockwise.
SQUARE = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])


def kernel_sigma_px(psf_sigma_px: float) -> float:
    """Standard deviation of point spread and pixel box together [px]; the box of one pixel has variance 1/12."""
    return float(np.sqrt(psf_sigma_px**2 + 1 / 12))


def homography(corners_px: FloatArray) -> FloatArray:
    """Plane -> image homography (3, 3), last element 1, through four corners (4, 2) in the order of `SQUARE`."""
    matrix = cv2.getPerspectiveTransform(SQUARE.astype(np.float32), np.asarray(corners_px, np.float32))
    # OpenCV takes float32 points; one Newton step on the exact corners restores the lost digits.
    columns, image = corner_jacobian(matrix)
    step = np.linalg.solve(columns.reshape(8, 8), (np.asarray(corners_px) - image).ravel())
    return matrix + np.append(step, 0.0).reshape(3, 3)


def project(matrix: FloatArray, plane: FloatArray) -> FloatArray:
    """Image positions (..., 2) [px] of plane points (..., 2)."""
    p = plane @ matrix[:, :2].T + matrix[:, 2]
    return p[..., :2] / p[..., 2:]


def corner_jacobian(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives (4, 2, 8) of the corners' images with respect to the first eight elements, and the images (4, 2)."""
    image = project(matrix, SQUARE)
    w = SQUARE @ matrix[2, :2] + matrix[2, 2]
    jacobian = np.zeros((4, 2, 8))
    point = np.column_stack([SQUARE, np.ones(4)]) / w[:, None]
    jacobian[:, 0, :3] = jacobian[:, 1, 3:6] = point
    jacobian[:, :, 6:] = -image[:, :, None] * point[:, None, :2]
    return jacobian, image


class PixelSet:
    """Pixels (n, 2) seen through a homography: plane coordinates and the blur there."""

    def __init__(self, pixels: FloatArray, matrix: FloatArray, sigma_px: float):
        inverse = np.linalg.inv(matrix)
        back = pixels @ inverse[:, :2].T + inverse[:, 2]
        self.pixels = pixels
        self.w = 1.0 / back[:, 2]  # inverse is exact, so this is the projective depth of the forward map
        self.plane = back[:, :2] * self.w[:, None]
        # Inverse Jacobian d(plane)/d(pixel), (n, 2, 2).
        self.jacobian = (inverse[None, :2, :2] - self.plane[:, :, None] * inverse[2, :2]) * self.w[:, None, None]
        jx, jy = self.jacobian[:, 0], self.jacobian[:, 1]
        self.sigma_x = sigma_px * np.sqrt((jx**2).sum(1))
        self.sigma_y = sigma_px * np.sqrt((jy**2).sum(1))
        self.cross = sigma_px**2 * (jx * jy).sum(1)


class Pattern:
    """Reflectance of the ArUco (border included) and its ring as cells between grid lines; nothing outside reflects."""

    def __init__(self, marker: MarkerDesign):
        self.marker = marker
        count = len(marker.bits)
        ring = 1 + 2 * marker.ring_fraction
        self.lines = np.concatenate([[-ring], np.linspace(-1, 1, count + 1), [ring]])
        #: Plane coordinates within which nothing but the pattern and absorber is seen.
        self.reach = 1 + 2 * marker.gap_fraction

    @cached_property
    def cells(self) -> FloatArray:
        """Cells (n, n), first index along x, second along y (both ascending), ring included."""
        return self.with_bits(self.marker.bits)

    @cached_property
    def probes(self) -> FloatArray:
        """Plane points (64, 2): eight on each side along the middle of the ring, then as many along the border's middle."""
        along = np.linspace(-0.85, 0.85, 8)
        middles = 1 + self.marker.ring_fraction, 1 - 1 / len(self.marker.bits)
        ones = np.ones(8)
        top = [np.stack([along, middle * ones], -1) for middle in middles]
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        return np.concatenate([side @ np.linalg.matrix_power(turn, k) for side in top for k in range(4)])

    @staticmethod
    def with_bits(bits: NDArray[np.bool_]) -> FloatArray:
        """Cells of any printed pattern: its bits inside a reflective ring."""
        return np.pad(bits[::-1].T.astype(float), 1, constant_values=1.0)

    def cell_responses(self, seen: PixelSet) -> tuple[FloatArray, FloatArray]:
        """What each column and each row of cells puts into each pixel, (n_pixels, n_cells) twice."""
        x = ndtr((seen.plane[:, :1] - self.lines) / seen.sigma_x[:, None])
        y = ndtr((seen.plane[:, 1:] - self.lines) / seen.sigma_y[:, None])
        return x[:, :-1] - x[:, 1:], y[:, :-1] - y[:, 1:]

    def value_and_gradient(self, seen: PixelSet) -> tuple[FloatArray, FloatArray]:
        """Blurred reflectance (n,) and its gradient in the image (n, 2) [1/px]."""
        zx = (seen.plane[:, :1] - self.lines) / seen.sigma_x[:, None]
        zy = (seen.plane[:, 1:] - self.lines) / seen.sigma_y[:, None]
        edge_x, edge_y = ndtr(zx), ndtr(zy)
        peak_x = _normal_density(zx) / seen.sigma_x[:, None]
        peak_y = _normal_density(zy) / seen.sigma_y[:, None]
        # Second mixed difference of the cells: the corner at (i, j) adds its step to everything right of and above it.
        corners = np.diff(np.diff(np.pad(self.cells, 1), axis=0), axis=1)
        edge_row, peak_row = edge_x @ corners, peak_x @ corners
        value = (edge_row * edge_y + seen.cross[:, None] * peak_row * peak_y).sum(1)
        gradient = np.stack([(peak_row * edge_y).sum(1), (edge_row * peak_y).sum(1)], -1)
        return value, np.einsum("ni,nij->nj", gradient, seen.jacobian)


def _normal_density(z: FloatArray) -> FloatArray:
    return np.exp(-0.5 * z * z) * (1 / np.sqrt(2 * np.pi))


def _cross2(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def pixels_within(
    matrix: FloatArray, reach: float, shape: tuple[int, int], margin_px: float = 0.0, most: int | None = None
) -> FloatArray:
    """Pixel centres (n, 2) of an image of `shape` that lie in the plane's square |x|, |y| <= reach, less a margin [px].

    Of more than `most` pixels, about that many, spread evenly.
    """
    corners = project(matrix, SQUARE * reach)
    low = np.maximum(np.floor(corners.min(0) + min(margin_px, 0)), 0).astype(int)
    high = np.minimum(np.ceil(corners.max(0) - min(margin_px, 0)) + 1, shape[::-1]).astype(int)
    if np.any(high <= low):
        return np.empty((0, 2))
    side = np.roll(corners, -1, 0) - corners
    x, y = np.arange(low[0], high[0]), np.arange(low[1], high[1])[:, None]
    if most is None:
        column, row = (axis.ravel() for axis in np.broadcast_arrays(x, y))
    else:
        area = 0.5 * abs(_cross2(corners[2] - corners[0], corners[3] - corners[1]))
        # Consecutive rows start at different residues, so no row, column or diagonal of edges is left out.
        row, column = np.nonzero((7 * x + 11 * y) % (int(area / most) + 1) == 0)
        column, row = column + low[0], row + low[1]
    pixels = np.stack([column, row], -1).astype(float)
    # Signed distances to the four sides: positive inside, whatever the handedness.
    normal = np.stack([-side[:, 1], side[:, 0]], -1) / np.linalg.norm(side, axis=1, keepdims=True)
    inward = np.sign((corners.mean(0) - corners[0]) @ normal[0]) * normal
    return pixels[(pixels @ inward.T - (corners * inward).sum(1) >= margin_px).all(1)]
