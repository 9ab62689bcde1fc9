"""Statistics over noise draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from experiments.chain import trials


@pytest.mark.parametrize("signal", [5.0, 30.0, 100.0, 1000.0, 10_000.0])
def test_intervals_cover_the_truth_in_95_percent_of_cases(signal: float) -> None:
    """From signals far below the read noise, where the scatter of the means prevails, to those where the variance's does."""
    rng, cases, shape = np.random.default_rng(1), 600, (6, 40)
    background, noise = signal / 5, 28.2
    truth = {
        "snr": signal / np.sqrt(signal + noise**2),
        "cnr": (signal - background) / np.sqrt(signal + background + 2 * noise**2),
    }
    inside = dict.fromkeys(truth, 0)
    for _ in range(cases):
        levels = [m + rng.standard_normal(shape) * np.sqrt(m + noise**2) for m in (signal, background)]
        found = trials._noise_statistics(levels[0], levels[1], saturated=0.0)
        for name, value in truth.items():
            inside[name] += abs(found[f"{name}_rendered"] - value) <= found[f"{name}_rendered_ci95"]
    # 99.9 % that all ten counts of this test lie between these bounds.
    low, high = binom.ppf([0.001 / 20, 1 - 0.001 / 20], cases, 0.95)
    assert all(low <= count <= high for count in inside.values()), inside


def test_saturated_bits_have_no_snr() -> None:
    found = trials._noise_statistics(np.full((4, 9), 20_000.0), np.zeros((4, 9)), saturated=0.02)
    assert found["signal_rendered"] == 20_000
    assert np.isnan([found[f"{name}_rendered{end}"] for name in ("snr", "cnr") for end in ("", "_ci95")]).all()


def test_frames_without_a_usable_pose_do_not_drop_out_of_the_percentile() -> None:
    """Nineteen good frames of twenty still tell the 95th percentile; one more that fails makes it unknown, which fails."""
    errors = np.full(20, 0.1)
    errors[0] = np.inf
    assert trials._percentile95(errors) == 0.1
    errors[1] = np.inf
    assert np.isnan(trials._percentile95(errors))
