"""How thorough the closure search is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How thorough the search is.

    Attributes:
        draws: worlds drawn for a probability of closure.
        render: whether proposed sets are confirmed by rendering.
        coarse: whether only the first and the last set are confirmed, at three ranges of the first view with two noise draws.
    """

    draws: int = 4000
    render: bool = True
    coarse: bool = False


FULL = Plan()
QUICK = Plan(draws=500, coarse=True)
