"""Statistics of repeated frames: intervals of a rate, percentiles and root mean squares of what is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv
from scipy.stats import norm

from radiometry.geometry import FloatArray


def binomial_interval(
    successes: ArrayLike, trials: ArrayLike, confidence: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Both ends of the exact two-sided interval of a probability (Clopper and Pearson, Biometrika 26, 1934).

    Args:
        successes: number of independent trials that succeeded, any shape; NaN gives NaN.
        trials: number of trials, of a shape that broadcasts with it.
        confidence: probability that the interval holds the truth, at least.
    """
    k, n = np.broadcast_arrays(np.asarray(successes, float), np.asarray(trials, float))
    tail = (1 - confidence) / 2
    low = np.where(k > 0, betaincinv(np.maximum(k, 1), n - k + 1, tail), 0.0)
    high = np.where(k < n, betaincinv(k + 1, np.maximum(n - k, 1), 1 - tail), 1.0)
    return np.where(np.isnan(k), np.nan, low), np.where(np.isnan(k), np.nan, high)


def wilson_interval(successes: ArrayLike, trials: ArrayLike, confidence: float = 0.95) -> tuple[FloatArray, FloatArray]:
    """Both ends of Wilson's score interval of a proportion (J. Am. Stat. Assoc. 22, 1927); arguments as `binomial_interval`."""
    k, n = np.broadcast_arrays(np.asarray(successes, float), np.asarray(trials, float))
    z = norm.ppf(0.5 + confidence / 2)
    centre = (k + z**2 / 2) / (n + z**2)
    half = z / (n + z**2) * np.sqrt(k * (n - k) / n + z**2 / 4)
    # At 0 and 1 rounding would put an end beyond the proportion itself.
    return np.minimum(centre - half, k / n), np.maximum(centre + half, k / n)


def percentile(values: ArrayLike, percent: float) -> float:
    """Percentile of the values that are known; NaN where none is."""
    known = _known(values)
    return float(np.percentile(known, percent)) if known.size else float("nan")


def root_mean_square(values: ArrayLike) -> float:
    """Root mean square of the values that are known; NaN where none is."""
    known = _known(values)
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _known(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, float)
    return array[np.isfinite(array)]
