"""The fit of a blob, on light that a numerical integral over the seen floor puts into the pixels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2

from detector.elements.blob_fit import CELLS_PER_SIGMA, Readings, View, blob_step, descend, search_positions, thinned
from detector.elements.slits import Slits, blob_profile, blur_taps, blurred_cells
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

MARKER = MarkerDesign()
ELEMENT = MARKER.elements[0]
RANGE_M = 3.0
#: A pixel on the marker, and the point spread there [m].
PIXEL_M = RANGE_M / float(Camera().focal_px[0])
SIGMA_M = 0.5 * PIXEL_M
SLITS = Slits(MARKER, ELEMENT, np.array([0.05, 0.1, RANGE_M]))
VIEW = View(SLITS.numbers, SLITS.count, SLITS.beside, *SLITS.across)
BLOB_M, LIGHT_DN, BACKGROUND_DN, READ_NOISE_DN = 0.07 * ELEMENT.length_m, 800.0, 120.0, 15.0


def integral(places_m: FloatArray, blob_m: float) -> FloatArray:
    """Blob's light (n,) along the element: lit floor in small steps, each through the Gaussian and the pixel's box."""
    edges = np.linspace(-0.6, 0.6, 6001) * ELEMENT.length_m
    lit, middle = np.diff(SLITS.seen_up_to(edges, np.array([blob_m]))[0]), (edges[1:] + edges[:-1]) / 2
    away = np.asarray(places_m)[:, None] - middle
    box = ndtr((away + PIXEL_M / 2) / SIGMA_M) - ndtr((away - PIXEL_M / 2) / SIGMA_M)
    return np.asarray(box @ lit / PIXEL_M)


def pixels() -> tuple[FloatArray, FloatArray]:
    """Places along and across the element of the pixels in its opening [m]."""
    along = np.arange(-0.5 * ELEMENT.length_m, 0.5 * ELEMENT.length_m, PIXEL_M)
    across = np.arange(-0.5 * ELEMENT.width_m, 0.5 * ELEMENT.width_m, PIXEL_M)
    u, v = np.meshgrid(along, across)
    return u.ravel(), v.ravel()


def clean(blob_m: float = BLOB_M) -> FloatArray:
    """What the pixels read without noise [DN]."""
    u, v = pixels()
    blur = np.hypot(SIGMA_M, PIXEL_M / np.sqrt(12))
    shade = ndtr((v - VIEW.low) / blur) - ndtr((v - VIEW.high) / blur)
    return BACKGROUND_DN + LIGHT_DN * integral(u, blob_m) * shade


def readings(data: FloatArray, saturation_dn: float = 1e300) -> Readings:
    """Readings of an element far from ring and foil."""
    (u, v), n = pixels(), len(data)
    blur = (SIGMA_M, PIXEL_M, 0.0)
    cell_m, taps = blur_taps(blur, CELLS_PER_SIGMA)
    coarse_cell_m, coarse_taps = blur_taps(blur, 1.0)
    light = np.zeros((2, n))
    light[1] = 1.0
    return Readings(
        u=u,
        v=v,
        cell_m=cell_m,
        taps=taps,
        coarse_cell_m=coarse_cell_m,
        coarse_taps=coarse_taps,
        blur_v=np.full(n, np.hypot(SIGMA_M, PIXEL_M / np.sqrt(12))),
        data=data,
        saturated=data >= saturation_dn,
        spill=np.zeros(n),
        extra=np.zeros(n),
        noise=np.array([READ_NOISE_DN**2, 0.0, 0.0, saturation_dn]),
        light=light,
    )


def first_level() -> FloatArray:
    """Levels of blob and background to start from [DN]."""
    return np.array([0.0, BACKGROUND_DN])


def test_the_profile_is_the_integral_over_the_seen_floor() -> None:
    places = np.linspace(-0.5, 0.5, 301) * ELEMENT.length_m
    step, taps = blur_taps((SIGMA_M, PIXEL_M, 0.0), CELLS_PER_SIGMA)
    profile = np.empty(len(places))
    cells = blurred_cells(SLITS.numbers, SLITS.count, SLITS.beside, BLOB_M, step, taps)
    blob_profile(SLITS.numbers, SLITS.count, cells, step, places, profile)
    expected = integral(places, BLOB_M)
    assert expected.max() > 0.3
    assert profile == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("blob_m", [-0.21, 0.0, 0.07, 0.18])
def test_the_descent_ends_at_the_blob(blob_m: float) -> None:
    """To 0.02 px, which is what the cells of the grid leave."""
    blob, level = blob_m * ELEMENT.length_m, first_level()
    found, (step, variance, chi_square, blank, count) = descend(
        VIEW, readings(clean(blob)), blob + 1.5 * SLITS.pitch, SLITS.pitch, level
    )
    assert found == pytest.approx(blob, abs=0.02 * PIXEL_M)
    assert abs(step) < 0.01 * SLITS.pitch
    assert level == pytest.approx([LIGHT_DN, BACKGROUND_DN], rel=0.01)
    assert chi_square < 0.01 * blank
    assert variance > 0
    assert count == len(pixels()[0])


def test_the_search_is_lowest_nearest_the_blob() -> None:
    starts = np.arange(-0.4, 0.4, 0.02) * ELEMENT.length_m
    cost, blank = search_positions(VIEW, readings(clean()), starts, first_level())
    best = int(cost.argmin())
    assert abs(starts[best] - BLOB_M) <= 0.02 * ELEMENT.length_m
    assert cost[best] < 0.2 * blank


def test_the_variance_is_the_scatter() -> None:
    """Over 200 draws the squared pulls are chi-square: their sum lies within 99.9 %."""
    rng, mean, draws = np.random.default_rng(1), clean(), 200
    pulls = []
    for _ in range(draws):
        seen = readings(mean + rng.normal(0, READ_NOISE_DN, len(mean)))
        found, last = descend(VIEW, seen, BLOB_M, SLITS.pitch, first_level())
        pulls.append((found - BLOB_M) / np.sqrt(last[1]))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], draws)
    assert low < float(np.square(pulls).sum()) < high


def test_a_saturated_reading_counts_no_further_than_the_ceiling() -> None:
    """The blob stays in place, and its level is what the readings below the ceiling say."""
    mean = clean()
    ceiling = BACKGROUND_DN + 0.6 * (mean.max() - BACKGROUND_DN)
    level = first_level()
    seen = readings(np.minimum(mean, ceiling), ceiling)
    assert 20 < np.count_nonzero(seen.saturated) < 0.8 * len(mean)
    found, last = descend(VIEW, seen, BLOB_M + SLITS.pitch, SLITS.pitch, level)
    assert found == pytest.approx(BLOB_M, abs=0.1 * PIXEL_M)
    assert level[0] == pytest.approx(LIGHT_DN, rel=0.05)
    assert last[4] < len(mean)


def test_a_dark_element_has_no_blob_anywhere() -> None:
    rng = np.random.default_rng(2)
    dark = readings(BACKGROUND_DN + rng.normal(0, READ_NOISE_DN, len(pixels()[0])))
    _, _, chi_square, blank, _ = blob_step(VIEW, dark, BLOB_M, 0.05 * SLITS.pitch, first_level())
    assert blank - chi_square < 16.0


def test_thinned_readings_are_every_so_many_of_them() -> None:
    seen = readings(clean())
    few = thinned(seen, 3)
    assert np.array_equal(few.data, seen.data[::3])
    assert np.array_equal(few.light, seen.light[:, ::3])
    assert few.light.flags.c_contiguous
    assert few.taps is seen.taps
    assert thinned(seen, 1) is seen
