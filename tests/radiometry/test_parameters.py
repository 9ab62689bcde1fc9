"""Types of parameter: each takes its interval, its ends where they belong to it, and no NaN."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from radiometry.parameters import Fraction, OpenFraction, Positive, PositiveFraction

#: Values inside, values outside.
INTERVALS = {
    "Positive": (Positive, (1e-300, 1.0, 1e300), (0.0, -1.0)),
    "Fraction": (Fraction, (0.0, 0.5, 1.0), (-1e-9, 1.0 + 1e-9)),
    "PositiveFraction": (PositiveFraction, (1e-9, 0.5, 1.0), (0.0, 1.0 + 1e-9)),
    "OpenFraction": (OpenFraction, (1e-9, 0.5, 1.0 - 1e-9), (0.0, 1.0)),
}


@pytest.mark.parametrize("name", INTERVALS)
def test_a_type_takes_its_interval_and_nothing_else(name: str) -> None:
    kind, inside, outside = INTERVALS[name]
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    for value in inside:
        assert adapter.validate_python(value) == value
    for value in (*outside, np.nan, np.inf, -np.inf):
        with pytest.raises(ValidationError):
            adapter.validate_python(value)
