"""The bandpass: half transmission at its cut wavelengths, the stated area, and no impossible bands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from radiometry.filters import Bandpass


@settings(deadline=None, derandomize=True)
@given(st.floats(400, 800), st.floats(1, 200), st.floats(0.01, 50), st.floats(0, 1))
def test_a_band_passes_half_at_its_cuts_and_an_area_of_width_times_transmission(
    low: float, width: float, edge: float, transmission: float
) -> None:
    assume(width > edge * 1.001)
    curve = Bandpass(low_nm=low, high_nm=low + width, transmission=transmission, edge_nm=edge).spectrum()
    # Knots near 1000 nm carry rounding errors of 1e-13 nm; an edge turns them into 1e-13/edge of transmission.
    assert curve([low, low + width]) == pytest.approx([transmission / 2] * 2, abs=1e-11)
    assert curve(low + width / 2) == pytest.approx(transmission, rel=1e-12)
    assert curve.integral() == pytest.approx(transmission * width, abs=1e-11)
    assert not np.any(curve([low - 0.51 * edge, low + width + 0.51 * edge]))


@pytest.mark.parametrize(
    "values",
    [
        {"low_nm": 900, "high_nm": 800},
        {"low_nm": 850, "high_nm": 850},
        {"low_nm": 850, "high_nm": 850.05, "edge_nm": 0.1},
        {"low_nm": 850, "high_nm": 860, "edge_nm": 12},
    ],
)
def test_a_band_narrower_than_its_edges_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=r"high_nm: .* must exceed low_nm"):
        Bandpass(**values)


@pytest.mark.parametrize(
    ("field", "value"), [("low_nm", 299), ("high_nm", np.nan), ("transmission", 1.01), ("transmission", -0.1)]
)
def test_a_filter_out_of_range_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        Bandpass(**{field: value})
