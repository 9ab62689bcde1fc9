"""What the compiled kernels share, against SciPy and NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from detector.compiled import (
    EDGE_REACH,
    add_products,
    edge,
    factorise,
    invert_scaled,
    mirror,
    normal_cdf,
    solve_scaled,
    substitute,
)
from radiometry.geometry import FloatArray

SIZES = [1, 2, 6, 10, 17]


def positive_definite(size: int, seed: int = 0) -> FloatArray:
    """A matrix (n, n) whose diagonal spans many orders of magnitude, as normal equations in mixed units do."""
    rng = np.random.default_rng((size, seed))
    root = rng.normal(size=(size, 2 * size)) * 10.0 ** rng.uniform(-3, 3, (size, 1))
    return root @ root.T


def test_edge_is_the_normal_distribution_and_its_density() -> None:
    z = np.linspace(-EDGE_REACH, EDGE_REACH, 2001)
    value, slope = np.array([edge(v) for v in z]).T
    assert value == pytest.approx(ndtr(z), abs=1e-6)
    assert slope == pytest.approx(norm.pdf(z), abs=1e-5)


@pytest.mark.parametrize("z", [-40.0, -4.5, 4.5, 40.0, np.inf])
def test_edge_stays_where_it_ends(z: float) -> None:
    assert edge(z) == edge(np.copysign(EDGE_REACH, z))


def test_normal_cdf_keeps_its_tail() -> None:
    for z in np.linspace(-30, 8, 77):
        assert normal_cdf(z) == pytest.approx(ndtr(z), rel=1e-13)


def test_products_are_added_from_the_columns_in_use() -> None:
    rng = np.random.default_rng(1)
    slopes, weight, residual = rng.normal(size=(5, 64)), rng.uniform(0, 2, 64), rng.normal(size=64)
    normal, rhs = np.ones((5, 5)), np.ones(5)
    add_products(slopes, weight, residual, 40, normal, rhs)
    mirror(normal)
    used = slopes[:, :40]
    assert normal == pytest.approx(1 + (used * weight[:40]) @ used.T)
    assert rhs == pytest.approx(1 + used @ (weight[:40] * residual[:40]))


@pytest.mark.parametrize("size", SIZES)
def test_factor_is_that_of_cholesky_and_solves(size: int) -> None:
    matrix, rhs = positive_definite(size), np.random.default_rng(2).normal(size=size)
    factor, solution = matrix.copy(), rhs.copy()
    assert factorise(factor)
    assert np.tril(factor) == pytest.approx(np.linalg.cholesky(matrix))
    substitute(factor, solution)
    assert solution == pytest.approx(np.linalg.solve(matrix, rhs), rel=1e-6)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_damped_step_solves_the_damped_equations(size: int, damping: float) -> None:
    """Levenberg–Marquardt in units of the diagonal's roots: (N + damping · diag N) step = rhs."""
    normal, rhs, step = positive_definite(size), np.random.default_rng(3).normal(size=size), np.empty(size)
    before = normal.copy()
    assert solve_scaled(normal, rhs, damping, step)
    assert np.array_equal(normal, before)
    assert step == pytest.approx(np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rhs), rel=1e-6)


@pytest.mark.parametrize("size", SIZES)
def test_inverse_is_that_of_numpy(size: int) -> None:
    matrix = positive_definite(size)
    inverse = np.empty_like(matrix)
    assert invert_scaled(matrix, inverse)
    scale = np.sqrt(np.diag(matrix))
    assert inverse * np.outer(scale, scale) == pytest.approx(np.linalg.inv(matrix / np.outer(scale, scale)), rel=1e-8)


@pytest.mark.parametrize(
    "matrix", [-np.eye(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.full((2, 2), np.nan), np.diag([1.0, np.inf])]
)
def test_what_is_not_positive_definite_has_no_factor_and_no_inverse(matrix: FloatArray) -> None:
    assert not factorise(matrix.copy())
    assert not invert_scaled(matrix, np.empty((2, 2)))
