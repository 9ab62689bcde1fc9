"""The printed pattern's analytic image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.pattern.pattern import Pattern, homography, kernel_sigma_px
from scenes.marker import MarkerDesign

MARKER = MarkerDesign()


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.lists(st.floats(-6, 6), min_size=8, max_size=8), st.floats(0.3, 1.5))
def test_the_pattern_s_gradient_is_its_derivative(offsets, sigma):
    square = np.array([[10, 10], [50, 12], [48, 52], [9, 49]]) + np.reshape(offsets, (4, 2))
    matrix, pattern = homography(square), Pattern(MARKER)
    pixels = np.random.default_rng(0).uniform(5, 55, (200, 2))
    value, gradient = pattern.value_and_gradient(pixels, matrix, kernel_sigma_px(sigma))
    assert value.min() > -0.1
    assert value.max() < 1.1
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = 1e-4
        ahead, _ = pattern.value_and_gradient(pixels + step, matrix, kernel_sigma_px(sigma))
        behind, _ = pattern.value_and_gradient(pixels - step, matrix, kernel_sigma_px(sigma))
        # The skew's second-order term is left out of the gradient.
        assert (ahead - behind) / 2e-4 == pytest.approx(gradient[:, axis], abs=0.12)
