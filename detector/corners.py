"""Sub-pixel corners: one maximum-likelihood fit of the printed pattern's analytic image to the pixels around the ArUco.

Every edge of the bits, of the border and of the ring pulls on one homography, so the fit comes near the Cramér–Rao
bound, and the inverse of its information matrix is the covariance of the corners. A saturated pixel is a censored
reading: it only says that the model should reach the saturation level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.noise import NoiseModel
from detector.pattern import SQUARE, Pattern, PixelSet, corner_jacobian, homography, pixels_within, project
from radiometry.geometry import FloatArray

#: Most pixels a fit uses; beyond, a large marker's edges are resolved far better than its optics are known.
MAX_PIXELS = 1200
MAX_ITERATIONS = 12
#: What the model of the blur leaves in a corner without any noise, standard deviation [px]: measured on noiseless
#: synthetic frames, 0.001 px at 120 px a side to 0.007 px at 12 px.
MODEL_SIGMA_PX = 0.004
#: A step below this ends the fit [px]; it is far below any corner's standard deviation.
CONVERGED_PX = 2e-3
#: Kernel deviations kept clear of the encoding elements, whose blobs the pattern model does not know.
CLEARANCE_SIGMA = 2.5


@dataclass(frozen=True)
class PatternFit:
    """The pattern fitted to an image; the corners in the marker's own order, top left first, clockwise."""

    matrix: FloatArray  # plane -> image, (3, 3)
    corners_px: FloatArray  # (4, 2)
    covariance_px2: FloatArray  # of the eight coordinates x0, y0, x1, ..., (8, 8)
    white_dn: float  # amplitude: a reflective cell over an absorbing one [DN]
    black_dn: float  # level of an absorbing cell [DN]
    reduced_chi2: float
    unexplained: float  # variance left beyond the noise, over the variance explained
    significance: float  # the pattern's variance in noise standard deviations


def gather(image: np.ndarray, pixels: FloatArray) -> FloatArray:
    """Pixel values (n,) at integer positions (n, 2)."""
    return image[pixels[:, 1].astype(np.intp), pixels[:, 0].astype(np.intp)].astype(float)


def fit_pattern(
    image: np.ndarray,
    pattern: Pattern,
    corners_px: FloatArray,
    sigma_px: float,
    noise: NoiseModel,
    blur_px: float = 0.0,
) -> PatternFit | None:
    """Fit from approximate corners (4, 2); None where it diverges or the pattern leaves the image.

    Corners seen through a blur of `blur_px` may be further off than an edge is wide: then a model blurred as much draws
    them in first. Blurring both sides of an edge alike leaves it where it is.
    """
    if blur_px > sigma_px:
        coarse = _fit(image, pattern, corners_px, float(np.hypot(sigma_px, blur_px)), noise)
        if coarse is None:
            return None
        corners_px = coarse.corners_px
    return _fit(image, pattern, corners_px, sigma_px, noise)


def _fit(
    image: np.ndarray, pattern: Pattern, corners_px: FloatArray, sigma_px: float, noise: NoiseModel
) -> PatternFit | None:
    origin = np.round(corners_px.mean(0))
    matrix = homography(corners_px - origin)
    pixels = _pixels_to_fit(image.shape, pattern, matrix, origin, sigma_px)
    pixels = noise.readable(pixels)
    if len(pixels) < 60:
        return None
    data, noise = gather(image, pixels), noise.at(pixels)
    pixels = pixels - origin
    saturated = data >= noise.saturated_above_dn
    state = _evaluate(pattern, PixelSet(pixels, matrix, sigma_px), matrix, data, saturated, noise, None)
    damping = 1e-3
    for _ in range(MAX_ITERATIONS):
        step = None if state is None else state.step(damping)
        if state is None or step is None:
            return None
        matrix = state.matrix + np.append(step[:8], 0.0).reshape(3, 3)
        if _out_of_shape(matrix, state.matrix):
            return None
        levels = state.white + step[8], state.black + step[9]
        trial = _evaluate(pattern, PixelSet(pixels, matrix, sigma_px), matrix, data, saturated, noise, levels)
        if trial is None or trial.cost > state.cost:
            damping *= 30
            if damping > 1e4:
                break
            continue
        moved = np.abs(project(matrix, SQUARE) - project(state.matrix, SQUARE)).max()
        state, damping = trial, damping / 10
        if moved < CONVERGED_PX:
            break
    return None if state is None else state.finish(origin, len(data))


def _pixels_to_fit(
    shape: tuple[int, ...], pattern: Pattern, matrix: FloatArray, origin: FloatArray, sigma_px: float
) -> FloatArray:
    shift = np.eye(3)
    shift[:2, 2] = origin
    absolute = shift @ matrix
    absolute /= absolute[2, 2]
    clearance = CLEARANCE_SIGMA * sigma_px
    pixels = pixels_within(absolute, pattern.reach, (shape[0], shape[1]), clearance, most=3 * MAX_PIXELS)
    if len(pixels) > MAX_PIXELS:
        # Only pixels near a grid line know where it is.
        seen = PixelSet(pixels - origin, matrix, sigma_px)
        near_x = (np.abs(seen.plane[:, :1] - pattern.lines) < 4 * seen.sigma_x[:, None]).any(1)
        near_y = (np.abs(seen.plane[:, 1:] - pattern.lines) < 4 * seen.sigma_y[:, None]).any(1)
        pixels = pixels[near_x | near_y]
    return pixels[:: len(pixels) // MAX_PIXELS + 1]


@dataclass
class _State:
    matrix: FloatArray
    white: float
    black: float
    cost: float  # minus twice the log-likelihood, up to a constant
    chi2: float
    normal: FloatArray
    rhs: FloatArray
    unexplained: float
    significance: float

    def step(self, damping: float) -> FloatArray | None:
        scale = np.sqrt(np.maximum(np.diag(self.normal), 1e-300))
        scaled = self.normal / np.outer(scale, scale) + damping * np.eye(10)
        try:
            step = np.linalg.solve(scaled, self.rhs / scale) / scale
        except np.linalg.LinAlgError:
            return None
        return step if np.isfinite(step).all() else None

    def finish(self, origin: FloatArray, count: int) -> PatternFit | None:
        scale = np.sqrt(np.maximum(np.diag(self.normal), 1e-300))
        try:
            covariance = np.linalg.inv(self.normal / np.outer(scale, scale)) / np.outer(scale, scale)
        except np.linalg.LinAlgError:
            return None
        reduced = self.chi2 / max(count - 10, 1)
        jacobian, corners = corner_jacobian(self.matrix)
        jacobian = jacobian.reshape(8, 8)
        covariance = jacobian @ covariance[:8, :8] @ jacobian.T * max(1.0, reduced)
        covariance += MODEL_SIGMA_PX**2 * np.eye(8)
        if not (np.isfinite(covariance).all() and (np.diag(covariance) > 0).all()):
            return None
        shift = np.eye(3)
        shift[:2, 2] = origin
        absolute = shift @ self.matrix
        return PatternFit(
            absolute / absolute[2, 2], corners + origin, (covariance + covariance.T) / 2, self.white, self.black, reduced,
            self.unexplained, self.significance,
        )  # fmt: skip


def _out_of_shape(matrix: FloatArray, before: FloatArray) -> bool:
    """A corner behind the camera, or thrown further than half a side in one step."""
    if not np.isfinite(matrix).all() or (SQUARE @ matrix[2, :2] + 1 <= 0.1).any():
        return True
    old = project(before, SQUARE)
    return bool(np.abs(project(matrix, SQUARE) - old).max() > 0.5 * np.abs(np.ptp(old, axis=0)).max())


def _evaluate(
    pattern: Pattern,
    seen: PixelSet,
    matrix: FloatArray,
    data: FloatArray,
    saturated: np.ndarray,
    noise: NoiseModel,
    levels: tuple[float, float] | None,
) -> _State | None:
    value, gradient = pattern.value_and_gradient(seen)
    if levels is None:
        free = ~saturated
        fitted = np.linalg.lstsq(np.column_stack([value[free], np.ones(free.sum())]), data[free], rcond=None)[0]
        if saturated.any():
            fitted[0] = max(fitted[0], noise.saturation_dn - fitted[1])
        levels = float(fitted[0]), float(fitted[1])
    white, black = levels
    if white <= 0:
        return None
    model = black + white * value
    residual = data - model
    # Censored readings: no pull once the model reaches the ceiling.
    limit = noise.saturated_above_dn
    residual[saturated] = np.maximum(limit - model[saturated], 0.0)
    active = ~saturated | (residual > 0)
    variance = noise.variance(np.minimum(model, limit))
    weight = active / variance
    (u, v), (x, y), w = seen.pixels.T, seen.plane.T, seen.w
    # At a fixed pixel, moving the plane under it by the homography's derivative: dm/dh = -(∇m) · d(image)/dh.
    p, q = -white * gradient[:, 0] / w, -white * gradient[:, 1] / w
    along = p * u + q * v
    jacobian = np.stack([p * x, p * y, p, q * x, q * y, q, -along * x, -along * y, value, np.ones_like(x)], -1)
    weighted = jacobian * weight[:, None]
    total = float(weight @ residual**2)
    cost = total + float(np.log(variance[~saturated]).sum())
    explained = float(weight @ (model - (weight @ model) / max(weight.sum(), 1e-300)) ** 2)
    unexplained = max(total - np.count_nonzero(active), 0.0) / explained if explained > 0 else np.inf
    return _State(
        matrix,
        white,
        black,
        cost,
        total,
        weighted.T @ jacobian,
        weighted.T @ residual,
        unexplained,
        float(np.sqrt(explained)),
    )
