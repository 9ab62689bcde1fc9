"""The renderer knows its own noise, and keeps it below what the sensor can see."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from scipy.stats import chi2

from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import frame_box, marker_pixels
from scenes.render import density
from scenes.render.image import ViewImage
from scenes.render.transport import LIGHTS, Quality, View, render_cases
from scenes.target import Target

#: A marker of 37 px of ArUco at 3.3 m.
VIEW = View(
    camera=Camera(width_px=64, height_px=64),
    marker=MarkerDesign(),
    target=Target(pitch_deg=15, yaw_deg=-10, roll_deg=20),
    leds=LedRing(),
    sun=Sun(),
    range_m=3.3,
    nodes_nm=(807, 833, 867, 893),
)
SEEDS = 40


@pytest.fixture(scope="module")
def runs(mi: ModuleType):
    return list(render_cases((VIEW, Quality(seed=seed)) for seed in range(SEEDS)))


@pytest.fixture(scope="module")
def pixels() -> np.ndarray:
    seen = marker_pixels(VIEW, frame_box(VIEW))
    return seen.aruco | seen.opening


def scatter_over_estimate(
    layers: np.ndarray, noise: np.ndarray, pixels: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """99.8 % interval (2,) of the pixels' mean scatter over their mean estimate, by drawing seeds anew (bootstrap)."""
    ratios = []
    for _ in range(1000):
        drawn = rng.integers(0, len(layers), len(layers))
        scatter = layers[drawn][:, pixels].var(axis=0, ddof=1) * len(layers) / (len(layers) - 1)  # seeds drawn twice
        ratios.append(scatter.mean() / (noise[drawn][:, pixels] ** 2).mean())
    return np.percentile(ratios, [0.1, 99.9])


@pytest.mark.parametrize("light", LIGHTS)
def test_the_stated_noise_is_the_scatter_over_seeds(runs, pixels: np.ndarray, light: str) -> None:
    """The mean square of the halves' difference estimates the variance over forty renderings, within the bootstrap's interval and
    a tenth: pixels that look noisy get more rays, so those that are left look a little better than they are.
    """
    layers = np.array([run.layers[light].mean(axis=0) for run in runs], float)
    noise = np.array([run.noise[light] for run in runs], float)
    low, high = scatter_over_estimate(layers, noise, pixels, np.random.default_rng(1))
    assert low < 1.1
    assert high > 1
    assert high / low < 2  # or the interval would say nothing


@pytest.mark.parametrize("light", LIGHTS)
def test_the_renderer_stays_below_a_tenth_of_shot_variance(runs, pixels: np.ndarray, light: str) -> None:
    """Scatter over forty seeds in the exposure that fills the well: pooled as stated everywhere, and in 99 pixels of 100 alone.

    The scatter of one pixel has 39 degrees of freedom; upper bounds are divided by its 0.1 % quantile.
    """
    layers = np.array([run.layers[light].mean(axis=0) for run in runs], float)
    seen = marker_pixels(VIEW, frame_box(VIEW))
    mean = layers.mean(axis=0)
    scale = Quality.electrons / np.percentile(mean[seen.aruco], 98)
    scatter = layers.std(axis=0, ddof=1) * scale
    assert density.variance_fractions(scatter, mean * scale, pixels).max() < 0.1 * 1.2
    alone = scatter[pixels] ** 2 / (mean[pixels] * scale)
    assert np.percentile(alone, 99) < 0.1 * chi2.isf(0.001, SEEDS - 1) / (SEEDS - 1)
    told = [float(run.attributes[f"{part}_variance_fraction"]) for run in runs for part in density.PARTS]
    assert max(told) <= 0.1


def test_density_follows_charge_and_target(mi: ModuleType) -> None:
    count = {"aruco": 1000, "blob": 500, "slats": 800}
    plenty = 10**12
    full, dim, strict = (
        density.rays_per_pixel(Quality(1, plenty, 1, electrons, fraction), count)
        for electrons, fraction in ((200_000, 0.1), (50_000, 0.1), (200_000, 0.025))
    )
    for part in density.PARTS:
        assert strict[part] == pytest.approx(2 * full[part], abs=16)
        assert full[part] == pytest.approx(2 * dim[part], abs=32)
        assert full[part] % 16 == 0
    assert full["blob"] > full["aruco"] > full["slats"]


@pytest.mark.parametrize("ceiling", [10_000, 100_000, 1_000_000])
def test_the_ceiling_on_rays_is_kept(mi: ModuleType, ceiling: int) -> None:
    """To the rounding to whole blocks of lanes, and but for one ray a pixel at least."""
    count = {"aruco": 5000, "blob": 2000, "slats": 4000}
    rays = density.rays_per_pixel(Quality(1, ceiling, 1), count)
    spent = sum(2 * rays[part] * n for part, n in count.items())
    assert spent <= max(1.5 * ceiling, 2 * sum(count.values()))


def test_extra_rays_respect_the_ceiling(mi: ModuleType) -> None:
    """A view that is too noisy, without rays to spare, is handed over as it is and says so."""
    [basis] = render_cases([(VIEW, Quality(1, 250_000, 1))])
    rays = basis.attributes
    image = ViewImage(VIEW, Quality(1, 250_000, 1))
    masks = {layer.name: int(layer.mask.sum()) for layer in image._layers}
    spent = sum(float(rays[f"{part}_rays_per_pixel"]) * n for part, n in masks.items())
    assert spent < 1.5 * 250_000
    assert max(float(rays[f"{part}_variance_fraction"]) for part in density.PARTS) > 0.1


def test_fractions_are_pooled_over_neighbours_that_count() -> None:
    noise, shot = np.zeros((20, 20)), np.full((20, 20), 4.0)
    noise[10, 10] = 10.0
    everywhere = np.ones((20, 20), bool)
    pooled = density.variance_fractions(noise, shot, everywhere)
    assert pooled.max() == pytest.approx(100 / 4 / 25)
    assert pooled[10, 12] == pooled[12, 10] == pytest.approx(1.0)
    assert pooled[10, 13] == pytest.approx(0, abs=1e-12)
    line = np.zeros((20, 20), bool)
    line[10] = True
    assert density.variance_fractions(noise, shot, line)[10, 10] == pytest.approx(100 / 4 / 5)
    assert not density.variance_fractions(noise, shot, ~everywhere).any()
