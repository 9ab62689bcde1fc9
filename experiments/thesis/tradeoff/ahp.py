"""The Analytic Hierarchy Process: priorities, consistency, two ways to add them up, and what would turn the ranking.

A decision problem is a weight matrix over criteria and one matrix over alternatives for each criterion, each filled
by pairwise judgement. All quantities are dimensionless.

References:
----------
[1] Saaty, "How to make a decision: the Analytic Hierarchy Process", Eur. J. Oper. Res. 48 (1990) 9-26.
[2] Saaty and Tran, "On the invalidity of fuzzifying numerical judgments in the AHP", Math. Comput. Model. 46 (2007).
[3] Belton and Gear, "On a short-coming of Saaty's method of analytic hierarchies", Omega 11 (1983) 228-230.
[4] Triantaphyllou and Sánchez, "A sensitivity analysis approach for some deterministic multi-criteria
    decision-making methods", Decision Sciences 28 (1997) 151-194.
"""

from __future__ import annotations

import tomllib
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from experiments.scenario.errors import explain

FloatArray = NDArray[np.float64]
MODES = ("ideal", "distributive")

#: Mean consistency index of random reciprocal matrices of order 1 to 10 [2]. A test recomputes it.
RANDOM_INDEX = (0.0, 0.0, 0.52, 0.89, 1.11, 1.25, 1.35, 1.40, 1.45, 1.49)


def _ratio(value: object) -> object:
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ZeroDivisionError):
        raise ValueError(f"{value!r} is neither a number nor a ratio such as '1/3'") from None


Ratio = Annotated[float, BeforeValidator(_ratio), Field(gt=0, allow_inf_nan=False)]


def _reciprocal(rows: list[list[float]]) -> list[list[float]]:
    n = len(rows)
    if n > len(RANDOM_INDEX):
        raise ValueError(f"{n} items compared, at most {len(RANDOM_INDEX)}: no random index is known beyond")
    if any(len(row) != n for row in rows):
        raise ValueError(f"the matrix has {n} rows, so every row needs {n} entries; got {[len(row) for row in rows]}")
    for i in range(n):
        for j in range(i, n):
            # Ratios typed as decimals ("0.33") carry this much rounding.
            if abs(rows[i][j] * rows[j][i] - 1) > 0.02:
                at, back = f"({i + 1}, {j + 1}) = {rows[i][j]:g}", f"({j + 1}, {i + 1}) = {rows[j][i]:g}"
                raise ValueError(f"entries {at} and {back} are not reciprocal")
    return rows


Comparison = Annotated[list[list[Ratio]], Field(min_length=1), AfterValidator(_reciprocal)]


class Weights(BaseModel):
    """Pairwise comparison of the criteria."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    comparison: Comparison


class Criterion(BaseModel):
    """One criterion and the pairwise comparison of the alternatives under it."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    comparison: Comparison


class DecisionProblem(BaseModel):
    """A two-level hierarchy: criteria weighed against each other, alternatives compared under each."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: str
    source: str = Field("", description="where the judgements come from")
    alternatives: Annotated[list[str], Field(min_length=2)]
    weights: Weights
    criteria: Annotated[list[Criterion], Field(min_length=1)]

    @model_validator(mode="after")
    def _sizes(self) -> DecisionProblem:
        names = [criterion.name for criterion in self.criteria]
        for kind, labels in (("alternatives", self.alternatives), ("criteria", names)):
            if len(set(labels)) != len(labels):
                raise ValueError(f"{kind}: names must differ, got {labels}")
        if len(self.weights.comparison) != len(names):
            raise ValueError(f"weights: a matrix of order {len(self.weights.comparison)} for {len(names)} criteria")
        for criterion in self.criteria:
            order = len(criterion.comparison)
            if order != len(self.alternatives):
                raise ValueError(
                    f"criteria {criterion.name!r}: a matrix of order {order} for {len(self.alternatives)} alternatives"
                )
        return self


def load_problem(path: Path) -> DecisionProblem:
    """Read a decision problem from TOML; a [printed] table, if any, is left to `experiments.thesis.tradeoff.study`.

    Raises ValueError, naming the key, where the file is not a valid problem.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: not valid TOML: {error}") from None
    data.pop("printed", None)
    try:
        return DecisionProblem(**data)
    except ValidationError as error:
        raise ValueError(f"{path}: {explain(error, DecisionProblem)}") from None


def priorities(comparison: list[list[float]] | FloatArray) -> tuple[FloatArray, float]:
    """Priority vector (n,), summing to one, and largest eigenvalue λ of a reciprocal matrix (n, n) [1]."""
    values, vectors = np.linalg.eig(np.asarray(comparison, float))
    largest = int(np.argmax(values.real))
    principal = np.abs(vectors[:, largest].real)  # Perron: the principal eigenvector has one sign
    return principal / principal.sum(), float(values[largest].real)


def consistency(largest_eigenvalue: float, order: int) -> tuple[float, float]:
    """Consistency index (λ − n)/(n − 1) and its ratio to the random index [1, 2]. Acceptable below a ratio of 0.1."""
    if order < 3:  # one judgement cannot contradict itself
        return 0.0, 0.0
    index = (largest_eigenvalue - order) / (order - 1)
    return index, index / RANDOM_INDEX[order - 1]


def weight_reduction(weights: FloatArray, measures: FloatArray) -> FloatArray:
    """Fraction of a criterion's weight to take away so that two alternatives tie, (i, j, criterion).

    W'_k = W_k (1 − x), the others in proportion, with x = (P_j − P_i)/((a_jk − a_ik) W_k) [4, eq. 5]. Negative means
    weight must be added. NaN where the two score alike under the criterion, or where x > 1: not even dropping the
    criterion would do. There is no bound on adding weight.
    `weights` (c,) and `measures` (alternative, c) must be of one and the same mode: scores are P = a W.
    """
    scores = measures @ weights
    gap = scores[None, :] - scores[:, None]
    slope = (measures[None, :, :] - measures[:, None, :]) * weights
    x = np.divide(gap[..., None], slope, out=np.full(slope.shape, np.nan), where=np.abs(slope) > 1e-12)
    return np.where(x <= 1, x, np.nan)


def measure_reduction_distributive(weights: FloatArray, measures: FloatArray) -> FloatArray:
    """Fraction of measure (i, criterion) to take away so that i ties with rival k, (i, k, criterion).

    The column is normalised to sum one again after the change, which gives
    x = D / (D + W_j (a_kj − a_ij + 1)) / a_ij with D = P_i − P_k [4, theorem for the AHP]. Negative: to be added.
    NaN where x > 1, and for i = k.
    """
    scores = measures @ weights
    gap = (scores[:, None] - scores[None, :])[..., None]
    x = gap / (gap + weights * (measures[None] - measures[:, None] + 1)) / measures[:, None]
    x[np.arange(len(scores)), np.arange(len(scores))] = np.nan
    return np.where(x <= 1, x, np.nan)


def measure_reduction_ideal(weights: FloatArray, measures: FloatArray) -> FloatArray:
    """The same for the ideal mode, (i, k, criterion): the column is divided by its largest entry again once changed.

    With D the lead of i over k from all other criteria and M the largest entry of the others, the tie lies at
    v = a_kj − D M/W_j while v ≤ M, and beyond it, where i itself sets the scale, at v = a_kj/(1 + D/W_j).
    The lead grows steadily with v, so there is at most one tie. NaN where there is none, and for i = k.
    """
    count, criteria = measures.shape
    x = np.full((count, count, criteria), np.nan)
    for i in range(count):
        for k in range(count):
            for j in range(criteria):
                if i == k:
                    continue
                lead = (measures[i] - measures[k]) @ weights - (measures[i, j] - measures[k, j]) * weights[j]
                ceiling = np.delete(measures[:, j], i).max()
                value = measures[k, j] - lead * ceiling / weights[j]
                if value > ceiling and lead > -weights[j]:
                    value = measures[k, j] / (1 + lead / weights[j])
                elif value > ceiling:
                    continue
                if value >= 0:
                    x[i, k, j] = 1 - value / measures[i, j]
    return x


def decide(problem: DecisionProblem) -> xr.Dataset:
    """Solve a problem in both modes, with its consistency and sensitivities.

    Dimensions: criterion, alternative, rival, mode (ideal: each column over its largest entry [3]; distributive: over
    its sum), matrix ('weights' and each criterion). Reductions follow [4]: positive is taken away, negative added.
    """
    names = [criterion.name for criterion in problem.criteria]
    weights, weights_eigenvalue = priorities(problem.weights.comparison)
    solved = [priorities(criterion.comparison) for criterion in problem.criteria]
    distributive = np.stack([vector for vector, _ in solved], axis=1)
    ideal = distributive / distributive.max(axis=0)
    eigenvalues = [weights_eigenvalue] + [value for _, value in solved]
    orders = [len(names)] + [len(problem.alternatives)] * len(names)
    checks = np.array([consistency(value, order) for value, order in zip(eigenvalues, orders, strict=True)])
    scores = np.stack([ideal @ weights, distributive @ weights])
    variables: dict[str, tuple[tuple[str, ...], Any, str]] = {
        "weight": (("criterion",), weights, "priority of each criterion"),
        "measure": (("mode", "alternative", "criterion"), np.stack([ideal, distributive]), "measure of performance"),
        "score": (("mode", "alternative"), scores, "weighted sum of measures"),
        "normalised_score": (
            ("mode", "alternative"),
            scores / scores.sum(axis=1, keepdims=True),
            "share of all scores",
        ),
        "rank": (("mode", "alternative"), (-scores).argsort(axis=1).argsort(axis=1) + 1, "1 is best"),
        "largest_eigenvalue": (("matrix",), np.array(eigenvalues), "principal eigenvalue"),
        "consistency_index": (("matrix",), checks[:, 0], "(λ − n)/(n − 1)"),
        "consistency_ratio": (("matrix",), checks[:, 1], "over the random index; acceptable below 0.1"),
        "weight_reduction": (
            ("mode", "alternative", "rival", "criterion"),
            np.stack([weight_reduction(weights, ideal), weight_reduction(weights, distributive)]),
            "fraction of a weight to take away (negative: add) for a tie",
        ),
        "measure_reduction": (
            ("mode", "alternative", "rival", "criterion"),
            np.stack([measure_reduction_ideal(weights, ideal), measure_reduction_distributive(weights, distributive)]),
            "fraction of an alternative's measure to take away (negative: add) for a tie with the rival",
        ),
    }
    return xr.Dataset(
        {name: (dims, values, {"long_name": text, "units": "1"}) for name, (dims, values, text) in variables.items()},
        coords={
            "criterion": names,
            "alternative": problem.alternatives,
            "rival": list(problem.alternatives),
            "mode": list(MODES),
            "matrix": ["weights", *names],
        },
        attrs={"title": problem.name, "source": problem.source},
    )
