"""The renderer's BSDFs against the definition: values, densities, samples and energy, in single precision."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

from materials.library import END_OF_LIFE, available, load
from radiometry.geometry import FloatArray

WAVELENGTHS = (810.0, 835.0, 850.0, 890.0)
NORMAL = np.array([0.0, 0.0, 1.0])
FRESH = [name for name in available() if not name.endswith(END_OF_LIFE)]
PLUGIN = [n for n in FRESH if load(n).lobes.retro is not None or load(n).lobes.gloss_alpha is not None]
LAMBERTIAN = [n for n in FRESH if n not in PLUGIN]
INCIDENCES_DEG = (0.0, 32.0, 60.0)
#: One wrong verdict in a thousand runs, over all materials and incidences of a test (Šidák).
PER_TEST = 1 - 0.999 ** (1 / (len(PLUGIN) * len(INCIDENCES_DEG)))


@lru_cache
def bsdf(name: str) -> Any:
    import mitsuba as mi

    from materials import plugins

    return mi.load_dict(plugins.bsdf_dict(load(name)))


def interaction(mi: ModuleType, towards: FloatArray) -> Any:
    """Surface interactions that look along unit vectors (n, 3) of the local frame."""
    si = mi.SurfaceInteraction3f()
    si.wi = vectors(mi, towards)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    for k, wavelength in enumerate(WAVELENGTHS):
        si.wavelengths[k] = mi.Float(wavelength)
    si.t = mi.Float(1.0)
    return si


def vectors(mi: ModuleType, rows: FloatArray) -> Any:
    return mi.Vector3f(*(mi.Float(np.ascontiguousarray(rows[:, k], dtype=np.float32)) for k in range(3)))


def unit(rows: FloatArray) -> FloatArray:
    """Unit vectors with the values that single precision gives them."""
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32).astype(float)


def pairs(count: int) -> tuple[FloatArray, FloatArray]:
    """Directions over the whole sphere: half independent, half within a retro lobe of 1e-5 to 0.3 rad."""
    rng = np.random.default_rng(11)
    a, b = rng.standard_normal((2, count, 3))
    a = unit(a)
    near = a + 10 ** rng.uniform(-5, -0.5, (count, 1)) * unit(rng.standard_normal((count, 3)))
    b = np.where(np.arange(count)[:, None] < count // 2, b, near)
    b[count // 2 :: 10] = a[count // 2 :: 10]  # and on the very peak
    return a, unit(b)


def compare(mi: ModuleType, shading: Any, name: str, wavelengths: tuple[float, ...] = WAVELENGTHS) -> None:
    """Hold f cosθ_o of a BSDF to the definition.

    Both are given the same rounded directions, whose difference is exact where they are close. What is left to single
    precision: a retro lobe is exp(log f) with |log f| < 16, summed from at most six terms of half an ulp of 16 each, 6e-6. A
    mirror lobe divides by the square of s = 1 + (α² − 1) cos²θ_h, so an error of cosθ_h counts 4 cos²θ_h / s times;
    cosθ_h carries a few roundings, and those of the squared chord c over 4 − c, which vanishes at grazing.
    """
    a, b = pairs(20_000)
    found = shading.eval(mi.BSDFContext(), interaction(mi, a), vectors(mi, b), True)
    material = load(name)
    tolerance = np.full(len(a), 1e-5)
    if material.lobes.gloss_alpha is not None:
        left = np.maximum(4 - np.sum((a - b) ** 2, axis=1), 1e-6)
        cos2 = np.minimum((a[:, 2] + b[:, 2]) ** 2 / left, 1.0)
        amplified = 4 * cos2 / (1 + (material.lobes.gloss_alpha**2 - 1) * cos2)
        tolerance += amplified * (3 + 8 / left) * 2.0**-24
    for k, wavelength in enumerate(WAVELENGTHS):
        if wavelength in wavelengths:
            expected = material.brdf(NORMAL, a, b, wavelength) * np.clip(b[:, 2], 0, None)
            # Sides may differ only where a direction grazes the surface, and the cosine itself is then a rounding error.
            excess = np.abs(np.array(found[k]) - expected) - tolerance * expected
            assert excess.max() <= 1e-7


@pytest.mark.parametrize("name", PLUGIN)
def test_the_plugin_evaluates_the_definition(mi: ModuleType, name: str) -> None:
    compare(mi, bsdf(name), name)


@pytest.mark.parametrize("name", LAMBERTIAN)
def test_the_stock_diffuse_evaluates_the_definition(mi: ModuleType, name: str) -> None:
    from materials import plugins

    assert plugins.bsdf_dict(load(name))["type"] == "diffuse"
    compare(mi, bsdf(name), name)


@pytest.mark.parametrize("name", [n for n in PLUGIN if load(n).lobes.retro is None])
def test_the_stock_blend_for_scalar_variants_evaluates_the_definition(
    mi: ModuleType, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 850 nm, the wavelength from which the stand-in takes its albedos."""
    from materials import plugins

    with monkeypatch.context() as patch:
        patch.setattr(plugins.mi, "variant", lambda: "scalar_spectral")
        description = plugins.bsdf_dict(load(name))
    assert description["type"] == "blendbsdf"
    compare(mi, mi.load_dict(description), name, wavelengths=(850.0,))


# --- densities and samples

CHORD_CELLS, AZIMUTH_CELLS = 24, 8
#: Squared chords about the lobe's axis: the first decades hold a retro lobe, the last the hemisphere.
CHORD_EDGES = np.concatenate([[0.0], np.geomspace(1e-7, 4.0, CHORD_CELLS)])


def towards(incidence_deg: float) -> FloatArray:
    return np.array([[np.sin(np.radians(incidence_deg)), 0.0, np.cos(np.radians(incidence_deg))]])


def axes(name: str, incidence_deg: float) -> FloatArray:
    """Rows: two directions square to the axis of the narrowest lobe, and that axis: back to the source, or its mirror image."""
    mirrored = load(name).lobes.retro is None
    axis = towards(-incidence_deg if mirrored else incidence_deg)[0]
    return np.stack([np.array([axis[2], 0.0, -axis[0]]), np.array([0.0, 1.0, 0.0]), axis])


def samples(mi: ModuleType, name: str, incidence_deg: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Sampled directions (n, 3) and their weights at 850 nm, zero where the sample was refused."""
    rng = np.random.default_rng([17, round(incidence_deg), *name.encode()])
    one, x, y = rng.random((3, count), dtype=np.float32)
    si = interaction(mi, np.repeat(towards(incidence_deg), count, axis=0))
    sample, weight = bsdf(name).sample(mi.BSDFContext(), si, mi.Float(one), mi.Point2f(mi.Float(x), mi.Float(y)), True)
    return np.array(sample.wo).T.astype(float), np.array(weight[WAVELENGTHS.index(850.0)])


def cell_probabilities(mi: ModuleType, name: str, incidence_deg: float, nodes: int = 24) -> FloatArray:
    """The density integrated over every cell, (chord, azimuth): dω = ½ dc dφ, midpoint rule on nodes × nodes points a cell."""
    part = (np.arange(nodes) + 0.5) / nodes
    low, high = CHORD_EDGES[:-1, None], CHORD_EDGES[1:, None]
    with np.errstate(divide="ignore"):
        # Spaced evenly in the logarithm within a cell; the first begins at zero, where densities are constant.
        grid = np.where(low > 0, low * (high / np.where(low > 0, low, 1)) ** part, high * part)
        bounds = np.where(
            low > 0,
            low * (high / np.where(low > 0, low, 1)) ** (np.arange(nodes + 1) / nodes),
            high * np.arange(nodes + 1) / nodes,
        )
    chord2 = grid.ravel()
    width = np.diff(bounds, axis=1).ravel()
    azimuth = (np.arange(AZIMUTH_CELLS * nodes) + 0.5) * 2 * np.pi / (AZIMUTH_CELLS * nodes)
    cos_a = 1 - chord2 / 2
    sin_a = np.sqrt(np.clip(chord2 * (1 - chord2 / 4), 0, None))
    local = np.stack(
        [
            sin_a[:, None] * np.cos(azimuth),
            sin_a[:, None] * np.sin(azimuth),
            np.broadcast_to(cos_a[:, None], (len(chord2), len(azimuth))),
        ],
        axis=-1,
    )
    wo = (local @ axes(name, incidence_deg)).reshape(-1, 3)
    si = interaction(mi, np.repeat(towards(incidence_deg), len(wo), axis=0))
    density = np.array(bsdf(name).pdf(mi.BSDFContext(), si, vectors(mi, wo), True), float)
    content = density.reshape(len(chord2), len(azimuth)) * width[:, None] / 2 * (azimuth[1] - azimuth[0])
    return content.reshape(CHORD_CELLS, nodes, AZIMUTH_CELLS, nodes).sum(axis=(1, 3))


@pytest.mark.parametrize("incidence_deg", INCIDENCES_DEG)
@pytest.mark.parametrize("name", PLUGIN)
def test_samples_follow_the_density_by_chi_squared(mi: ModuleType, name: str, incidence_deg: float) -> None:
    """Cells over squared chord and azimuth, and one more for samples below the horizon, which the density leaves out.

    That last cell makes the density's integral over the hemisphere plus the refused share one: a density that does not
    integrate to one fails there.
    """
    count = 400_000
    wo, weight = samples(mi, name, incidence_deg, count)
    kept = weight > 0
    frame = axes(name, incidence_deg)
    local = wo[kept] @ frame.T
    chord2 = np.clip(np.sum((wo[kept] - frame[2]) ** 2, axis=1), 0, 4)
    azimuth = np.arctan2(local[:, 1], local[:, 0]) % (2 * np.pi)
    observed, _, _ = np.histogram2d(chord2, azimuth, bins=(CHORD_EDGES, np.linspace(0, 2 * np.pi, AZIMUTH_CELLS + 1)))
    expected = cell_probabilities(mi, name, incidence_deg)
    refused = count - np.count_nonzero(kept)
    assert expected.sum() <= 1 + 1e-4
    observed_all = np.append(observed.ravel(), refused)
    expected_all = np.append(expected.ravel(), max(1 - expected.sum(), 0.0)) * count
    # Pool cells of fewer than ten expected samples, for which chi² is no limit.
    large = expected_all >= 10
    observed_all = np.append(observed_all[large], observed_all[~large].sum())
    expected_all = np.append(expected_all[large], expected_all[~large].sum())
    if expected_all[-1] < 10:
        observed_all, expected_all = observed_all[:-1], expected_all[:-1]
    statistic = np.sum((observed_all - expected_all) ** 2 / expected_all)
    p_value = chi2.sf(statistic, len(expected_all) - 1)
    assert p_value > PER_TEST, f"chi² {statistic:.1f} over {len(expected_all)} cells"


@pytest.mark.parametrize("incidence_deg", INCIDENCES_DEG)
@pytest.mark.parametrize("name", PLUGIN)
def test_in_a_white_furnace_the_sampled_albedo_is_the_definitions(
    mi: ModuleType, name: str, incidence_deg: float
) -> None:
    """Mean weight of the samples against the integral of the definition.

    The interval is that of the mean, widened by what the integral still changes when its nodes double: the tail of a narrow
    mirror lobe that is lost below the horizon falls between them.
    """
    _, weight = samples(mi, name, incidence_deg, 400_000)
    mean, error = float(weight.mean()), float(weight.std() / np.sqrt(len(weight)))
    material, entrance = load(name), np.radians(incidence_deg)
    coarse, albedo, fine = (material.albedo(entrance, 850.0, samples=n) for n in (200, 400, 800))
    quadrature = max(abs(albedo - coarse), abs(fine - albedo))
    assert abs(mean - albedo) < norm.isf(PER_TEST / 2) * error + quadrature


@pytest.mark.parametrize("name", PLUGIN)
def test_a_sample_carries_the_value_and_the_density_of_its_direction(mi: ModuleType, name: str) -> None:
    rng = np.random.default_rng(3)
    one, x, y = rng.random((3, 5000), dtype=np.float32)
    si = interaction(mi, np.repeat(towards(32.0), 5000, axis=0))
    context = mi.BSDFContext()
    sample, weight = bsdf(name).sample(context, si, mi.Float(one), mi.Point2f(mi.Float(x), mi.Float(y)), True)
    value, density = bsdf(name).eval_pdf(context, si, sample.wo, True)
    kept = np.array(weight[0]) > 0
    assert kept.sum() > 4000
    # The same single-precision operations in two kernels, which may fuse multiplications differently.
    np.testing.assert_allclose(np.array(sample.pdf)[kept], np.array(density)[kept], rtol=1e-4)
    for k in range(len(WAVELENGTHS)):
        product = np.array(weight[k]) * np.array(sample.pdf)
        np.testing.assert_allclose(product[kept], np.array(value[k])[kept], rtol=1e-4)


def test_spectra_reach_the_renderer_by_wavelength(mi: ModuleType) -> None:
    from materials import plugins
    from radiometry.spectrum import Spectrum

    for spectrum in (Spectrum([300, 1200], [0.4, 0.4]), Spectrum([300, 800, 900, 1200], [0.1, 0.2, 0.7, 0.7])):
        texture = mi.load_dict(plugins.texture(spectrum))
        found = texture.eval(interaction(mi, towards(0.0)), True)
        np.testing.assert_allclose([found[k][0] for k in range(4)], spectrum(WAVELENGTHS), rtol=1e-6)
