"""How the lens's blur is drawn: kernels of whole pixels against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from scenes.render.blur import BASE_PX, WIDE_PX, WIDEST_PX, Blur


def moments(kernel: np.ndarray) -> tuple[float, float]:
    """Sum of a kernel, and its variance along an axis [px²]."""
    reach = len(kernel) // 2
    offset = np.arange(-reach, reach + 1)
    return float(kernel.sum()), float(kernel.sum(axis=0) @ offset**2 / kernel.sum())


def test_a_narrow_point_spread_is_gathered_as_it_is() -> None:
    assert Blur.of(WIDE_PX, 3.0) == Blur(WIDE_PX, 0.0, 0.0)


@pytest.mark.parametrize(("sigma_px", "defocus_px"), [(1.5, 0.0), (1.5, 5.0), (3.0, 0.0), (4.0, 15.7), (12.0, 47.9)])
def test_the_kernel_and_the_gathering_have_the_variance_of_the_whole(sigma_px: float, defocus_px: float) -> None:
    """The sum of variances of gathering and kernel is that of the point spread, to what the kernel's end cuts off."""
    blur = Blur.of(sigma_px, defocus_px)
    total, variance = moments(blur.kernel().astype(float))
    assert total == pytest.approx(1, abs=1e-5)
    assert BASE_PX**2 + variance == pytest.approx(sigma_px**2, rel=0.02)


def test_a_disc_blurs_a_half_plane_as_the_area_of_its_segments() -> None:
    """Behind an edge, a uniform disc of radius r shows the share of its area beyond it: (θ − sin θ cos θ)/π, cos θ = d/r.

    The lens in focus and the pixels smooth it by half a pixel, so the middle of the edge agrees to a hundredth.
    """
    diameter = 40.0
    kernel = Blur.of(float(np.hypot(0.5, diameter / 4)), diameter).kernel().astype(float)
    reach = len(kernel) // 2
    share = np.cumsum(kernel.sum(axis=0))[::-1]  # of a half plane that begins at each column
    distance = np.arange(-reach, reach + 1) - 0.5
    theta = np.arccos(np.clip(distance / (diameter / 2), -1, 1))
    expected = (theta - np.sin(theta) * np.cos(theta)) / np.pi
    assert np.abs(share - expected).max() < 0.01


def test_a_disc_is_no_gaussian() -> None:
    """The fit of a detector that assumes a Gaussian must not meet its own kernel."""
    sigma = 5.0
    disc, gaussian = (Blur.of(sigma, d).kernel() for d in (4 * sigma, 0.0))
    middle = [k[len(k) // 2, len(k) // 2] for k in (disc, gaussian)]
    assert middle[0] < 0.6 * middle[1]  # 1/(π r²) against 1/(2π σ²), r = 2σ


def test_the_widest_blur_is_drawn_with_a_bounded_kernel() -> None:
    assert Blur.of(1e4, 4e4).rest_px <= WIDEST_PX
