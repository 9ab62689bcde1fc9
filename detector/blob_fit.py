"""Loops over the pixels of an encoding element: where they lie, and least squares of the light in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detector.compiled import edge, invert_scaled, kernel, mirror, solve_scaled
from detector.pattern import plane_point
from detector.slits import CELLS_PER_SIGMA, blob_profile, blurred_cells
from radiometry.geometry import FloatArray

#: A Gauss–Newton step below this ends the descent, in slit pitches: what it leaves is of second order.
CONVERGED_PITCHES = 0.05


class Readings(NamedTuple):
    """Some pixels of an element."""

    u: FloatArray  # along the element [m], (n,)
    v: FloatArray  # across [m], (n,)
    blur_u: float  # mean blur along [m]
    blur_v: FloatArray  # blur across [m], (n,)
    data: FloatArray  # readings less the light spilt from the ring [DN], (n,)
    saturated: NDArray[np.bool_]  # (n,)
    spill: FloatArray  # the light spilt from the ring [DN], (n,)
    extra: FloatArray  # variance beyond the noise model's [DN²], (n,)
    noise: FloatArray  # see `detector.corners.noise_numbers`
    light: FloatArray  # room for the blob, then background, share of the foil, and that share times u, (4, n)


class View(NamedTuple):
    """The slits as the camera sees them; see `detector.slits.Slits`."""

    numbers: FloatArray
    slit_count: int
    beside: FloatArray
    low: float  # ends of the seen floor across the slits, from the marker's centre [m]
    high: float


@kernel
def readings_of(columns, rows, data, saturated, extra, noise, inverse, axis, geometry, levels):
    """Readings of pixels (n,); `geometry`: half ArUco side [m], blur [px], side of the element (±1), edges of ring and marker
    [m], scatter of the foil along the element [DN], half length of the element [m]."""
    half, sigma_px, outwards, ring_m, edge_m, glare, end = geometry
    n = len(columns)
    u, v, blur_v, spill, light = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty((4, n))
    less, variance = np.empty(n), np.empty(n)
    blur_u = 0.0
    for p in range(n):
        x, y, _, xu, xv, yu, yv = plane_point(inverse, columns[p], rows[p])
        white = levels[0] + levels[2] * x + levels[3] * y
        blur_x, blur_y = math.sqrt(xu * xu + xv * xv), math.sqrt(yu * yu + yv * yv)
        if axis == 1:
            x, y, blur_x, blur_y = y, x, blur_y, blur_x
        u[p], v[p], blur_v[p] = x * half, y * half, blur_y * sigma_px * half
        blur_u += blur_x * sigma_px * half / n
        spill[p] = white * edge((ring_m - outwards * v[p]) / blur_v[p])[0]
        foil = edge((outwards * v[p] - edge_m) / blur_v[p])[0]
        less[p] = data[p] - spill[p]
        variance[p] = extra[p] + (foil * glare) ** 2
        light[0, p], light[1, p], light[2, p], light[3, p] = 0.0, 1.0, foil, foil * u[p] / end
    return u, v, blur_u, blur_v, less, saturated, spill, variance, noise, light


@kernel
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
    blob_profile(view.numbers, view.slit_count, view.beside, blob, readings.blur_u, readings.u, column)
    column *= shade


@kernel
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
    limit = readings.noise[3]
    normal, rhs = np.empty((count, count)), np.empty(count)
    clipped = readings.saturated.any()
    chi2 = np.inf
    for turn in range(3 if clipped else 1):
        normal[:], rhs[:] = 0.0, 0.0
        for p in range(n):
            reading = readings.data[p]
            if readings.saturated[p]:
                reading = limit - readings.spill[p]
                if turn == 0 or model[p] >= reading:
                    continue
            for i in range(count):
                scaled = weight[p] * light[i, p]
                rhs[i] += scaled * reading
                for j in range(i + 1):
                    normal[i, j] += scaled * light[j, p]
        mirror(normal)
        if not solve_scaled(normal, rhs, 1e-9, level):
            return np.inf
        chi2 = 0.0
        for p in range(n):
            total = 0.0
            for i in range(count):
                total += level[i] * light[i, p]
            model[p] = total
            residual = readings.data[p] - total
            if readings.saturated[p]:
                residual = max(limit - readings.spill[p] - total, 0.0)
            chi2 += weight[p] * residual * residual
    return chi2


@kernel
def search_positions(view, readings, starts, level):
    """Chi-square (k,) of blobs at some positions (k,), levels at their optimum and the noise of `level` (c,); infinite where
    the blob would be dark. A saturated pixel counts with the saturation level, and all with the light of the nearest cell."""
    light, n, count = readings.light, len(readings.u), len(level)
    shade, weight = _shade_across(view, readings), np.empty(n)
    _weigh(readings, light, level, weight)
    sample = blurred_cells(view.numbers, view.slit_count, view.beside, 0.0, readings.blur_u)
    cells, scale = len(sample), CELLS_PER_SIGMA / readings.blur_u
    # Weighted sums, over the pixels of each cell, of shade × (shade, background …, reading).
    sums, fixed, rhs = np.zeros((count + 1, cells)), np.zeros((count, count)), np.zeros(count)
    power = 0.0
    for p in range(n):
        cell = min(max(int(readings.u[p] * scale + cells / 2), 0), cells - 1)
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
    cost, fitted = np.empty(len(starts)), np.empty(count)
    for k in range(len(starts)):
        profile = blurred_cells(view.numbers, view.slit_count, view.beside, starts[k], readings.blur_u)
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
    return cost


@kernel
def descend(view, readings, blob, pitch, steps, level):
    """Gauss–Newton steps of a blob's position, no longer than half a pitch each: the position, and what the blob gains in
    chi-square."""
    gain = 0.0
    for _ in range(steps):
        step, _, chi2, blank, _ = blob_step(view, readings, blob, 0.05 * pitch, level)
        step = min(max(step, -0.5 * pitch), 0.5 * pitch)
        blob += step
        gain = blank - chi2
        if abs(step) < CONVERGED_PITCHES * pitch:
            break
    return blob, gain


@kernel
def blob_step(view, readings, blob, delta, level):
    """Gauss–Newton step of a blob's position, its variance, chi-square before, chi-square without a blob, and the number of
    readings that pull.

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
    normal, rhs, slope = np.zeros((count, count)), np.zeros(count), np.empty(count)
    pulling = 0
    for p in range(n):
        residual = readings.data[p] - model[p]
        if readings.saturated[p]:
            residual = readings.noise[3] - readings.spill[p] - model[p]
            if residual <= 0:
                continue
        pulling += 1
        slope[0] = level[0] * (above[p] - below[p]) / (2 * delta)
        for i in range(1, count):
            slope[i] = light[i - 1, p]
        for i in range(count):
            scaled = weight[p] * slope[i]
            rhs[i] += scaled * residual
            for j in range(i + 1):
                normal[i, j] += scaled * slope[j]
    mirror(normal)
    step, inverse = np.empty(count), np.empty((count, count))
    if not (solve_scaled(normal, rhs, 1e-9, step) and invert_scaled(normal, inverse)):
        return 0.0, np.inf, chi2, blank_chi2, pulling
    return step[0], inverse[0, 0], chi2, blank_chi2, pulling
