"""Loops over the pixels of an encoding element: where they lie, and least squares of the light in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detector.compiled import BLOCK, add_products, edge, invert_scaled, kernel, mirror, solve_scaled, wide_kernel
from detector.elements.slits import blob_profile, blur_taps, blurred_cells
from detector.pattern.pattern import Sight, new_block, plane_point, see, shine
from radiometry.geometry import FloatArray

#: Cells of the fine grid per deviation of the blur: fewer leave 0.02 px in a blob's position.
CELLS_PER_SIGMA = 4.0
#: Gauss–Newton steps at most, and the step that ends them, in slit pitches: what it leaves is of second order.
MAX_STEPS = 8
CONVERGED_PITCHES = 0.01
#: Where the ring is narrower than so many deviations of the blur, the whole pattern's light is taken from the element's pixels.
RING_BLURS = 3.5


class Readings(NamedTuple):
    """Some pixels of an element."""

    u: FloatArray  # along the element [m], (n,)
    v: FloatArray  # across [m], (n,)
    cell_m: float  # of the fine grid along the element, and the blur's weights on it: see `detector.elements.slits.blur_taps`
    taps: FloatArray
    coarse_cell_m: float  # of the grid of the search, and the weights on that
    coarse_taps: FloatArray
    blur_v: FloatArray  # blur across [m], (n,)
    data: FloatArray  # readings less the light spilt from the ring [DN], (n,)
    saturated: NDArray[np.bool_]  # (n,)
    spill: FloatArray  # the light spilt from the ring [DN], (n,)
    extra: FloatArray  # variance beyond the noise model's [DN²], (n,)
    noise: FloatArray  # see `detector.pattern.corners.noise_numbers`
    light: FloatArray  # room for the blob, then background, share of the foil, and that share times u, (4, n)


class View(NamedTuple):
    """The slits as the camera sees them; see `detector.elements.slits.Slits`."""

    numbers: FloatArray
    slit_count: int
    beside: FloatArray
    low: float  # ends of the seen floor across the slits, from the marker's centre [m]
    high: float


class Site(NamedTuple):
    """Where an element lies and what is beside it."""

    axis: int  # 0: the blob moves along x, 1: along y
    half_m: float  # half side of the ArUco [m]
    sigma_px: float  # standard deviation of point spread and pixel box together [px]
    outwards: float  # on which side of the marker's centre the element lies, ±1
    ring_m: float  # outer edge of the ring, from the marker's centre [m]
    edge_m: float  # outline of the marker, from its centre [m]
    glare: float  # scatter of the foil along the element [DN]
    end_m: float  # half length of the element [m]
    middle_m: float  # middle of the element, along it [m]


@kernel
def _spill(columns, rows, sight, cells, value) -> None:
    """Blurred reflectance of the pattern at pixels (n,), in `value`."""
    block = new_block(sight, columns, rows)
    for start in range(0, len(columns), BLOCK):
        used = min(BLOCK, len(columns) - start)
        see(block, sight, columns, rows, start, used)
        shine(block, cells, sight.sigma_px, used)
        value[start : start + used] = block.value[:used]


@kernel
def readings_of(pixels, inverse, site, levels, template):
    """Readings of an element from pixels of the image (`detector.pattern.corner_fit.Readings`).

    `inverse`: image -> plane homography (3, 3). `levels`: the light of the pattern, see `detector.pattern.corner_fit.LEVELS`.
    `template`: the pattern itself, for its light that spills into the element where the blur is no longer narrow beside the ring.
    """
    columns, rows, data, saturated, extra, noise, _ = pixels
    axis, half, sigma_px, outwards, ring_m, edge_m, glare, end, middle = site
    n = len(columns)
    u, v, blur_v, spill, light = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty((4, n))
    less, variance, whites = np.empty(n), np.empty(n), np.empty(n)
    by_column, by_row = 0.0, 0.0
    for p in range(n):
        x, y, _, xu, xv, yu, yv = plane_point(inverse, columns[p], rows[p])
        white = levels[0] + (levels[2] + levels[6] * x + levels[7] * y) * x + (levels[3] + levels[8] * y) * y
        across = math.sqrt(yu * yu + yv * yv) if axis == 0 else math.sqrt(xu * xu + xv * xv)
        u[p], v[p], blur_v[p] = (x if axis == 0 else y) * half, (y if axis == 0 else x) * half, across * sigma_px * half
        by_column += (xu if axis == 0 else yu) * half / n
        by_row += (xv if axis == 0 else yv) * half / n
        spill[p] = white * edge((ring_m - outwards * v[p]) / blur_v[p])[0]
        whites[p] = white
        foil = edge((outwards * v[p] - edge_m) / blur_v[p])[0]
        less[p] = data[p] - spill[p]
        variance[p] = extra[p] + (foil * glare) ** 2
        light[0, p], light[1, p], light[2, p], light[3, p] = 0.0, 1.0, foil, foil * (u[p] - middle) / end
    if n > 0 and blur_v.max() * RING_BLURS > ring_m - half:
        _spill(columns, rows, Sight(inverse, template.lines, sigma_px), template.cells, spill)
        spill *= whites
        for p in range(n):
            less[p] = data[p] - spill[p]
    spread = math.sqrt(max(sigma_px**2 - 1 / 12, 0.0)) * math.sqrt(by_column**2 + by_row**2)
    blur = (spread, abs(by_column), abs(by_row))
    cell_m, taps = blur_taps(blur, CELLS_PER_SIGMA)
    coarse_cell_m, coarse_taps = blur_taps(blur, 1.0)
    return Readings(
        u=u,
        v=v,
        cell_m=cell_m,
        taps=taps,
        coarse_cell_m=coarse_cell_m,
        coarse_taps=coarse_taps,
        blur_v=blur_v,
        data=less,
        saturated=saturated,
        spill=spill,
        extra=variance,
        noise=noise,
        light=light,
    )


def thinned(readings: Readings, every: int) -> Readings:
    """Every so many of the readings, in memory of their own."""
    if every == 1:
        return readings
    return readings._replace(
        u=np.ascontiguousarray(readings.u[::every]),
        v=np.ascontiguousarray(readings.v[::every]),
        blur_v=np.ascontiguousarray(readings.blur_v[::every]),
        data=np.ascontiguousarray(readings.data[::every]),
        saturated=np.ascontiguousarray(readings.saturated[::every]),
        spill=np.ascontiguousarray(readings.spill[::every]),
        extra=np.ascontiguousarray(readings.extra[::every]),
        light=np.ascontiguousarray(readings.light[:, ::every]),
    )


@wide_kernel
def _shade_across(view, readings):
    """Part of each pixel (n,) that lies between the ends of the seen floor across the slits, blurred."""
    shade = np.empty(len(readings.v))
    for p in range(len(shade)):
        inverse = 1.0 / readings.blur_v[p]
        shade[p] = edge((readings.v[p] - view.low) * inverse)[0] - edge((readings.v[p] - view.high) * inverse)[0]
    return shade


@kernel
def _shine(view, readings, shade, blob, column):
    """Blurred light of a blob in every pixel (n,); 1 is fully lit floor."""
    grid = blurred_cells(view.numbers, view.slit_count, view.beside, blob, readings.cell_m, readings.taps)
    blob_profile(view.numbers, view.slit_count, grid, readings.cell_m, readings.u, column)
    column *= shade


@wide_kernel
def _weigh(readings, light, level, weight):
    """Inverse variances (n,) of pixels at given levels of light: noise, and the foil's unevenness as far as it spills in."""
    read_variance, gain, offset, limit = readings.noise
    for p in range(len(weight)):
        mean = readings.spill[p]
        for i in range(len(level)):
            mean += level[i] * light[i, p]
        mean = limit if readings.saturated[p] else min(mean, limit)
        weight[p] = 1.0 / (read_variance + gain * max(mean - offset, 0.0) + readings.extra[p])


@kernel
def _solve_levels(readings, light, weight, level, model) -> float:
    """Weighted least squares of columns of light (c, n): fills `level` (c,) and `model` (n,), returns chi-square.

    A saturated pixel pulls only where the model falls short of the ceiling.
    """
    count, n = light.shape
    limit, clipped = readings.noise[3], readings.saturated.any()
    normal, rhs = np.empty((count, count)), np.empty(count)
    pull, reading = weight, readings.data
    if clipped:
        pull, reading = weight.copy(), readings.data.copy()
        for p in range(n):
            if readings.saturated[p]:
                pull[p], reading[p] = 0.0, limit - readings.spill[p]
    chi2 = np.inf
    for _ in range(3 if clipped else 1):
        normal[:], rhs[:] = 0.0, 0.0
        add_products(light, pull, reading, n, normal, rhs)
        mirror(normal)
        if not solve_scaled(normal, rhs, 1e-9, level):
            return np.inf
        chi2 = _compare(light, level, weight, readings.data, model)
        if clipped:
            for p in range(n):
                if readings.saturated[p]:
                    short = max(reading[p] - model[p], 0.0)
                    pull[p] = weight[p] if short > 0 else 0.0
                    chi2 += weight[p] * (short**2 - (readings.data[p] - model[p]) ** 2)
    return chi2


@wide_kernel
def _compare(light, level, weight, data, model) -> float:
    """Model (n,) of some levels, and its chi-square."""
    chi2 = 0.0
    for p in range(len(model)):
        total = 0.0
        for i in range(len(level)):
            total += level[i] * light[i, p]
        model[p] = total
        chi2 += weight[p] * (data[p] - total) ** 2
    return chi2


@kernel
def search_positions(view, readings, starts, level):
    """Chi-square (k,) of blobs at some positions (k,), infinite where the blob would be dark; and chi-square without a blob.

    Levels are at their optimum, the noise is that of `level` (c,). A saturated pixel counts with the saturation level, and all
    with the light of the nearest cell of the coarse grid.
    """
    light, n, count = readings.light, len(readings.u), len(level)
    shade, weight = _shade_across(view, readings), np.empty(n)
    _weigh(readings, light, level, weight)
    sample = blurred_cells(
        view.numbers, view.slit_count, view.beside, 0.0, readings.coarse_cell_m, readings.coarse_taps
    )
    cells, scale = len(sample), 1 / readings.coarse_cell_m
    middle = view.numbers[0] + view.slit_count * view.numbers[1] / 2
    # Weighted sums, over the pixels of each cell, of shade × (shade, background …, reading).
    sums, fixed, rhs = np.zeros((count + 1, cells)), np.zeros((count, count)), np.zeros(count)
    power = 0.0
    for p in range(n):
        cell = min(max(int((readings.u[p] - middle) * scale + cells / 2), 0), cells - 1)
        reading = readings.noise[3] - readings.spill[p] if readings.saturated[p] else readings.data[p]
        shaded = weight[p] * shade[p]
        sums[0, cell] += shaded * shade[p]
        sums[count, cell] += shaded * reading
        power += weight[p] * reading * reading
        for i in range(1, count):
            sums[i, cell] += shaded * light[i, p]
            rhs[i] += weight[p] * light[i, p] * reading
            for j in range(1, i + 1):
                fixed[i, j] += weight[p] * light[i, p] * light[j, p]
    cost, fitted, at_lens = np.empty(len(starts)), np.empty(count), np.zeros(1)
    for k in range(len(starts)):
        profile = blurred_cells(
            view.numbers, view.slit_count, at_lens, starts[k], readings.coarse_cell_m, readings.coarse_taps
        )
        fixed[:, 0], rhs[0] = 0.0, 0.0
        for cell in range(cells):
            fixed[0, 0] += profile[cell] * profile[cell] * sums[0, cell]
            rhs[0] += profile[cell] * sums[count, cell]
            for i in range(1, count):
                fixed[i, 0] += profile[cell] * sums[i, cell]
        mirror(fixed)
        cost[k] = np.inf
        if solve_scaled(fixed, rhs, 1e-9, fitted) and fitted[0] > 0:
            cost[k] = power - (fitted * rhs).sum()
    blank = np.inf
    if solve_scaled(np.ascontiguousarray(fixed[1:, 1:]), rhs[1:], 1e-9, fitted[1:]):
        blank = power - (fitted[1:] * rhs[1:]).sum()
    return cost, blank


@kernel
def descend(view, readings, blob, pitch, level):
    """Gauss–Newton steps of a blob's position until it settles, none longer than half a pitch.

    Gives the position, then what `blob_step` tells of the last step.
    """
    last = blob_step(view, readings, blob, 0.05 * pitch, level)
    for _ in range(MAX_STEPS):
        step = min(max(last[0], -0.5 * pitch), 0.5 * pitch)
        blob += step
        if abs(step) < CONVERGED_PITCHES * pitch:
            break
        last = blob_step(view, readings, blob, 0.05 * pitch, level)
    return blob, last


@kernel
def blob_step(view, readings, blob, delta, level):
    """Gauss–Newton step of a blob's position, and how good the fit is.

    Gives the step, the position's variance, chi-square before, chi-square without a blob, and the number of readings that pull.

    The noise is that of `level` (c,), which then gets the levels' optimum at the position.
    """
    light, n, count = readings.light, len(readings.u), len(level) + 1
    below, above, model, weight = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    shade = _shade_across(view, readings)
    _shine(view, readings, shade, blob - delta, below)
    _shine(view, readings, shade, blob + delta, above)
    _shine(view, readings, shade, blob, light[0])
    _weigh(readings, light, level, weight)
    blank_chi2 = _solve_levels(readings, light[1:], weight, level[1:], model)
    chi2 = _solve_levels(readings, light, weight, level, model)
    slopes, residual = np.empty((count, n)), readings.data - model
    slopes[0] = (above - below) * (level[0] / (2 * delta))
    slopes[1:] = light
    pulling = n
    for p in range(n):
        if readings.saturated[p]:
            residual[p] = max(readings.noise[3] - readings.spill[p] - model[p], 0.0)
            if residual[p] == 0.0:
                weight[p] = 0.0
                pulling -= 1
    normal, rhs = np.zeros((count, count)), np.zeros(count)
    add_products(slopes, weight, residual, n, normal, rhs)
    mirror(normal)
    step, inverse = np.empty(count), np.empty((count, count))
    if not (solve_scaled(normal, rhs, 1e-9, step) and invert_scaled(normal, inverse)):
        return 0.0, np.inf, chi2, blank_chi2, pulling
    return step[0], inverse[0, 0], chi2, blank_chi2, pulling
