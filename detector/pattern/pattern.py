"""The printed pattern as the camera sees it: analytic image of the ArUco and its ring through a homography.

Plane coordinates are in half ArUco sides: x right, y up, the ArUco's corners at ±1. The blur of lens and pixel is
taken as one Gaussian of the same variance, σ² + 1/12 px²; carried into the plane it is a Gaussian again, whose
covariance has a small off-diagonal term when the marker is skewed. With that term to first order, the image of a
chequered plane is a bilinear form of one-dimensional edge responses.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from detector.compiled import BLOCK, EDGE_REACH, edge, inlined, kernel, wide_kernel
from radiometry.geometry import FloatArray
from scenes.marker import Element, MarkerDesign

#: Corners of the ArUco in plane coordinates, top left first, clockwise.
SQUARE = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
#: Blur deviations from an edge within which pixels know where it is: 98.9 % of the information, its error function.
KNOWING_REACH = 1.8
#: Blur deviations kept clear of light that a model does not know; so many bits at most, but never less than the least deviations.
CLEARANCE, CLEARANCE_BITS, LEAST_CLEARANCE = 2.5, 1.5, 1.5
#: No rectangle.
NOWHERE = np.empty((0, 4))


def kernel_sigma_px(psf_sigma_px: float) -> float:
    """Standard deviation of point spread and pixel box together [px]; the box of one pixel has variance 1/12."""
    return float(np.sqrt(psf_sigma_px**2 + 1 / 12))


def clearance_of(sigma_bits: float) -> float:
    """Blur deviations to keep clear of unknown light at a blur of so many bits: of a much blurred marker nothing else is left."""
    return max(min(CLEARANCE, CLEARANCE_BITS / sigma_bits), LEAST_CLEARANCE)


def homography(corners_px: FloatArray) -> FloatArray:
    """Plane -> image homography (3, 3), last element 1, through four corners (4, 2) in the order of `SQUARE`.

    Of corners of which three lie on a line there is none: its elements are infinite or NaN.
    """
    return np.asarray(homography_through(np.asarray(corners_px, float)))


@kernel
def homography_through(corners: FloatArray) -> FloatArray:
    """See `homography`; the closed form of Heckbert (Fundamentals of texture mapping and image warping, 1989, 2.2.3)."""
    skew = corners[0] - corners[1] + corners[2] - corners[3]
    one, two = corners[1] - corners[2], corners[3] - corners[2]
    area = one[0] * two[1] - one[1] * two[0]
    g = (skew[0] * two[1] - skew[1] * two[0]) / area
    h = (one[0] * skew[1] - one[1] * skew[0]) / area
    matrix = np.empty((3, 3))
    for k in range(2):
        along = corners[1, k] - corners[0, k] + g * corners[1, k]
        down = corners[3, k] - corners[0, k] + h * corners[3, k]
        # From the unit square, y down, to ours.
        matrix[k, 0], matrix[k, 1], matrix[k, 2] = along / 2, -down / 2, (along + down) / 2 + corners[0, k]
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = g / 2, -h / 2, (g + h) / 2 + 1
    return matrix / matrix[2, 2]


@kernel
def inverse3(m: FloatArray) -> FloatArray:
    """Inverse of a (3, 3) matrix by cofactors."""
    inverse = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    return inverse / (m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[1, 0] + m[0, 2] * inverse[2, 0])


def project(matrix: FloatArray, plane: FloatArray) -> FloatArray:
    """Image positions (..., 2) [px] of plane points (..., 2)."""
    p = plane @ matrix[:, :2].T + matrix[:, 2]
    return p[..., :2] / p[..., 2:]


@inlined
def image_of(matrix: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Image position (column, row) [px] of one plane point."""
    w = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    u = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
    v = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
    return u / w, v / w


@inlined
def plane_point(inverse: FloatArray, u: float, v: float) -> tuple[float, float, float, float, float, float, float]:
    """Plane point of an image position through an inverse homography.

    Gives x, y, the projective depth of the forward map, and the derivatives ∂x/∂u, ∂x/∂v, ∂y/∂u, ∂y/∂v [1/px].
    """
    w = 1.0 / (inverse[2, 0] * u + inverse[2, 1] * v + inverse[2, 2])
    x = (inverse[0, 0] * u + inverse[0, 1] * v + inverse[0, 2]) * w
    y = (inverse[1, 0] * u + inverse[1, 1] * v + inverse[1, 2]) * w
    return (
        x,
        y,
        w,
        (inverse[0, 0] - x * inverse[2, 0]) * w,
        (inverse[0, 1] - x * inverse[2, 1]) * w,
        (inverse[1, 0] - y * inverse[2, 0]) * w,
        (inverse[1, 1] - y * inverse[2, 1]) * w,
    )


class Sight(NamedTuple):
    """How the camera sees the pattern's grid."""

    inverse: FloatArray  # image -> plane homography, (3, 3)
    lines: FloatArray  # grid lines of the cells, along x as along y, ascending [plane units], (n + 1,)
    sigma_px: float  # standard deviation of the blur


class Edges(NamedTuple):
    """Which edges of a pattern a pixel should be near to be selected."""

    lines: FloatArray  # grid lines, along x as along y; empty where every pixel is wanted
    sigma_px: float  # standard deviation of the blur
    clearance: float  # the blur reaches a rectangle from this many deviations on
    only: FloatArray  # rectangles x0, x1, y0, y1 of the plane, (k, 4): a pixel's blur must touch one of them; none: anywhere
    never: FloatArray  # rectangles that a pixel's blur must not touch, (k, 4)


class Strips(NamedTuple):
    """What strips of cells, from the first that the blur reaches on, put into some pixels."""

    first: NDArray[np.int64]  # index of the first strip, (BLOCK,)
    share: FloatArray  # part of the pixel's blur that lies in each strip, (strips, BLOCK)
    slope: FloatArray  # derivative of the share by the place of the pixel [1/plane unit], (strips, BLOCK)
    spread: FloatArray  # derivative of the share by the logarithm of the blur, (strips, BLOCK)


class Block(NamedTuple):
    """Some pixels seen through an inverse homography, each field (BLOCK,) unless stated."""

    x: FloatArray  # plane point
    y: FloatArray
    w: FloatArray  # projective depth of the forward map
    xu: FloatArray  # derivatives ∂x/∂u, ∂x/∂v, ∂y/∂u, ∂y/∂v [1/px]
    xv: FloatArray
    yu: FloatArray
    yv: FloatArray
    columns: Strips  # strips of cells along x
    rows: Strips  # strips of cells along y
    value: FloatArray  # blurred reflectance and its derivatives by x, by y and by the logarithm of the blur
    by_x: FloatArray
    by_y: FloatArray
    by_blur: FloatArray


@kernel
def new_block(sight, columns, rows):
    """Room for pixels (n,), with as many strips as the blur reaches in any of them."""
    inverse, lines, sigma_px = sight
    widest, narrowest = 0.0, np.inf
    for p in range(len(columns)):
        _, _, _, xu, xv, yu, yv = plane_point(inverse, columns[p], rows[p])
        widest = max(widest, xu * xu + xv * xv, yu * yu + yv * yv)
    for k in range(len(lines) - 1):
        narrowest = min(narrowest, lines[k + 1] - lines[k])
    reach = 2 * EDGE_REACH * sigma_px * math.sqrt(widest) / narrowest
    strips = min(int(reach) + 2, len(lines) - 1) if reach < len(lines) else len(lines) - 1
    shares = np.empty((6, strips, BLOCK))
    reals = np.empty((11, BLOCK))
    return Block(
        x=reals[0],
        y=reals[1],
        w=reals[2],
        xu=reals[3],
        xv=reals[4],
        yu=reals[5],
        yv=reals[6],
        columns=Strips(np.empty(BLOCK, np.int64), shares[0], shares[1], shares[4]),
        rows=Strips(np.empty(BLOCK, np.int64), shares[2], shares[3], shares[5]),
        value=reals[7],
        by_x=reals[8],
        by_y=reals[9],
        by_blur=reals[10],
    )


@wide_kernel
def see(block, sight, columns, rows, start, used) -> None:
    """Plane points and shares of the strips for `used` pixels from `start` on."""
    inverse, lines, sigma_px = sight
    scale_x, scale_y = np.empty(BLOCK), np.empty(BLOCK)
    x, y, w, xu, xv, yu, yv = block.x, block.y, block.w, block.xu, block.xv, block.yu, block.yv
    a, b, c, d, e, f, g, h, i = inverse.flat
    for p in range(used):
        column, row = columns[start + p], rows[start + p]
        w[p] = 1 / (g * column + h * row + i)
        x[p], y[p] = (a * column + b * row + c) * w[p], (d * column + e * row + f) * w[p]
        xu[p], xv[p] = (a - x[p] * g) * w[p], (b - x[p] * h) * w[p]
        yu[p], yv[p] = (d - y[p] * g) * w[p], (e - y[p] * h) * w[p]
        scale_x[p] = 1 / (sigma_px * math.sqrt(xu[p] * xu[p] + xv[p] * xv[p]))
        scale_y[p] = 1 / (sigma_px * math.sqrt(yu[p] * yu[p] + yv[p] * yv[p]))
    _share(x, scale_x, lines, used, block.columns)
    _share(y, scale_y, lines, used, block.rows)


@wide_kernel
def _share(place, scale, lines, used, strips) -> None:
    """What strips of cells between neighbouring lines put into pixels at places (n,) blurred by 1/`scale`."""
    first, share, slope, spread = strips
    count, before, peak_before, away_before = len(lines) - 1, np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    # The lines between the ring's are evenly spaced.
    start, per_line = lines[1], 1 / (lines[2] - lines[1])
    for p in range(used):
        near = place[p] - EDGE_REACH / scale[p]
        first[p] = min(int(max((near - start) * per_line + 1, 0.0)), count - 1)
        away_before[p] = (place[p] - lines[first[p]]) * scale[p]
        before[p], peak_before[p] = edge(away_before[p])
    for k in range(len(share)):
        part, part_slope, part_spread = share[k], slope[k], spread[k]
        for p in range(used):
            away = (place[p] - lines[min(first[p] + k + 1, count)]) * scale[p]
            away = min(max(away, -EDGE_REACH), EDGE_REACH)
            after, peak_after = edge(away)
            part[p], part_slope[p] = before[p] - after, (peak_before[p] - peak_after) * scale[p]
            # With z = d/σ, dΦ(z)/d ln σ = −z φ(z).
            part_spread[p] = away * peak_after - away_before[p] * peak_before[p]
            before[p], peak_before[p], away_before[p] = after, peak_after, away


@wide_kernel
def shine(block, cells, sigma_px, used) -> None:
    """Blurred reflectance of the cells (n, n) in `used` pixels, and its derivatives by x and y, from what `see` left."""
    first_x, share_x, slope_x, spread_x = block.columns
    first_y, share_y, slope_y, spread_y = block.rows
    last, strips = len(cells) - 1, len(share_x)
    for p in range(used):
        value = by_x = by_y = by_both = by_blur = 0.0
        for i in range(strips):
            strip = cells[min(first_x[p] + i, last)]
            across = across_slope = across_spread = 0.0
            for j in range(strips):
                cell = strip[min(first_y[p] + j, last)]
                across += cell * share_y[j, p]
                across_slope += cell * slope_y[j, p]
                across_spread += cell * spread_y[j, p]
            value += share_x[i, p] * across
            by_x += slope_x[i, p] * across
            by_y += share_x[i, p] * across_slope
            by_both += slope_x[i, p] * across_slope
            by_blur += spread_x[i, p] * across + share_x[i, p] * across_spread
        skew = block.xu[p] * block.yu[p] + block.xv[p] * block.yv[p]
        askew = sigma_px * sigma_px * skew * by_both
        block.value[p] = value + askew
        block.by_x[p], block.by_y[p], block.by_blur[p] = by_x, by_y, by_blur + 2 * askew


@wide_kernel
def _know_edges(inverse, edges, row, first, stride, wanted) -> None:
    """Which of every `stride`-th pixel of a row from `first` on `select_pixels` wants; without branches, several at a time."""
    lines, sigma_px, clearance, only, never = edges
    steps, outer = len(lines) - 3.0, lines[len(lines) - 1]
    step, per_step = 2 / steps, steps / 2
    knowing, clear = (KNOWING_REACH * sigma_px) ** 2, clearance / KNOWING_REACH
    count = len(wanted)
    place = np.empty((4, count))
    x, y, reach_x, reach_y = place[0], place[1], place[2], place[3]
    for p in range(count):
        column = first + p * stride
        w = 1.0 / (inverse[2, 0] * column + inverse[2, 1] * row + inverse[2, 2])
        x[p] = (inverse[0, 0] * column + inverse[0, 1] * row + inverse[0, 2]) * w
        y[p] = (inverse[1, 0] * column + inverse[1, 1] * row + inverse[1, 2]) * w
        xu, xv = (inverse[0, 0] - x[p] * inverse[2, 0]) * w, (inverse[0, 1] - x[p] * inverse[2, 1]) * w
        yu, yv = (inverse[1, 0] - y[p] * inverse[2, 0]) * w, (inverse[1, 1] - y[p] * inverse[2, 1]) * w
        square_x, square_y = knowing * (xu * xu + xv * xv), knowing * (yu * yu + yv * yv)
        # Distance to the nearest of the lines −1, −1 + step, …, 1, and ±outer.
        to_x = x[p] + 1.0 - step * min(max(math.floor((x[p] + 1.0) * per_step + 0.5), 0.0), steps)
        to_y = y[p] + 1.0 - step * min(max(math.floor((y[p] + 1.0) * per_step + 0.5), 0.0), steps)
        out_x, out_y = abs(x[p]) - outer, abs(y[p]) - outer
        wanted[p] = (min(to_x * to_x, out_x * out_x) < square_x) | (min(to_y * to_y, out_y * out_y) < square_y)
        reach_x[p], reach_y[p] = clear * math.sqrt(square_x), clear * math.sqrt(square_y)
    if len(only) > 0:
        touched = np.zeros(count, np.bool_)
        for k in range(len(only)):
            _touch(only[k], x, y, reach_x, reach_y, touched)
        for p in range(count):
            wanted[p] &= touched[p]
    if len(never) > 0:
        touched = np.zeros(count, np.bool_)
        for k in range(len(never)):
            _touch(never[k], x, y, reach_x, reach_y, touched)
        for p in range(count):
            wanted[p] &= not touched[p]


@wide_kernel
def _touch(rectangle, x, y, reach_x, reach_y, touched) -> None:
    """Mark the points (n,) within reach of a rectangle x0, x1, y0, y1."""
    left, right, bottom, top = rectangle[0], rectangle[1], rectangle[2], rectangle[3]
    for p in range(len(touched)):
        touched[p] |= (
            (x[p] + reach_x[p] > left)
            & (x[p] - reach_x[p] < right)
            & (y[p] + reach_y[p] > bottom)
            & (y[p] - reach_y[p] < top)
        )


@kernel
def _sides(matrix, reach, margin_px):
    """The four sides (4, 3) of a plane's square |x|, |y| <= reach in the image, moved inwards by a margin, and its area [px²].

    Pixels (u, v) with a u + b v >= c for every row lie inside. The area is NaN where the square is none.
    """
    corners, sides, area = np.empty((4, 2)), np.empty((4, 3)), 0.0
    for k in range(4):
        corners[k, 0], corners[k, 1] = image_of(matrix, SQUARE[k, 0] * reach, SQUARE[k, 1] * reach)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        area += (a[0] * b[1] - a[1] * b[0]) / 2
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) * (1.0 if area > 0 else -1.0)
        sides[k, 0], sides[k, 1] = (a[1] - b[1]) / length, (b[0] - a[0]) / length
        sides[k, 2] = sides[k, 0] * a[0] + sides[k, 1] * a[1] + margin_px
    return sides, abs(area) if area != 0 else np.nan, corners


@kernel
def select_pixels(
    matrix: FloatArray,
    reach: float,
    shape: tuple[int, int],
    margin_px: float,
    most: float,
    edges: Edges,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of the pixels of an image that lie within a square of the marker's plane.

    Args:
        matrix: plane -> image homography, (3, 3).
        reach: the square is |x|, |y| <= reach [plane units].
        shape: rows and columns of the image.
        margin_px: the square is made smaller by this much on each side [px]; negative makes it larger.
        most: of more pixels than this, about as many are taken, spread evenly.
        edges: with lines, only pixels that the blur of one of these lines reaches, and as its rectangles say.

    Returns:
        Columns (n,) and rows (n,), row by row.
    """
    height, width = shape
    none = np.empty(0, np.int64)
    sides, area, corners = _sides(matrix, reach, margin_px)
    if not math.isfinite(area):
        return none, none
    grow = max(-margin_px, 0.0)
    near, share = len(edges.lines) > 0, 1.0
    if near:
        strip = 2 * KNOWING_REACH * edges.sigma_px * len(edges.lines) / math.sqrt(area)
        share = 1 - max(1 - strip, 0.0) ** 2
    stride = int(min(area * share / most, 1e6)) + 1
    y0, y1 = max(math.floor(corners[:, 1].min() - grow), 0), min(math.ceil(corners[:, 1].max() + grow), height - 1)
    x0, x1 = max(math.floor(corners[:, 0].min() - grow), 0), min(math.ceil(corners[:, 0].max() + grow), width - 1)
    if x1 < x0 or y1 < y0:
        return none, none
    columns = np.empty((y1 - y0 + 1) * ((x1 - x0) // stride + 1), np.int64)
    rows = np.empty_like(columns)
    inverse, count = inverse3(matrix), 0
    wanted = np.ones((x1 - x0) // stride + 1, np.bool_)
    for row in range(y0, y1 + 1):
        low, high = float(x0), float(x1)
        for k in range(4):
            room = sides[k, 2] - sides[k, 1] * row
            if sides[k, 0] > 0:
                low = max(low, room / sides[k, 0])
            elif sides[k, 0] < 0:
                high = min(high, room / sides[k, 0])
            elif room > 0:
                high = -1.0
        start = int((row * 0.6180339887498949) % 1.0 * stride)  # golden ratio: no row, column or diagonal is left out
        first = x0 + start + stride * max(math.ceil((low - x0 - start) / stride), 0)
        length = (math.floor(high) - first) // stride + 1
        if length <= 0:
            continue
        if near:
            _know_edges(inverse, edges, row, first, stride, wanted[:length])
        for p in range(length):
            columns[count], rows[count] = first + p * stride, row
            count += wanted[p]
    return columns[:count].copy(), rows[:count].copy()


#: Every pixel, near an edge or not.
EVERYWHERE = Edges(np.empty(0), 0.0, 0.0, NOWHERE, NOWHERE)


@kernel
def is_inside(matrix: FloatArray, reach: float, height: int, width: int) -> bool:
    """Whether the plane's square |x|, |y| <= reach lies within the image."""
    inside = True
    for k in range(4):
        u, v = image_of(matrix, SQUARE[k, 0] * reach, SQUARE[k, 1] * reach)
        inside &= -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5
    return inside


def pixels_within(matrix: FloatArray, reach: float, shape: tuple[int, int], margin_px: float = 0.0) -> FloatArray:
    """Pixel centres (n, 2) of an image of `shape` that lie in the plane's square |x|, |y| <= reach, less a margin [px]."""
    return np.stack(pixels_of(matrix, reach, shape, margin_px, np.inf), -1).astype(float)


def pixels_of(
    matrix: FloatArray, reach: float, shape: tuple[int, ...], margin_px: float, most: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of the pixels of an image of `shape` within a square of the plane; see `select_pixels`."""
    columns, rows = select_pixels(matrix, reach, (shape[0], shape[1]), margin_px, most, EVERYWHERE)
    return columns, rows


@kernel
def nearest_pixels(
    matrix: FloatArray, points: FloatArray, height: int, width: int, columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> bool:
    """Nearest pixels of plane points (n, 2), at the image's edge for those outside; False where there are such."""
    inside = True
    for k in range(len(points)):
        u, v = image_of(matrix, points[k, 0], points[k, 1])
        inside &= -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5
        columns[k] = math.floor(min(max(u, 0.0), width - 1.0) + 0.5)
        rows[k] = math.floor(min(max(v, 0.0), height - 1.0) + 0.5)
    return inside


@kernel
def _pattern_values(columns, rows, matrix, sigma_px, lines, cells):
    value, gradient = np.empty(len(columns)), np.empty((len(columns), 2))
    sight = Sight(inverse3(matrix), lines, sigma_px)
    block = new_block(sight, columns, rows)
    for start in range(0, len(columns), BLOCK):
        used = min(BLOCK, len(columns) - start)
        see(block, sight, columns, rows, start, used)
        shine(block, cells, sigma_px, used)
        for p in range(used):
            value[start + p] = block.value[p]
            gradient[start + p, 0] = block.by_x[p] * block.xu[p] + block.by_y[p] * block.yu[p]
            gradient[start + p, 1] = block.by_x[p] * block.xv[p] + block.by_y[p] * block.yv[p]
    return value, gradient


def opening_of(element: Element, low_m: float, high_m: float) -> FloatArray:
    """Rectangle x0, x1, y0, y1 [m] of an element's opening between two coordinates along it."""
    middle, half = element.shift_m, element.length_m / 2
    along = np.clip([low_m, high_m], middle - half, middle + half)
    across = float(element.centre_m @ element.across) + np.array([-0.5, 0.5]) * element.width_m
    return np.concatenate([along, across] if abs(element.along[0]) > 0.5 else [across, along])


class Pattern:
    """Reflectance of the ArUco (border included) and its ring as cells between grid lines; nothing outside reflects."""

    def __init__(self, marker: MarkerDesign):
        self.marker = marker
        count = len(marker.bits)
        ring = 1 + 2 * marker.ring_fraction
        self.lines = np.concatenate([[-ring], np.linspace(-1, 1, count + 1), [ring]])
        #: Plane coordinates of the ring's outer edge, and of the marker's outline.
        self.ring, self.outline = ring, marker.size_m / marker.aruco_m
        half = marker.aruco_m / 2
        #: Openings of the elements (4, 4): x0, x1, y0, y1.
        self.openings = np.array([opening_of(e, -e.length_m, e.length_m) for e in marker.elements]) / half

    def bit_px(self, matrix: FloatArray) -> float:
        """What a bit spans through a homography (3, 3): the root of its area at the marker's centre [px]."""
        slope = matrix[:2, :2] - np.outer(matrix[:2, 2], matrix[2, :2])
        return float(np.sqrt(abs(np.linalg.det(slope)))) * 2 / len(self.marker.bits)

    @cached_property
    def cells(self) -> FloatArray:
        """Cells (n, n), first index along x, second along y (both ascending), ring included."""
        return self.with_bits(self.marker.bits)

    @cached_property
    def probes(self) -> FloatArray:
        """Plane points (64, 2): eight on each side along the middle of the ring, then as many along the border's middle."""
        along = np.linspace(-0.85, 0.85, 8)
        middles = 1 + self.marker.ring_fraction, 1 - 1 / len(self.marker.bits)
        ones = np.ones(8)
        top = [np.stack([along, middle * ones], -1) for middle in middles]
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        return np.concatenate([side @ np.linalg.matrix_power(turn, k) for side in top for k in range(4)])

    @staticmethod
    def with_bits(bits: NDArray[np.bool_]) -> FloatArray:
        """Cells of any printed pattern: its bits inside a reflective ring."""
        return np.ascontiguousarray(np.pad(bits[::-1].T.astype(float), 1, constant_values=1.0))

    def value_and_gradient(
        self, pixels: FloatArray, matrix: FloatArray, sigma_px: float
    ) -> tuple[FloatArray, FloatArray]:
        """Blurred reflectance (n,) at pixels (n, 2) through a homography, and its gradient in the image (n, 2) [1/px]."""
        columns, rows = np.ascontiguousarray(np.asarray(pixels, float).T)
        return _pattern_values(columns, rows, matrix, sigma_px, self.lines, self.cells)
