"""Intervals, percentiles and root mean squares, against scipy and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from experiments.chain.statistics import binomial_interval, percentile, root_mean_square, wilson_interval


@pytest.mark.parametrize(("interval", "method"), [(binomial_interval, "exact"), (wilson_interval, "wilson")])
@pytest.mark.parametrize(("found", "trials"), [(0, 16), (8, 16), (16, 16), (1, 300), (299, 300)])
def test_intervals_are_those_of_scipy(interval, method, found, trials):
    expected = stats.binomtest(found, trials).proportion_ci(0.95, method)
    assert [float(end) for end in interval(found, trials)] == pytest.approx([expected.low, expected.high], abs=1e-9)


def test_what_is_not_known_has_no_interval():
    low, high = binomial_interval(np.array([np.nan, 3.0]), 16)
    assert np.isnan([low[0], high[0]]).all()
    assert np.isfinite([low[1], high[1]]).all()


def test_percentile_and_root_mean_square_are_of_what_is_known():
    values = np.array([3.0, np.nan, 4.0, np.inf])
    assert percentile(values, 50) == 3.5
    assert root_mean_square(values) == pytest.approx(np.sqrt(12.5))
    assert np.isnan([percentile([np.nan], 95), root_mean_square([])]).all()
