"""Sub-pixel corners: one maximum-likelihood fit of the printed pattern's analytic image to the pixels around the ArUco.

Every edge of the bits, of the border and of the ring pulls on one homography, so the fit comes near the Cramér–Rao
bound, and the inverse of its information matrix is the covariance of the corners. A saturated pixel is a censored
reading: it only says that the model should reach the saturation level. Where the light is uneven over the marker, both
levels get a slope along x and along y, and the bright one a curvature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.compiled import BLOCK, add_products, invert_scaled, kernel, mirror, solve_scaled, wide_kernel
from detector.noise import NoiseModel
from detector.pattern import (
    CLEARANCE,
    KNOWING_REACH,
    NOWHERE,
    SQUARE,
    Pattern,
    homography,
    image_of,
    inverse3,
    new_block,
    project,
    see,
    select_pixels,
    shine,
)
from radiometry.geometry import FloatArray

#: Pixels of the descent, which only has to come close, and the most of the last step, which takes all that they know: beyond,
#: edges are resolved far better than the optics are known.
DESCENT_PIXELS, MAX_PIXELS = 250, 6000
#: Iterations of the descent, and last steps, at most.
MAX_ITERATIONS, MAX_LAST_STEPS = 12, 6
#: What the model of blur and light leaves in a corner without any noise, standard deviation: in pixels, and over the ArUco's
#: side. Measured on ray-traced frames at many sub-pixel places: 0.001 px at 12–30 px a side, 0.003 px at 120 px.
MODEL_SIGMA_PX, MODEL_SIGMA_SIDE = 0.0015, 2.5e-5
#: A step below this ends the descent, and makes a last step the last [px]: what it leaves is of second order. So does one that
#: lowers chi-square by little: it is a small part of the noise.
NEAR_PX, LAST_PX, LAST_CHI2 = 0.1, 0.06, 0.5
#: After a longer step, other pixels know where the edges are [px].
ELSEWHERE_PX = 0.5
#: Amplitude of a reflective cell over an absorbing one and level of an absorbing cell, both at the marker's centre [DN]; how
#: either changes by x and y [DN per plane unit]; how the amplitude curves by x², xy and y².
LEVELS = ("white", "black", "white_x", "white_y", "black_x", "black_y", "white_xx", "white_xy", "white_yy")
#: Parameters of a fit under even light, under light that slopes, and under light that curves: homography and levels.
EVEN, SLOPING, CURVED = 10, 14, 17
#: Uneven light is fitted where it lowers chi-square by this much, five standard deviations; curved where the reduced chi-square
#: of sloping light is worse than this, as with the Sun so near the camera's axis that the tape returns it.
UNEVEN_CHI2, CURVED_FROM = 25.0, 1.5
#: What is left unexplained beyond this reduced chi-square is alike over many pixels: it widens the covariance as if so many were
#: one. Measured on ray-traced frames with the Sun 1 to 4 deg behind the camera.
MISFIT_FROM, MISFIT_CORRELATION = 4.0, 10.0


@dataclass(frozen=True)
class Descent:
    """Where a fit ended: homography (3, 3) relative to an origin (2,), information about it and the levels, and result."""

    origin: FloatArray
    matrix: FloatArray
    normal: FloatArray
    result: FloatArray


@dataclass(frozen=True)
class PatternFit:
    """The pattern fitted to an image; the corners in the marker's own order, top left first, clockwise."""

    matrix: FloatArray  # plane -> image, (3, 3)
    corners_px: FloatArray  # (4, 2)
    covariance_px2: FloatArray  # of the eight coordinates x0, y0, x1, ..., (8, 8)
    levels_dn: (
        FloatArray  # see `white_dn` and `black_dn`; then the slopes of either by x and y [DN per plane unit], (6,)
    )
    reduced_chi2: float
    unexplained: float  # variance left beyond the noise, over the variance explained
    significance: float  # the pattern's variance in noise standard deviations
    descent: Descent  # where the fit ended, for `refined`

    @property
    def white_dn(self) -> float:
        """Amplitude at the centre: a reflective cell over an absorbing one [DN]."""
        return float(self.levels_dn[0])

    @property
    def black_dn(self) -> float:
        """Level of an absorbing cell at the centre [DN]."""
        return float(self.levels_dn[1])


@dataclass(frozen=True)
class Samples:
    """Pixels to fit: places relative to an origin, readings, and what is known of their noise."""

    columns: FloatArray
    rows: FloatArray
    data: FloatArray
    saturated: NDArray[np.bool_]
    extra: FloatArray  # variance beyond the noise model's [DN²]
    noise: FloatArray  # see `noise_numbers`


def noise_numbers(noise: NoiseModel) -> FloatArray:
    """Read variance [DN²], gain [DN/e⁻], offset and level of saturation [DN], for the kernels."""
    limit = min(noise.saturated_above_dn, 1e300)
    return np.array([noise.read_noise_dn**2, noise.gain_dn_per_electron, noise.offset_dn, limit])


def gather(image: np.ndarray, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> FloatArray:
    """Pixel values (n,) as real numbers."""
    return np.asarray(image[rows, columns], float)


def sample(
    image: np.ndarray, columns: NDArray[np.int64], rows: NDArray[np.int64], origin: FloatArray, noise: NoiseModel
) -> Samples:
    """Readings of some pixels (n,), without those that say nothing."""
    if noise.extra_variance_dn2 is None:
        extra = np.zeros(len(columns))
    else:
        extra = noise.extra_variance_dn2[rows, columns]
        readable = np.isfinite(extra)
        columns, rows, extra = columns[readable], rows[readable], np.asarray(extra[readable], float)
    data = gather(image, columns, rows)
    saturated = data >= noise.saturated_above_dn
    return Samples(columns - origin[0], rows - origin[1], data, saturated, extra, noise_numbers(noise))


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
    origin = np.round(corners_px.mean(0))
    matrix = homography(corners_px - origin)
    levels = np.zeros(len(LEVELS))
    blurred = float(np.hypot(sigma_px, blur_px))
    for sigma in (blurred, sigma_px) if blur_px > sigma_px else (sigma_px,):
        few = _sample_pattern(image, pattern, matrix, origin, sigma_px, noise, DESCENT_PIXELS)
        if few is None or not _descend(*_arguments(few), sigma, pattern.lines, pattern.cells, matrix, levels):
            return None
    fit = _last_steps(image, pattern, matrix, levels, origin, sigma_px, noise, SLOPING)
    if fit is None or fit.reduced_chi2 < CURVED_FROM:
        return fit
    return _last_steps(image, pattern, matrix, levels, origin, sigma_px, noise, CURVED) or fit


def _last_steps(
    image: np.ndarray,
    pattern: Pattern,
    matrix: FloatArray,
    levels: FloatArray,
    origin: FloatArray,
    sigma_px: float,
    noise: NoiseModel,
    parameters: int,
) -> PatternFit | None:
    """The fit's end from near it, on `matrix` and `levels` in place; None where there is none."""
    normal, result = np.empty((parameters, parameters)), np.empty(4)
    samples = None
    for _ in range(MAX_LAST_STEPS):
        # The same pixels as long as they are near the edges: others would bring other noise, and no end.
        samples = samples or _sample_pattern(image, pattern, matrix, origin, sigma_px, noise, MAX_PIXELS)
        if samples is None:
            return None
        moved_px, gain, count = _last_step(
            *_arguments(samples), sigma_px, pattern.lines, pattern.cells, matrix, levels, normal, result
        )
        if not moved_px >= 0:
            return None
        if moved_px < LAST_PX or gain < LAST_CHI2:
            return _finish(matrix.copy(), levels.copy(), normal[:count, :count].copy(), result, origin)
        if moved_px > ELSEWHERE_PX:
            samples = None
    return None


def _arguments(
    samples: Samples,
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_], FloatArray, FloatArray]:
    return samples.columns, samples.rows, samples.data, samples.saturated, samples.extra, samples.noise


def _sample_pattern(
    image: np.ndarray,
    pattern: Pattern,
    matrix: FloatArray,
    origin: FloatArray,
    sigma_px: float,
    noise: NoiseModel,
    most: int,
) -> Samples | None:
    """The pixels that know where the edges are; None where they are too few."""
    columns, rows = _edge_pixels(image, pattern, moved(matrix, origin), sigma_px, most, NOWHERE, pattern.openings)
    samples = sample(image, columns, rows, origin, noise)
    return samples if len(samples.data) >= 60 else None


def _edge_pixels(
    image: np.ndarray,
    pattern: Pattern,
    matrix: FloatArray,
    sigma_px: float,
    most: int,
    only: FloatArray,
    never: FloatArray,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels near the pattern's edges; see `select_pixels`. They end well inside the marker's outline."""
    height, width = image.shape
    corner = project(matrix, SQUARE[:2] * pattern.outline)
    room_px = math.dist(*corner) * (1 - pattern.ring / pattern.outline) / 2 - CLEARANCE * sigma_px
    margin_px = -min(KNOWING_REACH * sigma_px, room_px)
    columns, rows = select_pixels(
        matrix, pattern.ring, height, width, margin_px, float(most), pattern.lines, sigma_px, only, never
    )
    return columns, rows


def refined(
    fit: PatternFit, image: np.ndarray, pattern: Pattern, blobs: FloatArray, sigma_px: float, noise: NoiseModel
) -> PatternFit:
    """The fit with what the pixels beside the elements know of the ring's outer edge, once it is known where they are bright.

    `blobs` (4, 4): rectangles x0, x1, y0, y1 of the plane that blobs may light.
    """
    start = fit.descent
    columns, rows = _edge_pixels(image, pattern, fit.matrix, sigma_px, MAX_PIXELS, pattern.openings, blobs)
    samples = sample(image, columns, rows, start.origin, noise)
    if not len(samples.data):
        return fit
    matrix, levels, normal, result = start.matrix.copy(), fit.levels_dn.copy(), start.normal.copy(), start.result.copy()
    moved_px = _more(*_arguments(samples), sigma_px, pattern.lines, pattern.cells, matrix, levels, normal, result)
    # Far off, the light is none that the pattern explains.
    found = _finish(matrix, levels, normal, result, start.origin) if 0 <= moved_px < ELSEWHERE_PX else None
    return found or fit


def moved(matrix: FloatArray, origin: FloatArray) -> FloatArray:
    """The homography (3, 3) whose images lie further by `origin` (2,) [px]."""
    absolute = matrix.copy()
    absolute[:2] += origin[:, None] * matrix[2]
    return absolute / absolute[2, 2]


def _finish(
    matrix: FloatArray, levels: FloatArray, normal: FloatArray, result: FloatArray, origin: FloatArray
) -> PatternFit | None:
    _, chi2, active, explained = result
    reduced = float(chi2 / max(active - len(normal), 1))
    corners, joint = np.empty((4, 2)), np.empty((8, 8))
    misfit = MISFIT_CORRELATION * max(reduced - MISFIT_FROM, 0.0)
    if not _corner_covariance(matrix, normal, max(1.0, reduced) + misfit, corners, joint):
        return None
    unexplained = max(chi2 - active, 0.0) / explained if explained > 0 else np.inf
    descent = Descent(origin, matrix, normal, result)
    return PatternFit(
        moved(matrix, origin), corners + origin, joint, levels, reduced, float(unexplained),
        math.sqrt(max(explained, 0.0)), descent,
    )  # fmt: skip


@kernel
def _corner_covariance(matrix, normal, scale, corners, joint) -> bool:
    """Corners (4, 2) and their covariance (8, 8) from the homography and its information, widened by `scale`."""
    covariance, slope = np.empty_like(normal), np.zeros((8, 8))
    if not invert_scaled(normal, covariance):
        return False
    for k in range(4):
        x, y = SQUARE[k]
        w = matrix[2, 0] * x + matrix[2, 1] * y + 1
        corners[k, 0], corners[k, 1] = image_of(matrix, x, y)
        for axis in range(2):
            row = slope[2 * k + axis]
            row[3 * axis], row[3 * axis + 1], row[3 * axis + 2] = x / w, y / w, 1 / w
            row[6], row[7] = -corners[k, axis] * x / w, -corners[k, axis] * y / w
    side = math.sqrt((corners[0, 0] - corners[2, 0]) ** 2 + (corners[0, 1] - corners[2, 1]) ** 2) / math.sqrt(2)
    for i in range(8):
        for j in range(i + 1):
            total = MODEL_SIGMA_PX**2 + (MODEL_SIGMA_SIDE * side) ** 2 if i == j else 0.0
            for a in range(8):
                for b in range(8):
                    total += scale * slope[i, a] * covariance[a, b] * slope[j, b]
            joint[i, j] = joint[j, i] = total
        if not (math.isfinite(joint[i, i]) and joint[i, i] > 0):
            return False
    return True


@kernel
def _descend(columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels) -> bool:
    """Levenberg–Marquardt on `matrix` (3, 3) and the first two `levels`, in place; False where it diverges."""
    normal, rhs, step, result = np.empty((EVEN, EVEN)), np.empty(EVEN), np.empty(EVEN), np.empty(4)
    damping = 1e-3
    if not _first_levels(columns, rows, data, saturated, noise, sigma_px, lines, cells, matrix, levels):
        return False
    if levels[0] <= 0:
        return False
    _accumulate(
        columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, normal, rhs, result
    )
    trial_matrix, trial_levels = matrix.copy(), levels.copy()
    trial_normal, trial_rhs, trial = np.empty_like(normal), np.empty_like(rhs), np.empty_like(result)
    for _ in range(MAX_ITERATIONS):
        if not solve_scaled(normal, rhs, damping, step):
            return False
        distance = _moved(matrix, levels, step, trial_matrix, trial_levels)
        if not distance >= 0:
            return False
        better = trial_levels[0] > 0
        if better and distance >= NEAR_PX:
            _accumulate(
                columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, trial_matrix, trial_levels,
                trial_normal, trial_rhs, trial,
            )  # fmt: skip
            better = trial[0] <= result[0]
        if better:
            matrix[:], levels[:] = trial_matrix, trial_levels
            normal[:], rhs[:], result[:] = trial_normal, trial_rhs, trial
            damping /= 10
        else:
            damping *= 30
        if damping > 1e4 or distance < NEAR_PX:
            break
    return True


@kernel
def _last_step(columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, normal, result):
    """One Gauss–Newton step on `matrix` (3, 3) and `levels` in place, which from near takes all the readings know.

    Leaves information and result (chi-square after the step) as `_accumulate` does. Returns the furthest way of a corner [px],
    −1 where it diverges; how far chi-square falls; and the count of parameters: with slopes of the levels only where they
    lower chi-square.
    """
    parameters = len(normal)
    rhs, step, even_step = np.empty(parameters), np.empty(parameters), np.empty(EVEN)
    _accumulate(
        columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, normal, rhs, result
    )
    if not solve_scaled(np.ascontiguousarray(normal[:EVEN, :EVEN]), rhs[:EVEN], 0.0, even_step):
        return -1.0, 0.0, EVEN
    count, gain, uneven_gain = EVEN, (even_step * rhs[:EVEN]).sum(), 0.0
    if solve_scaled(normal, rhs, 0.0, step):
        uneven_gain = (step * rhs).sum()
    if np.any(levels[2:] != 0) or uneven_gain > gain + UNEVEN_CHI2:
        count, gain = parameters, uneven_gain
    else:
        step[:EVEN], step[EVEN:] = even_step, 0.0
    trial_matrix, trial_levels = matrix.copy(), levels.copy()
    distance = _moved(matrix, levels, step, trial_matrix, trial_levels)
    matrix[:], levels[:] = trial_matrix, trial_levels
    result[1] = max(result[1] - gain, 0.0)
    return distance if levels[0] > 0 else -1.0, gain, count


@kernel
def _more(columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, normal, result):
    """Add further readings to a fit that has ended: homography, levels, information and result in place.

    The way of the corners [px], −1 where there is no solution.
    """
    count = len(normal)
    added, rhs, step, more = np.empty((count, count)), np.empty(count), np.empty(count), np.empty(4)
    _accumulate(columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, added, rhs, more)
    normal += added
    if not solve_scaled(normal, rhs, 0.0, step):
        return -1.0
    trial_matrix, trial_levels = matrix.copy(), levels.copy()
    distance = _moved(matrix, levels, step, trial_matrix, trial_levels)
    matrix[:], levels[:] = trial_matrix, trial_levels
    result[1] += max(more[1] - (step * rhs).sum(), 0.0)
    result[2] += more[2]
    return distance if levels[0] > 0 else -1.0


@kernel
def _moved(matrix, levels, step, trial_matrix, trial_levels) -> float:
    """Apply a step (n,) to homography and levels; the furthest way of a corner [px], see `_moved_px`."""
    for k in range(8):
        trial_matrix[k // 3, k % 3] = matrix[k // 3, k % 3] + step[k]
    for k in range(8, len(step)):
        trial_levels[k - 8] = levels[k - 8] + step[k]
    return float(_moved_px(matrix, trial_matrix))


@kernel
def _moved_px(before, after) -> float:
    """Furthest way of a corner [px]; −1 where one goes behind the camera or further than half a side."""
    furthest, low, high = 0.0, np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(4):
        x, y = SQUARE[k]
        if not after[2, 0] * x + after[2, 1] * y + 1 > 0.1:
            return -1.0
        old, new = image_of(before, x, y), image_of(after, x, y)
        for j in range(2):
            furthest = max(furthest, abs(new[j] - old[j]))
            low[j], high[j] = min(low[j], old[j]), max(high[j], old[j])
    side = max(high[0] - low[0], high[1] - low[1])
    return furthest if furthest <= 0.5 * side else -1.0


@kernel
def _first_levels(columns, rows, data, saturated, noise, sigma_px, lines, cells, matrix, levels) -> bool:
    """Amplitude and black level by linear least squares over the readings that are not saturated."""
    inverse = inverse3(matrix)
    block = new_block(inverse, lines, sigma_px, columns, rows)
    n = sv = svv = sd = svd = 0.0
    for start in range(0, len(data), BLOCK):
        seen = min(BLOCK, len(data) - start)
        see(block, inverse, sigma_px, lines, columns, rows, start, seen)
        shine(block, cells, sigma_px, seen)
        for p in range(seen):
            if not saturated[start + p]:
                v, reading = block.value[p], data[start + p]
                n, sv, svv, sd, svd = n + 1, sv + v, svv + v * v, sd + reading, svd + v * reading
    spread = n * svv - sv * sv
    if not spread > 1e-9 * n * n:
        return False
    levels[0] = (n * svd - sv * sd) / spread
    levels[1] = (sd - levels[0] * sv) / n
    if saturated.any():
        levels[0] = max(levels[0], noise[3] - levels[1])
    return True


@kernel
def _accumulate(
    columns, rows, data, saturated, extra, noise, sigma_px, lines, cells, matrix, levels, normal, rhs, result
) -> None:
    """Normal equations of homography and levels, and in `result` minus twice the log-likelihood (up to a constant), chi-square,
    readings that pull, and the variance that the pattern explains."""
    count, inverse = len(normal), inverse3(matrix)
    block = new_block(inverse, lines, sigma_px, columns, rows)
    slopes, weights, residuals = np.empty((count, BLOCK)), np.empty(BLOCK), np.empty(BLOCK)
    normal[:], rhs[:], result[:] = 0.0, 0.0, 0.0
    sums = np.zeros(3)
    for start in range(0, len(data), BLOCK):
        used = min(BLOCK, len(data) - start)
        see(block, inverse, sigma_px, lines, columns, rows, start, used)
        shine(block, cells, sigma_px, used)
        _compare(
            block,
            columns,
            rows,
            data,
            saturated,
            extra,
            noise,
            levels,
            start,
            used,
            slopes,
            weights,
            residuals,
            result,
            sums,
        )
        add_products(slopes, weights, residuals, used, normal, rhs)
    mirror(normal)
    result[0] += result[1]
    if sums[0] > 0:
        result[3] = sums[2] - sums[1] * sums[1] / sums[0]


@wide_kernel
def _compare(
    block, columns, rows, data, saturated, extra, noise, levels, start, used, slopes, weights, residuals, result, sums
) -> None:
    """Residuals, weights and slopes of a block of pixels; adds to the log-determinant, chi-square and readings that pull in
    `result`, and to the sums of weight, weighted pattern and its square in `sums`."""
    read_variance, gain, offset, limit = noise
    white, black, white_x, white_y, black_x, black_y, white_xx, white_xy, white_yy = levels
    cost = chi2 = active = total = mean = square = 0.0
    for p in range(used):
        x, y, w, value = block.x[p], block.y[p], block.w[p], block.value[p]
        amplitude = white + (white_x + white_xx * x + white_xy * y) * x + (white_y + white_yy * y) * y
        model = black + black_x * x + black_y * y + amplitude * value
        clipped = saturated[start + p]
        # A censored reading does not pull once the model reaches the ceiling.
        residual = max(limit - model, 0.0) if clipped else data[start + p] - model
        variance = read_variance + gain * max(min(model, limit) - offset, 0.0) + extra[start + p]
        weight = 0.0 if clipped and residual == 0.0 else 1.0 / variance
        cost += 0.0 if clipped else math.log(variance)
        chi2 += weight * residual * residual
        active += 1.0 if weight > 0 else 0.0
        total += weight
        mean += weight * amplitude * value
        square += weight * amplitude * amplitude * value * value
        weights[p], residuals[p] = weight, residual
        by_x = amplitude * block.by_x[p] + (white_x + 2 * white_xx * x + white_xy * y) * value + black_x
        by_y = amplitude * block.by_y[p] + (white_y + white_xy * x + 2 * white_yy * y) * value + black_y
        # At a fixed pixel, moving the plane under it by the homography's derivative: dm/dh = −(∇m) · d(image)/dh.
        along_u = -(by_x * block.xu[p] + by_y * block.yu[p]) / w
        along_v = -(by_x * block.xv[p] + by_y * block.yv[p]) / w
        along = along_u * columns[start + p] + along_v * rows[start + p]
        slopes[0, p], slopes[1, p], slopes[2, p] = along_u * x, along_u * y, along_u
        slopes[3, p], slopes[4, p], slopes[5, p] = along_v * x, along_v * y, along_v
        slopes[6, p], slopes[7, p], slopes[8, p], slopes[9, p] = -along * x, -along * y, value, 1.0
    if len(slopes) > EVEN:
        for p in range(used):
            x, y, value = block.x[p], block.y[p], block.value[p]
            slopes[10, p], slopes[11, p], slopes[12, p], slopes[13, p] = value * x, value * y, x, y
    if len(slopes) > SLOPING:
        for p in range(used):
            x, y, value = block.x[p], block.y[p], block.value[p]
            slopes[14, p], slopes[15, p], slopes[16, p] = value * x * x, value * x * y, value * y * y
    result[0], result[1], result[2] = result[0] + cost, result[1] + chi2, result[2] + active
    sums[0], sums[1], sums[2] = sums[0] + total, sums[1] + mean, sums[2] + square
