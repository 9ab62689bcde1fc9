"""Sub-pixel corners: one maximum-likelihood fit of the printed pattern's analytic image to the pixels around the ArUco.

Every edge of the bits, of the border and of the ring pulls on one homography, so the fit comes near the Cramér–Rao
bound, and the inverse of its information matrix is the covariance of the corners. A saturated pixel is a censored
reading: it only says that the model should reach the saturation level. Where the light is uneven over the marker, both
levels get a slope along x and along y, and the bright one a curvature.

The ring's outer edge, the outermost that is sharp, is among them: without it corners would scatter 1.6 times as much, and twice
at 2 px a bit. The outline of the whole marker is not: where the background is a tenth as bright as the tape it would add 5 %
even if that light were even, and before foil it is neither even nor known (tests/detector/pattern/test_corners.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.pattern.corner_fit import (
    CURVED,
    LEVELS,
    RESULTS,
    SLOPING,
    Equations,
    Readings,
    State,
    Template,
    add_readings,
    corner_covariance,
    descend,
    last_step,
    scatter,
)
from detector.pattern.pattern import (
    CLEARANCE,
    KNOWING_REACH,
    NOWHERE,
    SQUARE,
    Edges,
    Pattern,
    clearance_of,
    homography,
    project,
    select_pixels,
)
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray

#: Pixels of the descent, which only has to come close, and the most of the last step, which takes all that they know: beyond,
#: edges are resolved far better than the optics are known.
DESCENT_PIXELS, MAX_PIXELS = 250, 6000
#: Last steps at most.
MAX_LAST_STEPS = 6
#: A step below this is the last [px]: what it leaves is of second order. So is one that lowers chi-square by little: it is a
#: small part of the noise.
LAST_PX, LAST_CHI2 = 0.06, 0.5
#: After a longer step, other pixels know where the edges are [px, or deviations of the blur where that is more than one].
ELSEWHERE_PX = 0.5
#: The blur that a fit starts from is a guess: the standard deviation of its logarithm, and the change of it after which other
#: pixels are looked at.
BLUR_DOUBT, OTHER_BLUR = 0.7, 0.2
#: Descents at most, each with pixels chosen for the blur that the last one found.
MAX_DESCENTS = 4
#: Readings further off the model than this many standard deviations, or times the scatter of all readings about the model where
#: that is wider, are outliers: hot and dead pixels, a flare.
OUTLIER_SIGMAS = 6.0
#: Curved light is fitted where the reduced chi-square of sloping light is worse than this, as with the Sun so near the camera's
#: axis that the tape returns it.
CURVED_FROM = 1.5
#: What is left unexplained beyond this reduced chi-square is alike over many pixels: it widens the covariance as if so many were
#: one. Measured on ray-traced frames with the Sun 1 to 4 deg behind the camera.
MISFIT_FROM, MISFIT_CORRELATION = 4.0, 10.0


@dataclass(frozen=True)
class Descent:
    """Where a fit ended: homography (3, 3) relative to an origin (2,), information about all parameters, result, and blur."""

    origin: FloatArray
    matrix: FloatArray
    normal: FloatArray
    result: FloatArray
    sigma_px: float


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
    sigma_px: float  # standard deviation of point spread and pixel box together
    sigma_deviation_px: float  # standard deviation of that
    descent: Descent  # where the fit ended, for `refined`

    @property
    def white_dn(self) -> float:
        """Amplitude at the centre: a reflective cell over an absorbing one [DN]."""
        return float(self.levels_dn[0])

    @property
    def black_dn(self) -> float:
        """Level of an absorbing cell at the centre [DN]."""
        return float(self.levels_dn[1])


def noise_numbers(noise: NoiseModel) -> FloatArray:
    """Read variance [DN²], gain [DN/e⁻], offset and level of saturation [DN], for the kernels."""
    limit = min(noise.saturated_above_dn, 1e300)
    return np.array([noise.read_noise_dn**2, noise.gain_dn_per_electron, noise.offset_dn, limit])


def gather(image: np.ndarray, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> FloatArray:
    """Pixel values (n,) as real numbers."""
    return np.asarray(image[rows, columns], float)


def sample(
    image: np.ndarray, columns: NDArray[np.int64], rows: NDArray[np.int64], origin: FloatArray, noise: NoiseModel
) -> Readings:
    """Readings of some pixels (n,), without those that say nothing."""
    if noise.extra_variance_dn2 is None:
        extra = np.zeros(len(columns))
    else:
        extra = noise.extra_variance_dn2[rows, columns]
        readable = np.isfinite(extra)
        columns, rows, extra = columns[readable], rows[readable], np.asarray(extra[readable], float)
    data = gather(image, columns, rows)
    saturated = data >= noise.saturated_above_dn
    return Readings(
        columns=columns - origin[0],
        rows=rows - origin[1],
        data=data,
        saturated=saturated,
        extra=extra,
        noise=noise_numbers(noise),
        cut=np.inf,
    )


def winsorised(readings: Readings) -> Readings:
    """The readings, those far outside the range of most drawn in: a hot pixel must not outweigh a whole dim marker."""
    count = len(readings.data)
    if count < 20:
        return readings
    few, many = count // 20, count - 1 - count // 20
    ordered = np.partition(readings.data, (few, many))
    spread = ordered[many] - ordered[few]
    return readings._replace(data=np.clip(readings.data, ordered[few] - spread, ordered[many] + spread))


def fit_pattern(
    image: np.ndarray,
    pattern: Pattern,
    corners_px: FloatArray,
    sigma_px: float,
    noise: NoiseModel,
    blur_px: float = 0.0,
) -> PatternFit | None:
    """Fit the pattern to an image from approximate corners.

    The blur is fitted along with corners and light. Corners seen through a blur of `blur_px` may be further off than an edge is
    wide: then the fit starts from as much blur, which draws them in. Blurring both sides of an edge alike leaves it where it is.

    Args:
        image: (height, width) [DN].
        pattern: what is printed.
        corners_px: approximate corners, (4, 2), the marker's top left first, clockwise [px].
        sigma_px: first guess of the standard deviation of point spread and pixel box together [px].
        noise: of the image.
        blur_px: blur of the copy that the corners were found in, standard deviation [px].

    Returns:
        The fit; None where it diverges or the pattern leaves the image.
    """
    fitting = _Fitting(image, pattern, noise, np.round(corners_px.mean(0)))
    start = float(np.hypot(sigma_px, blur_px)) if blur_px > sigma_px else sigma_px
    state = State(homography(corners_px - fitting.origin), np.zeros(len(LEVELS)), np.array([start]))
    template = Template(pattern.lines, pattern.cells, sigma_px, BLUR_DOUBT)
    for _ in range(MAX_DESCENTS):
        before = state.blur[0] if state.levels[0] else sigma_px
        few = fitting.readings(state.matrix, before, DESCENT_PIXELS)
        if few is None or not descend(winsorised(few), template, state):
            return None
        if abs(math.log(state.blur[0] / before)) < OTHER_BLUR:
            break
    fit = _last_steps(fitting, template, state, SLOPING)
    if fit is None or fit.reduced_chi2 < CURVED_FROM:
        return fit
    return _last_steps(fitting, template, state, CURVED) or fit


@dataclass(frozen=True)
class _Fitting:
    """What a fit starts from: image, pattern, noise, and the origin (2,) that its homographies are relative to [px]."""

    image: np.ndarray
    pattern: Pattern
    noise: NoiseModel
    origin: FloatArray

    def readings(self, matrix: FloatArray, sigma_px: float, most: int) -> Readings | None:
        """Readings of the pixels that know where the edges are, about `most` of them; None where they are too few."""
        clearance = clearance_of(sigma_px / self.pattern.bit_px(matrix))
        edges = Edges(self.pattern.lines, sigma_px, clearance, NOWHERE, self.pattern.openings)
        columns, rows = _edge_pixels(self.image, self.pattern, moved(matrix, self.origin), edges, most)
        found = sample(self.image, columns, rows, self.origin, self.noise)
        return found if len(found.data) >= 60 else None


def _last_steps(fitting: _Fitting, template: Template, state: State, parameters: int) -> PatternFit | None:
    """The fit's end from near it, on `state` in place; None where there is none."""
    normal, rhs, result = np.empty((parameters, parameters)), np.empty(parameters), np.empty(RESULTS)
    readings, chosen_px = None, 0.0
    for _ in range(MAX_LAST_STEPS):
        # The same pixels as long as they are near the edges: others would bring other noise, and no end.
        if readings is None:
            chosen_px = float(state.blur[0])
            readings = fitting.readings(state.matrix, chosen_px, MAX_PIXELS)
        if readings is None:
            return None
        readings = readings._replace(cut=_cut(readings, template, state))
        moved_px, gain, count = last_step(readings, template, state, Equations(normal, rhs, result))
        if not moved_px >= 0:
            return None
        if moved_px < LAST_PX or gain < LAST_CHI2:
            information, sigma_px = normal[:count, :count].copy(), float(state.blur[0])
            descent = Descent(fitting.origin, state.matrix.copy(), information, result, sigma_px)
            return _finish(descent, state.levels.copy())
        if moved_px > ELSEWHERE_PX * max(chosen_px, 1.0) or abs(math.log(state.blur[0] / chosen_px)) > OTHER_BLUR:
            readings = None
    return None


def _cut(readings: Readings, template: Template, state: State) -> float:
    """How many standard deviations off the model a reading is an outlier; the scatter is taken from some of the readings."""
    every = len(readings.data) // DESCENT_PIXELS + 1
    some = readings._replace(
        columns=np.ascontiguousarray(readings.columns[::every]),
        rows=np.ascontiguousarray(readings.rows[::every]),
        data=np.ascontiguousarray(readings.data[::every]),
        saturated=np.ascontiguousarray(readings.saturated[::every]),
        extra=np.ascontiguousarray(readings.extra[::every]),
    )
    return OUTLIER_SIGMAS * max(1.0, scatter(some, template, state))


def _edge_pixels(
    image: np.ndarray, pattern: Pattern, matrix: FloatArray, edges: Edges, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels near the pattern's edges; see `select_pixels`. They end well inside the marker's outline."""
    height, width = image.shape
    corner = project(matrix, SQUARE[:2] * pattern.outline)
    room_px = math.dist(*corner) * (1 - pattern.ring / pattern.outline) / 2 - edges.clearance * edges.sigma_px
    margin_px = -min(KNOWING_REACH * edges.sigma_px, room_px)
    columns, rows = select_pixels(matrix, pattern.ring, (height, width), margin_px, float(most), edges)
    return columns, rows


def refined(fit: PatternFit, image: np.ndarray, pattern: Pattern, blobs: FloatArray, noise: NoiseModel) -> PatternFit:
    """A fit with what the pixels beside the elements know of the ring's outer edge, once it is known where they are bright.

    Args:
        fit: what `fit_pattern` found in this image.
        image: (height, width) [DN].
        pattern: what is printed.
        blobs: rectangles x0, x1, y0, y1 of the plane that blobs may light, (k, 4) [plane units].
        noise: of the image.

    Returns:
        The better fit; `fit` itself where those pixels say nothing or contradict it.
    """
    start = fit.descent
    edges = Edges(pattern.lines, fit.sigma_px, CLEARANCE, pattern.openings, blobs)
    columns, rows = _edge_pixels(image, pattern, fit.matrix, edges, MAX_PIXELS)
    readings = sample(image, columns, rows, start.origin, noise)
    if not len(readings.data):
        return fit
    state = State(start.matrix.copy(), fit.levels_dn.copy(), np.array([fit.sigma_px]))
    template = Template(pattern.lines, pattern.cells, fit.sigma_px, BLUR_DOUBT)
    equations = Equations(start.normal.copy(), np.zeros(len(start.normal)), start.result.copy())
    moved_px = add_readings(readings._replace(cut=_cut(readings, template, state)), template, state, equations)
    if (
        not 0 <= moved_px < ELSEWHERE_PX * max(fit.sigma_px, 1.0)
    ):  # far off, the light is none that the pattern explains
        return fit
    descent = Descent(start.origin, state.matrix, equations.normal, equations.result, float(state.blur[0]))
    return _finish(descent, state.levels) or fit


def moved(matrix: FloatArray, origin: FloatArray) -> FloatArray:
    """The homography (3, 3) whose images lie further by `origin` (2,) [px]."""
    absolute = matrix.copy()
    absolute[:2] += origin[:, None] * matrix[2]
    return absolute / absolute[2, 2]


def _finish(descent: Descent, levels: FloatArray) -> PatternFit | None:
    """The fit that a descent ended at, with the covariance of its corners; None where it has none."""
    _, chi2, active, explained, own_chi2 = descent.result
    reduced = float(chi2 / max(active - len(descent.normal), 1))
    corners, joint = np.empty((4, 2)), np.empty((8, 8))
    misfit = MISFIT_CORRELATION * max(reduced - MISFIT_FROM, 0.0)
    state = State(descent.matrix, levels, np.array([descent.sigma_px]))
    blur_variance = corner_covariance(state, descent.normal, max(1.0, reduced) + misfit, corners, joint)
    if not blur_variance >= 0:
        return None
    return PatternFit(
        matrix=moved(descent.matrix, descent.origin),
        corners_px=corners + descent.origin,
        covariance_px2=joint,
        levels_dn=levels,
        reduced_chi2=reduced,
        unexplained=float(max(own_chi2 - active, 0.0) / explained if explained > 0 else np.inf),
        significance=math.sqrt(max(explained, 0.0)),
        sigma_px=descent.sigma_px,
        sigma_deviation_px=descent.sigma_px * math.sqrt(blur_variance),
        descent=descent,
    )
