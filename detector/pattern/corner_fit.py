"""Loops over the pixels of a printed pattern: least squares of a homography and of the light's levels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detector.compiled import BLOCK, add_products, invert_scaled, kernel, mirror, solve_scaled, wide_kernel
from detector.pattern.pattern import SQUARE, Sight, image_of, inverse3, new_block, see, shine
from radiometry.geometry import FloatArray

#: Iterations of the descent at most.
MAX_ITERATIONS = 12
#: A step below this ends the descent [px].
NEAR_PX = 0.1
#: Amplitude of a reflective cell over an absorbing one and level of an absorbing cell, both at the marker's centre [DN]; how
#: either changes by x and y [DN per plane unit]; how the amplitude curves by x², xy and y².
LEVELS = ("white", "black", "white_x", "white_y", "black_x", "black_y", "white_xx", "white_xy", "white_yy")
#: Parameters of a fit under even light, under light that slopes, and under light that curves: the homography's eight, white,
#: black, the logarithm of the blur at `BLUR`, then the other levels.
EVEN, SLOPING, CURVED = 11, 15, 18
#: Results of a fit: −2 log-likelihood up to a constant; chi-square, outliers counted as at the cut; readings that pull; variance
#: that the pattern explains; and chi-square with all that outliers add, but for those brighter than white: a flare or a hot pixel
#: adds light to the pattern, where another pattern puts white for black.
RESULTS = 5
BLUR = 10
#: The blur stays above that of a pixel's box alone [px], and changes by this much of its logarithm at most in one step.
LEAST_SIGMA_PX, MOST_BLUR_STEP = 0.29, 0.4
#: Uneven light is fitted where it lowers chi-square by this much: five standard deviations.
UNEVEN_CHI2 = 25.0
#: What the model of blur and light leaves in a corner without any noise, standard deviation: in pixels, and over the ArUco's
#: side. Measured on ray-traced frames at many sub-pixel places: 0.001 px at 12–30 px a side, 0.003 px at 120 px.
MODEL_SIGMA_PX, MODEL_SIGMA_SIDE = 0.0015, 2.5e-5
#: What light spilt from the elements leaves in a corner of a much blurred marker, standard deviation over the blur: it grows with
#: the blur in sides of the ArUco, to this power. Measured on synthetic frames with a blur of 0.5 to 0.85 bits.
SPILT_SIGMA, SPILT_POWER = 0.19 * 6**7, 7


class Readings(NamedTuple):
    """Some pixels of an image, (n,) each, and what is known of their noise."""

    columns: FloatArray  # place relative to an origin [px]
    rows: FloatArray
    data: FloatArray  # [DN]
    saturated: NDArray[np.bool_]
    extra: FloatArray  # variance beyond the noise model's [DN²]
    noise: FloatArray  # see `detector.pattern.corners.noise_numbers`
    cut: float  # readings more deviations than this off the model are outliers: they pull less the further off they are


class Template(NamedTuple):
    """What is printed, and a weak expectation of the blur it is seen through."""

    lines: FloatArray  # grid lines of the cells [plane units], (n + 1,)
    cells: FloatArray  # reflectance of the cells, first index along x, second along y, (n, n)
    sigma_px: float  # expected standard deviation of point spread and pixel box together
    doubt: float  # standard deviation of its logarithm


class State(NamedTuple):
    """The parameters of a fit, changed in place."""

    matrix: FloatArray  # plane -> image homography relative to the readings' origin, last element 1, (3, 3)
    levels: FloatArray  # of the light, see `LEVELS`, (9,)
    blur: FloatArray  # standard deviation of point spread and pixel box together, (1,) [px]


class Equations(NamedTuple):
    """Normal equations of a fit at some state, filled in place."""

    normal: FloatArray  # information about the parameters, see `EVEN`, (k, k)
    rhs: FloatArray  # gradient of the log-likelihood, (k,)
    result: FloatArray  # see `RESULTS`, (5,)


@kernel
def new_equations(parameters):
    """Room for the normal equations of so many parameters."""
    return Equations(np.empty((parameters, parameters)), np.empty(parameters), np.empty(RESULTS))


@kernel
def corner_covariance(state, normal, scale, corners, joint) -> float:
    """Corners (4, 2) and their covariance (8, 8) from the homography and its information, widened by `scale`.

    Blur and levels are marginalised. Returns the variance of the blur's logarithm, widened as well; NaN where there is none.
    """
    matrix, covariance, slope = state.matrix, np.empty_like(normal), np.zeros((8, 8))
    if not invert_scaled(normal, covariance):
        return math.nan
    for k in range(4):
        x, y = SQUARE[k]
        w = matrix[2, 0] * x + matrix[2, 1] * y + 1
        corners[k, 0], corners[k, 1] = image_of(matrix, x, y)
        for axis in range(2):
            row = slope[2 * k + axis]
            row[3 * axis], row[3 * axis + 1], row[3 * axis + 2] = x / w, y / w, 1 / w
            row[6], row[7] = -corners[k, axis] * x / w, -corners[k, axis] * y / w
    side = math.sqrt((corners[0, 0] - corners[2, 0]) ** 2 + (corners[0, 1] - corners[2, 1]) ** 2) / math.sqrt(2)
    spilt = SPILT_SIGMA * state.blur[0] * (state.blur[0] / side) ** SPILT_POWER
    model = MODEL_SIGMA_PX**2 + (MODEL_SIGMA_SIDE * side) ** 2 + spilt**2
    for i in range(8):
        for j in range(i + 1):
            total = model if i == j else 0.0
            for a in range(8):
                for b in range(8):
                    total += scale * slope[i, a] * covariance[a, b] * slope[j, b]
            joint[i, j] = joint[j, i] = total
        if not (math.isfinite(joint[i, i]) and joint[i, i] > 0):
            return math.nan
    return float(scale * covariance[BLUR, BLUR])


@kernel
def descend(readings, template, state) -> bool:
    """Levenberg–Marquardt on homography, even light and blur of `state`; False where it diverges."""
    step, here, there = np.empty(EVEN), new_equations(EVEN), new_equations(EVEN)
    damping = 1e-3
    if not _first_levels(readings, template, state) or state.levels[0] <= 0:
        return False
    _accumulate(readings, template, state, here)
    _expect(template, state, here)
    trial = _copy_of(state)
    for _ in range(MAX_ITERATIONS):
        if not solve_scaled(here.normal, here.rhs, damping, step):
            return False
        distance = _moved(state, step, trial)
        if not distance >= 0:
            return False
        better = trial.levels[0] > 0
        if better and distance >= NEAR_PX:
            _accumulate(readings, template, trial, there)
            _expect(template, trial, there)
            better = there.result[0] <= here.result[0]
        if better:
            _copy_state(trial, state)
            here.normal[:], here.rhs[:], here.result[:] = there.normal, there.rhs, there.result
            damping /= 10
        else:
            damping *= 30
        if damping > 1e4 or distance < NEAR_PX:
            break
    return True


@kernel
def last_step(readings, template, state, equations):
    """One Gauss–Newton step on `state`, in place. From near the optimum one step takes all that the readings know.

    Leaves in `equations` what `_accumulate` finds before the step, but the chi-square after it. Returns the furthest way of a
    corner [px], −1 where the step diverges; how far chi-square falls; and the count of parameters: slopes of the levels are
    among them only where they lower chi-square.
    """
    normal, rhs, result = equations
    levels, parameters = state.levels, len(rhs)
    step, even_step = np.empty(parameters), np.empty(EVEN)
    _accumulate(readings, template, state, equations)
    _expect(template, state, equations)
    if not solve_scaled(np.ascontiguousarray(normal[:EVEN, :EVEN]), rhs[:EVEN], 0.0, even_step):
        return -1.0, 0.0, EVEN
    count, gain, uneven_gain = EVEN, (even_step * rhs[:EVEN]).sum(), 0.0
    if solve_scaled(normal, rhs, 0.0, step):
        uneven_gain = (step * rhs).sum()
    if np.any(levels[2:] != 0) or uneven_gain > gain + UNEVEN_CHI2:
        count, gain = parameters, uneven_gain
    else:
        step[:EVEN], step[EVEN:] = even_step, 0.0
    trial = _copy_of(state)
    distance = _moved(state, step, trial)
    _copy_state(trial, state)
    result[1], result[4] = max(result[1] - gain, 0.0), max(result[4] - gain, 0.0)
    return distance if levels[0] > 0 else -1.0, gain, count


@kernel
def scatter(readings, template, state) -> float:
    """Median distance of readings from the model in standard deviations, scaled so that it is 1 for normal noise.

    A saturated reading counts only where the model falls short of the ceiling.
    """
    sight = Sight(inverse3(state.matrix), template.lines, state.blur[0])
    block, part = new_block(sight, readings.columns, readings.rows), np.zeros(RESULTS)
    pull, off = Pull(np.empty((EVEN, BLOCK)), np.empty(BLOCK), np.empty(BLOCK)), np.empty(len(readings.data))
    count, sums = 0, np.zeros(3)
    for start in range(0, len(readings.data), BLOCK):
        used = min(BLOCK, len(readings.data) - start)
        see(block, sight, readings.columns, readings.rows, start, used)
        shine(block, template.cells, sight.sigma_px, used)
        _compare(block, readings, state.levels, (start, used), pull, (part, sums))
        for p in range(used):
            if pull.weights[p] > 0:
                off[count] = math.sqrt(pull.weights[p]) * abs(pull.residuals[p])
                count += 1
    return 1.4826 * float(np.median(off[:count])) if count > 0 else 0.0


@kernel
def add_readings(readings, template, state, equations):
    """Add further readings to a fit that has ended: `state` and `equations` change in place.

    Returns the furthest way of a corner [px], −1 where there is no solution.
    """
    count = len(equations.rhs)
    step, more = np.empty(count), new_equations(count)
    _accumulate(readings, template, state, more)
    for i in range(count):
        for j in range(count):
            equations.normal[i, j] += more.normal[i, j]
    if not solve_scaled(equations.normal, more.rhs, 0.0, step):
        return -1.0
    trial = _copy_of(state)
    distance = _moved(state, step, trial)
    _copy_state(trial, state)
    gain = (step * more.rhs).sum()
    equations.result[1] += max(more.result[1] - gain, 0.0)
    equations.result[4] += max(more.result[4] - gain, 0.0)
    equations.result[2] += more.result[2]
    return distance if state.levels[0] > 0 else -1.0


@kernel
def _copy_state(source, target) -> None:
    """Copy the parameters of one state into another."""
    target.matrix[:], target.levels[:], target.blur[:] = source.matrix, source.levels, source.blur


@kernel
def _copy_of(state):
    """A state of its own with the same parameters."""
    return State(state.matrix.copy(), state.levels.copy(), state.blur.copy())


@kernel
def _expect(template, state, equations) -> None:
    """Add to the equations what is expected of the blur."""
    known, off = 1 / template.doubt**2, math.log(template.sigma_px / state.blur[0])
    equations.normal[BLUR, BLUR] += known
    equations.rhs[BLUR] += known * off
    equations.result[0] += known * off * off


@kernel
def _moved(state, step, trial) -> float:
    """Apply a step (k,) to `state`, with the result in `trial`.

    Returns the furthest way of a corner or the change of the blur [px], whichever is more; see `_moved_px`.
    """
    for k in range(8):
        trial.matrix[k // 3, k % 3] = state.matrix[k // 3, k % 3] + step[k]
    for k in range(8, BLUR):
        trial.levels[k - 8] = state.levels[k - 8] + step[k]
    for k in range(BLUR + 1, len(step)):
        trial.levels[k - 9] = state.levels[k - 9] + step[k]
    change = min(max(step[BLUR], -MOST_BLUR_STEP), MOST_BLUR_STEP)
    trial.blur[0] = max(state.blur[0] * math.exp(change), LEAST_SIGMA_PX)
    moved = float(_moved_px(state.matrix, trial.matrix))
    return max(moved, abs(trial.blur[0] - state.blur[0])) if moved >= 0 else moved


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
def _first_levels(readings, template, state) -> bool:
    """Amplitude and black level of `state` by linear least squares over the readings that are not saturated."""
    columns, rows, data, saturated, _, noise, _ = readings
    lines, cells, sigma_px, levels = template.lines, template.cells, state.blur[0], state.levels
    sight = Sight(inverse3(state.matrix), lines, sigma_px)
    block = new_block(sight, columns, rows)
    n = sv = svv = sd = svd = 0.0
    for start in range(0, len(data), BLOCK):
        seen = min(BLOCK, len(data) - start)
        see(block, sight, columns, rows, start, seen)
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
def _accumulate(readings, template, state, equations) -> None:
    """Fill `equations` with the normal equations of all readings at `state`."""
    normal, rhs, result = equations
    cells, sigma_px = template.cells, state.blur[0]
    sight = Sight(inverse3(state.matrix), template.lines, sigma_px)
    columns, rows, data = readings.columns, readings.rows, readings.data
    block = new_block(sight, columns, rows)
    pull = Pull(np.empty((len(rhs), BLOCK)), np.empty(BLOCK), np.empty(BLOCK))
    normal[:], rhs[:], result[:] = 0.0, 0.0, 0.0
    sums = np.zeros(3)
    for start in range(0, len(data), BLOCK):
        used = min(BLOCK, len(data) - start)
        see(block, sight, columns, rows, start, used)
        shine(block, cells, sigma_px, used)
        _compare(block, readings, state.levels, (start, used), pull, (result, sums))
        add_products(pull.slopes, pull.weights, pull.residuals, used, normal, rhs)
    mirror(normal)
    result[0] += result[1]
    if sums[0] > 0:
        result[3] = sums[2] - sums[1] * sums[1] / sums[0]


class Pull(NamedTuple):
    """How each pixel of a block pulls on the parameters."""

    slopes: FloatArray  # derivatives of the model by the parameters, (k, BLOCK)
    weights: FloatArray  # inverse variances, zero where a censored reading does not pull, (BLOCK,)
    residuals: FloatArray  # reading less model [DN], (BLOCK,)


@wide_kernel
def _compare(block, readings, levels, part, pull, totals) -> None:
    """Residuals, weights and slopes of a block of pixels, in `pull`.

    `part`: the block's first reading, and how many. `totals`: two arrays that are added to. The first gets log-determinant,
    chi-square and readings that pull; the second the sums of weight, of weighted pattern, and of its square.
    """
    columns, rows, data, saturated, extra, noise, cut = readings
    start, used = part
    slopes, weights, residuals = pull
    result, sums = totals
    read_variance, gain, offset, limit = noise
    white, black, white_x, white_y, black_x, black_y, white_xx, white_xy, white_yy = levels
    cost = chi2 = own_chi2 = active = total = mean = square = 0.0
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
        square_off = weight * residual * residual
        counted = min(square_off, cut * cut)
        over = data[start + p] - model + amplitude * (value - 1.0)
        chi2 += counted
        own_chi2 += counted if over > 0.0 and over * over * weight > cut * cut else square_off
        weight *= min(cut * cut / max(square_off, 1e-30), 1.0)
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
        slopes[10, p] = amplitude * block.by_blur[p]
    if len(slopes) > EVEN:
        for p in range(used):
            x, y, value = block.x[p], block.y[p], block.value[p]
            slopes[11, p], slopes[12, p], slopes[13, p], slopes[14, p] = value * x, value * y, x, y
    if len(slopes) > SLOPING:
        for p in range(used):
            x, y, value = block.x[p], block.y[p], block.value[p]
            slopes[15, p], slopes[16, p], slopes[17, p] = value * x * x, value * x * y, value * y * y
    result[0], result[1], result[2] = result[0] + cost, result[1] + chi2, result[2] + active
    result[4] += own_chi2
    sums[0], sums[1], sums[2] = sums[0] + total, sums[1] + mean, sums[2] + square
