"""What the detector's compiled kernels share: the decorators, the blurred edge, and small symmetric systems.

The kernels are plain loops over pixels. Numba compiles each on first use and keeps the code on disk, so only the first frame
after an installation waits for it.
"""

from __future__ import annotations

import hashlib
import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit
from scipy.special import ndtr

from radiometry.geometry import FloatArray


def _cache_folder() -> Path:
    """Where compiled kernels are kept: a folder for these very sources, those that import detector.compiled.

    By itself Numba looks only at the file that a kernel stands in, and would go on using what it compiled of a kernel of another
    file before that one was changed.
    """
    here = Path(__file__).parent
    sources = (path.read_bytes() for path in sorted(here.rglob("*.py")))
    digest = hashlib.sha256(b"".join(text for text in sources if b"detector.compiled" in text)).hexdigest()[:16]
    beside = here / "__pycache__"
    writable = os.access(beside if beside.is_dir() else here, os.W_OK)
    return (beside if writable else Path(tempfile.gettempdir()) / f"mantis-kernels-{os.getuid()}") / digest


if not os.environ.get("NUMBA_CACHE_DIR"):
    vars(numba.config)["CACHE_DIR"] = str(_cache_folder())

#: Division by zero gives infinity, as NumPy's does, instead of an exception.
kernel: Callable[[Callable[..., Any]], Callable[..., Any]] = njit(cache=True, error_model="numpy", nogil=True)
#: The same, for loops over pixels that the processor takes several at a time: their sums may be added in any order.
wide_kernel: Callable[[Callable[..., Any]], Callable[..., Any]] = njit(
    cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"}
)
#: The same, for what loops call at every pixel: copied into its callers.
inlined: Callable[[Callable[..., Any]], Callable[..., Any]] = njit(
    cache=True, error_model="numpy", nogil=True, inline="always", fastmath={"reassoc", "contract", "nsz"}
)

#: Pixels that are worked on at a time.
BLOCK = 64
#: Edge functions beyond this many deviations are taken as 0 and 1: they are within 3e-5 of it.
EDGE_REACH = 4.0


def _edge_coefficients() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Polynomials in z² of (Φ(z) − ½)/z and φ(z), up to `EDGE_REACH`, by least squares on Chebyshev nodes."""
    square = (1 - np.cos(np.pi * (np.arange(400) + 0.5) / 400)) * EDGE_REACH**2 / 2
    z = np.sqrt(square)
    odd = np.polynomial.Polynomial.fit(square, (ndtr(z) - 0.5) / z, 9, w=z).convert()
    even = np.polynomial.Polynomial.fit(square, np.exp(-square / 2) / math.sqrt(2 * math.pi), 9).convert()
    return tuple(map(float, odd.coef)), tuple(map(float, even.coef))


_A, _B = _edge_coefficients()


@inlined
def edge(z: float) -> tuple[float, float]:
    """Normal distribution function, to 1e-6, and density, to 1e-5, of z or of ±`EDGE_REACH` where z lies beyond.

    Polynomials rather than the library's functions, so that several pixels go through at a time.
    """
    z = min(max(z, -EDGE_REACH), EDGE_REACH)
    t = z * z
    a, b = _A[9], _B[9]
    a, b = a * t + _A[8], b * t + _B[8]
    a, b = a * t + _A[7], b * t + _B[7]
    a, b = a * t + _A[6], b * t + _B[6]
    a, b = a * t + _A[5], b * t + _B[5]
    a, b = a * t + _A[4], b * t + _B[4]
    a, b = a * t + _A[3], b * t + _B[3]
    a, b = a * t + _A[2], b * t + _B[2]
    a, b = a * t + _A[1], b * t + _B[1]
    a, b = a * t + _A[0], b * t + _B[0]
    return 0.5 + z * a, b


@kernel
def normal_cdf(z: float) -> float:
    """Standard normal distribution function."""
    return 0.5 * math.erfc(-z * math.sqrt(0.5))


@wide_kernel
def add_products(slopes, weight, residual, used, normal, rhs) -> None:
    """Add Jᵀ W J to the lower triangle of `normal` (n, n) and Jᵀ W r to `rhs` (n,).

    They come from the first `used` columns of `slopes` (n, m), `weight` (m,) and `residual` (m,).
    """
    weighted = np.empty(used)
    for i in range(len(rhs)):
        for p in range(used):
            weighted[p] = weight[p] * slopes[i, p]
        total = 0.0
        for p in range(used):
            total += weighted[p] * residual[p]
        rhs[i] += total
        for j in range(i + 1):
            total = 0.0
            for p in range(used):
                total += weighted[p] * slopes[j, p]
            normal[i, j] += total


@kernel
def mirror(normal: FloatArray) -> None:
    """Copy the lower triangle of a matrix (n, n) to the upper."""
    for i in range(len(normal)):
        for j in range(i):
            normal[j, i] = normal[i, j]


@kernel
def factorise(matrix: FloatArray) -> bool:
    """Cholesky factor (n, n) of a symmetric matrix in its own lower triangle; False where it is not positive definite."""
    n = len(matrix)
    for j in range(n):
        for i in range(j, n):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 0 or not math.isfinite(total):
                    return False
                matrix[j, j] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def substitute(factor: FloatArray, rhs: FloatArray) -> None:
    """Solve L Lᵀ x = rhs (n,) in place, L from `factorise`."""
    n = len(factor)
    for i in range(n):
        for k in range(i):
            rhs[i] -= factor[i, k] * rhs[k]
        rhs[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            rhs[i] -= factor[k, i] * rhs[k]
        rhs[i] /= factor[i, i]


@kernel
def solve_scaled(normal: FloatArray, rhs: FloatArray, damping: float, step: FloatArray) -> bool:
    """Levenberg–Marquardt step (n,) of normal equations (n, n), in units of the diagonal's roots; False where it is singular."""
    n = len(rhs)
    scale = np.empty(n)
    matrix = np.empty((n, n))
    for i in range(n):
        scale[i] = math.sqrt(max(normal[i, i], 1e-300))
    for i in range(n):
        step[i] = rhs[i] / scale[i]
        for j in range(n):
            matrix[i, j] = normal[i, j] / (scale[i] * scale[j])
        matrix[i, i] += damping
    if not factorise(matrix):
        return False
    substitute(matrix, step)
    for i in range(n):
        step[i] /= scale[i]
        if not math.isfinite(step[i]):
            return False
    return True


@kernel
def invert_scaled(normal: FloatArray, inverse: FloatArray) -> bool:
    """Inverse (n, n) of a positive definite matrix; False where it is none."""
    n = len(normal)
    unit = np.zeros(n)
    column = np.empty(n)
    for i in range(n):
        unit[:] = 0.0
        unit[i] = 1.0
        if not solve_scaled(normal, unit, 0.0, column):
            return False
        inverse[:, i] = column
    return True
