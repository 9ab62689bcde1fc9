"""Camera calibration from images of a chessboard: sub-pixel corners by a fit of its edges, then OpenCV's bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from detector.pattern.pattern import kernel_sigma_px
from radiometry.geometry import FloatArray

#: Half the side of the window of a corner's fit, over the distance to the nearest other corner.
WINDOW = 0.4
#: Most pixels of that half side; more tell little beyond the corner's own surroundings.
MAX_HALF_WINDOW_PX = 8
STEPS = 12
#: Largest way of a fit from where OpenCV put the corner [px].
MAX_MOVE_PX = 2.0


@dataclass(frozen=True)
class CameraCalibration:
    """Intrinsics of a camera, with their standard deviations."""

    focal_px: FloatArray
    """Focal length in columns and rows, (2,) [px]."""
    principal_point_px: FloatArray
    """(2,) [px]; pixel centres at whole numbers."""
    distortion: FloatArray
    """Brown–Conrady k1, k2, p1, p2, k3 as OpenCV orders them, (5,)."""
    sigma: FloatArray
    """Standard deviations of focal_px, principal_point_px and distortion, (9,); zero for what was held fixed."""
    rms_px: float
    """Root mean square distance of the corners from where the solution puts them [px]."""
    views: int
    """Images used."""


def chessboard_corners(
    image: ArrayLike, inner_corners: tuple[int, int], psf_sigma_px: float = 0.5
) -> FloatArray | None:
    """Inner corners of a chessboard, (columns · rows, 2) [px], row by row; None where the board is not seen whole.

    OpenCV finds them on the image stretched to 8 bits; each is then fitted at full depth as the crossing of two blurred edges.

    Args:
        image: (H, W), any depth.
        inner_corners: corners where four squares meet, along a row and along a column.
        psf_sigma_px: point spread of the lens, where the fit starts from.

    Raises:
        ValueError: when the image is not two-dimensional.
    """
    frame = np.asarray(image, float)
    if frame.ndim != 2:
        raise ValueError(f"image: shape {frame.shape}, expected (H, W)")
    low, high = np.percentile(frame, (0.5, 99.5))
    if not high > low:
        return None
    eight = np.rint(255 * ((frame - low) / (high - low)).clip(0, 1)).astype(np.uint8)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, rough = cv2.findChessboardCorners(eight, inner_corners, flags=flags)
    if not found:
        return None
    grid = rough.reshape(inner_corners[1], inner_corners[0], 2).astype(float)
    corners = [_crossing(frame, grid, row, column, psf_sigma_px) for row, column in np.ndindex(grid.shape[:2])]
    return None if any(corner is None for corner in corners) else np.array(corners)


def _crossing(frame: np.ndarray, grid: FloatArray, row: int, column: int, psf_sigma_px: float) -> FloatArray | None:
    """Where two edges cross near one corner of the rough grid, or None where they do not.

    Bright and dark meet as a(x) + b(x)·E(n₁·(x−c)/σ)·E(n₂·(x−c)/σ), E the blurred sign, a and b linear in x as the light may fall
    off; Gauss–Newton on c, the edges' directions, the blur and these levels.
    """
    rough = grid[row, column]
    sides = [_along(grid, row, column, axis) for axis in (0, 1)]
    reach = min(float(np.linalg.norm(side)) for side in sides)
    half = int(np.clip(WINDOW * reach, 2, MAX_HALF_WINDOW_PX))
    centre = np.rint(rough).astype(int)
    if (centre < half).any() or (centre + half >= frame.shape[::-1]).any():
        return None
    patch = frame[centre[1] - half : centre[1] + half + 1, centre[0] - half : centre[0] + half + 1]
    y, x = (axis.ravel() for axis in np.mgrid[-half : half + 1, -half : half + 1].astype(float))
    angles = [np.arctan2(side[0], -side[1]) for side in sides]  # of the normals
    state = np.array([*(rough - centre), *angles, kernel_sigma_px(psf_sigma_px)])
    data = patch.ravel()
    for _ in range(STEPS):
        model, by_state = _edges(state, x, y)
        shape = np.stack([model, model * x, model * y, np.ones_like(x), x, y], axis=-1)
        level = np.linalg.lstsq(shape, data, rcond=None)[0]
        contrast = level[0] + level[1] * x + level[2] * y
        columns = np.concatenate([contrast[:, None] * by_state, shape], axis=-1)
        step = np.linalg.lstsq(columns, data - shape @ level, rcond=None)[0][:5]
        state = state + np.clip(step, -0.5, 0.5)
        state[4] = np.clip(state[4], 0.3, half)
        if np.abs(step[:2]).max() < 1e-5:
            break
    moved = state[:2] - (rough - centre)
    return state[:2] + centre if np.linalg.norm(moved) < MAX_MOVE_PX else None


def _along(grid: FloatArray, row: int, column: int, axis: int) -> FloatArray:
    """Step (2,) from a corner of the grid to its neighbours along rows (axis 0: from column to column) or columns."""
    line, at = (grid[row], column) if axis == 0 else (grid[:, column], row)
    low, high = max(at - 1, 0), min(at + 1, len(line) - 1)
    return (line[high] - line[low]) / (high - low)


def _edges(state: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Product of two blurred signs (n,), and its derivatives (n, 5) by corner, both angles and blur."""
    cx, cy, first, second, sigma = state
    signs, by_corner, by_angle, by_sigma = [], [], [], []
    for angle in (first, second):
        cos, sin = np.cos(angle), np.sin(angle)
        off = (x - cx) * cos + (y - cy) * sin
        z = off / sigma
        peak = 2 * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) / sigma
        signs.append(2 * ndtr(z) - 1)
        by_corner.append(-peak[:, None] * np.array([cos, sin]))
        by_angle.append(peak * ((y - cy) * cos - (x - cx) * sin))
        by_sigma.append(-peak * z)
    corner = by_corner[0] * signs[1][:, None] + by_corner[1] * signs[0][:, None]
    sigma_slope = by_sigma[0] * signs[1] + by_sigma[1] * signs[0]
    by_state = np.column_stack([corner, by_angle[0] * signs[1], by_angle[1] * signs[0], sigma_slope])
    return signs[0] * signs[1], by_state


def calibrate_camera(
    corners_px: Sequence[FloatArray], board_m: FloatArray, size_px: tuple[int, int], distorted: bool = True
) -> CameraCalibration:
    """Intrinsics from several views of one board, by `cv2.calibrateCamera` (Zhang 2000).

    Args:
        corners_px: corners (n, 2) of each view, in the order of the board's.
        board_m: the board's corners (n, 3), z = 0 [m].
        size_px: columns and rows of the images.
        distorted: solve k1, k2, p1, p2 as well; otherwise the lens is taken to have none. k3 is always zero.

    Raises:
        ValueError: for fewer than three views, or views that OpenCV cannot solve.
    """
    if len(corners_px) < 3:
        raise ValueError(f"corners_px: {len(corners_px)} views, expected three or more of the whole board")
    flags = cv2.CALIB_FIX_K3
    if not distorted:
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
    board = [np.asarray(board_m, np.float32)] * len(corners_px)
    image = [np.asarray(corners, np.float32).reshape(-1, 1, 2) for corners in corners_px]
    start = np.eye(3)
    try:
        rms, matrix, lens, _, _, sigma, *_ = cv2.calibrateCameraExtended(
            board, image, size_px, start, np.zeros(5), flags=flags
        )
    except cv2.error as error:
        raise ValueError(f"corners_px: OpenCV finds no camera ({error.err})") from error
    return CameraCalibration(
        focal_px=np.array([matrix[0, 0], matrix[1, 1]]),
        principal_point_px=matrix[:2, 2].copy(),
        distortion=np.ravel(lens)[:5],
        sigma=np.ravel(sigma)[:9],
        rms_px=float(rms),
        views=len(corners_px),
    )
