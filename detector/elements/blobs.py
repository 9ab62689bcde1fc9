"""Sub-pixel position of the blob in an encoding element, by fitting the light its slits let through.

Through slit i, between walls that converge on the virtual line, floor is both lit and seen along an interval that
shrinks linearly with the slit's distance from the blob; the blob is the triangle of those intervals. Its analytic image
is fitted in the marker's plane: position along the element, brightness, background, and light spilt from the foil. A
saturated pixel only says that the model should reach the saturation level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from detector.compiled import kernel
from detector.elements.blob_fit import Site, View, blob_step, descend, readings_of, search_positions, thinned
from detector.elements.slits import Slits
from detector.pattern.corner_fit import Template
from detector.pattern.corners import PatternFit, gather, sample
from detector.pattern.decode import decoder_of
from detector.pattern.pattern import inverse3, is_inside, nearest_pixels, pixels_of, project
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import Element, MarkerDesign

#: Pixels of the descent, which only has to come close, and the most of the last step, which takes all that they know.
DESCENT_PIXELS, MAX_PIXELS = 220, 4000
#: Distance of the positions that are searched, in slit pitches: well within the triangle, whose half width is four.
SEARCH_PITCHES = 2.0
#: What the slit model leaves in a blob without any noise, standard deviation: in pixels, and in slit pitches at 1 m, falling with
#: the range. Measured on ray-traced frames, 1 to 10 m, with a ring of lights of known radius.
MODEL_SIGMA_PX, MODEL_SIGMA_PITCH_M = 0.003, 0.0013
#: Where the radius is not known, this one is taken [m] (the thesis's; assumption), and more pitches at 1 m go into the standard
#: deviation: measured for lights at the lens and on a ring of twice the radius.
USUAL_RING_M, UNKNOWN_RING_PITCH_M = 0.05, 0.015
#: The last steps are repeated, this often at most, while they are longer than these slit pitches: what shorter ones leave is of
#: second order.
LAST_STEPS, LAST_PITCHES = 3, 0.02
#: A blob is found where it lowers chi-square by this much: five standard deviations.
DETECTION_CHI2 = 25.0
#: Largest part of the blob's light that may be lost at the element's end; the model knows the end, and what it leaves grows with
#: that part [px]: measured on ray-traced frames, 0.015 px at 0.3.
MAX_CUT_FRACTION, MODEL_SIGMA_CUT_PX = 0.3, 0.05
#: What light spilt between pattern, elements and background leaves in a blob through a wide blur, standard deviation over the
#: blur: it grows with the blur in bits, to this power. Measured on synthetic frames with a blur of 0.3 to 0.7 bits.
SPILT_SIGMA, SPILT_POWER = 0.19, 4
#: Variance left beyond the noise, over the variance explained, above which the light is no blob. Assumption.
MAX_UNEXPLAINED = 0.5


@dataclass(frozen=True)
class Blob:
    """A blob: coordinate along the element in the front plane, and its image."""

    offset_m: float
    position_px: FloatArray  # (2,)
    sigma_px: float  # standard deviation along the element
    unexplained: float
    half_width_m: float  # how far along the element its light reaches


@dataclass(frozen=True)
class _Layout:
    """An element in plane coordinates, half ArUco sides."""

    element: Element
    place: FloatArray  # (3, 3): the square [−1, 1]² onto the opening
    foil: FloatArray  # points (n, 2) just outside the marker, beside the element
    axis: int  # 0: the blob moves along x, 1: along y
    outwards: float  # on which side of the centre the element lies, ±1
    middle_m: float  # of the element, across it


@lru_cache(maxsize=8)
def _layouts(marker: MarkerDesign) -> tuple[_Layout, ...]:
    half, found = marker.aruco_m / 2, []
    for e in marker.elements:
        centre, along, across = (vector[:2] for vector in (e.centre_m, e.along, e.across))
        extent = np.abs(along) * e.length_m / 2 + np.abs(across) * e.width_m / 2
        middle = centre + e.shift_m * along
        place = np.array([[extent[0] / half, 0, middle[0] / half], [0, extent[1] / half, middle[1] / half], [0, 0, 1]])
        outwards = float(np.sign(centre @ across))
        foil_m = (
            along * (np.linspace(-0.5, 0.5, 24)[:, None] * e.length_m + e.shift_m)
            + across * outwards * 1.03 * marker.size_m / 2
        )
        axis = int(abs(along[1]) > 0.5)
        found.append(_Layout(e, place, foil_m / half, axis, outwards, float(e.centre_m @ e.across)))
    return tuple(found)


@dataclass(frozen=True)
class _Sighting:
    """What is known of a marker before its elements are looked at."""

    image: np.ndarray
    fit: PatternFit
    marker: MarkerDesign
    sigma_px: float  # standard deviation of point spread and pixel box together
    noise: NoiseModel
    range_m: float
    light_ring_m: float | None


class _ElementImage:
    """Pixels of one element and the cost of a blob at given positions, everything else fitted."""

    def __init__(self, sighting: _Sighting, layout: _Layout):
        image, fit, marker, noise = sighting.image, sighting.fit, sighting.marker, sighting.noise
        self.marker, self.layout, self.fit, self.element = marker, layout, fit, layout.element
        self.range_m, self.light_ring_m, self.sigma_px = sighting.range_m, sighting.light_ring_m, sighting.sigma_px
        half = marker.aruco_m / 2
        moved = fit.matrix @ layout.place
        height, width = image.shape
        self.whole = is_inside(moved, 1.0, height, width)
        self.gain = 0.0  # chi-square the rough position gains, where most of the blob is in the opening
        self.count = 0
        if not self.whole:
            return
        columns, rows = pixels_of(moved / moved[2, 2], 1.0, image.shape, -0.5, MAX_PIXELS)
        self.seen = seen = sample(image, columns, rows, np.zeros(2), noise)
        self.count = len(seen.data)
        if self.count < 8:
            return
        site = Site(
            axis=layout.axis,
            half_m=half,
            sigma_px=sighting.sigma_px,
            outwards=layout.outwards,
            ring_m=half * (1 + 2 * marker.ring_fraction),
            edge_m=marker.size_m / 2,
            glare=_scatter(image, fit.matrix, layout.foil),
            end_m=layout.element.length_m / 2,
            middle_m=float(layout.element.shift_m),
        )
        #: Levels of blob and background, and of the foil and its slope, where it spills in.
        self.level = np.zeros(4)
        pattern = decoder_of(marker).pattern
        template = Template(pattern.lines, pattern.cells, sighting.sigma_px, 1.0)
        self.all = readings_of(seen, inverse3(fit.matrix), site, fit.levels_dn, template)
        if self.all.light[2].max() < 1e-3:
            self.level = np.zeros(2)
            self.all = self.all._replace(light=self.all.light[:2])
        self.few = thinned(self.all, -(-self.count // DESCENT_PIXELS))
        self.level[1] = fit.black_dn
        self.look_from(np.array([0.0, 0.0, self.range_m]))

    def look_from(self, camera_m: FloatArray) -> None:
        """Set where the camera stands in the marker frame."""
        ring_m = USUAL_RING_M if self.light_ring_m is None else self.light_ring_m
        self.slits = slits = Slits(self.marker, self.element, camera_m, ring_m)
        low, high = slits.across
        middle_m = self.layout.middle_m
        self.view = View(slits.numbers, slits.count, slits.beside, middle_m + low, middle_m + high)

    def rough_position(self) -> float | str:
        """Best of positions a few pitches apart, or why there is none."""
        if not self.whole:
            return "outside the image"
        if self.count < 8:
            return "too small"
        if self.count - np.count_nonzero(self.seen.saturated) < 8:
            return "saturated"
        reach = self.element.length_m / 2 + 0.6 * self.slits.half_width
        starts = self.element.shift_m + np.arange(-reach, reach, SEARCH_PITCHES * self.slits.pitch)
        cost, blank = search_positions(self.view, self.few, starts, self.level)
        best = int(cost.argmin())
        if not np.isfinite(cost[best]):
            return "no light"
        u = float(starts[best])
        if 0 < best < len(cost) - 1:
            # The vertex of the parabola through the best and its neighbours.
            before, here, after = cost[best - 1 : best + 2].tolist()
            if np.isfinite(before + after) and before + after > 2 * here:
                u += SEARCH_PITCHES * self.slits.pitch * (before - after) / (before + after - 2 * here) / 2
        if self.slits.cut_fraction(u) < 0.5:
            self.gain = float(blank - cost[best])
        return u

    def measure(self, u: float) -> Blob | str:
        """The blob near a rough position, or why it is none."""
        pitch = self.slits.pitch
        u, last = descend(self.view, self.few, u, pitch, self.level)
        found = _Step(*last)
        if len(self.few.u) < self.count:
            for _ in range(LAST_STEPS):
                found = _Step(*blob_step(self.view, self.all, u, 0.05 * pitch, self.level))
                u += min(max(found.step_m, -pitch), pitch)
                if abs(found.step_m) < LAST_PITCHES * pitch:
                    break
        cost = found.cost - found.step_m**2 / found.variance_m2
        gain = found.blank_cost - cost
        if self.level[0] <= 0 or not gain > DETECTION_CHI2:
            return "no light"
        unexplained = max(cost - found.count, 0.0) / gain
        if unexplained > MAX_UNEXPLAINED:
            return "light is no blob"
        cut = self.slits.cut_fraction(u)
        if cut > MAX_CUT_FRACTION:
            return "cut off at the element's end"
        variance = found.variance_m2 * max(1.0, cost / max(found.count - 1 - len(self.level), 1))
        element, half, delta = self.element, self.marker.aruco_m / 2, 0.05 * pitch
        ends = (element.centre_m + (u + np.array([[0.0], [delta]])) * element.along)[:, :2] / half
        position, beside = project(self.fit.matrix, ends)
        scale = math.dist(beside, position) / delta  # [px/m]
        pitches = MODEL_SIGMA_PITCH_M if self.light_ring_m is not None else UNKNOWN_RING_PITCH_M
        bit_px = self.marker.bit_m * scale
        spilt = SPILT_SIGMA * self.sigma_px * (self.sigma_px / bit_px) ** SPILT_POWER
        model = math.hypot(MODEL_SIGMA_PX, pitches / self.range_m * pitch * scale, MODEL_SIGMA_CUT_PX * cut, spilt)
        return Blob(u, position, math.hypot(math.sqrt(variance) * scale, model), unexplained, self.slits.half_width)


@dataclass(frozen=True)
class _Step:
    """Gauss–Newton step and information at one position."""

    step_m: float
    variance_m2: float
    cost: float
    blank_cost: float
    count: int


def _scatter(image: np.ndarray, matrix: FloatArray, points: FloatArray) -> float:
    """Standard deviation of the pixel values nearest to plane points (n, 2)."""
    columns, rows = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    nearest_pixels(matrix, points, image.shape[0], image.shape[1], columns, rows)
    seen = gather(image, columns, rows)
    seen -= seen.sum() / len(seen)
    return math.sqrt(float(seen @ seen) / len(seen))


def find_blobs(
    image: np.ndarray,
    fit: PatternFit,
    marker: MarkerDesign,
    camera: Camera,
    *,
    sigma_px: float,
    noise: NoiseModel,
    light_ring_m: float | None = None,
) -> dict[str, Blob | str]:
    """The blob of each encoding element of a marker whose pattern has been found.

    Args:
        image: (height, width) [DN].
        fit: the pattern as found in this image.
        marker: its design.
        camera: gives focal length and principal point, for the perspective through the slits.
        sigma_px: standard deviation of point spread and pixel box together [px].
        noise: of the image.
        light_ring_m: radius of the LED ring about the lens [m]; None where it is not known.

    Returns:
        By the element's name the blob, or in a few words why there is none.
    """
    by_homography = camera_in_marker_m(fit.matrix, marker, camera)
    range_m = float(np.linalg.norm(by_homography))
    sighting = _Sighting(image, fit, marker, sigma_px, noise, range_m=range_m, light_ring_m=light_ring_m)
    shown = {layout.element.name: _ElementImage(sighting, layout) for layout in _layouts(marker)}
    roughly = {name: element.rough_position() for name, element in shown.items()}
    # The homography of a small marker knows the attitude badly; the blobs themselves tell where the camera stands.
    camera_m = _camera_from_blobs(shown, roughly, by_homography)
    found: dict[str, Blob | str] = {}
    for name, start in roughly.items():
        if isinstance(start, str):
            found[name] = start
        else:
            shown[name].look_from(camera_m)
            found[name] = shown[name].measure(start)
    return found


def _camera_from_blobs(
    shown: dict[str, _ElementImage], roughly: dict[str, float | str], otherwise: FloatArray
) -> FloatArray:
    """Camera in the marker frame (3,) [m], its direction from the clearest blob along each axis."""
    range_m = float(np.linalg.norm(otherwise))
    slope = otherwise[:2] / otherwise[2]
    for axis, pair in enumerate((("top", "bottom"), ("left", "right"))):
        clearest = 0.0
        for name in pair:
            u, element = roughly[name], shown[name].element
            if not isinstance(u, str) and shown[name].gain > clearest:
                clearest = shown[name].gain
                slope[axis] = u / range_m + (u - element.virtual_offset_m) / element.virtual_depth_m
    return np.append(slope, 1.0) * range_m / np.sqrt(1 + slope @ slope)


def camera_in_marker_m(matrix: FloatArray, marker: MarkerDesign, camera: Camera) -> FloatArray:
    """Camera in the marker frame (3,) [m], from a homography.

    Args:
        matrix: plane -> image, (3, 3); its columns are r₁, r₂ and t up to scale (Zhang 2000).
        marker: gives the plane's unit, half the ArUco's side.
        camera: focal length and principal point.
    """
    (fx, fy), (cx, cy), half = camera.focal_px, camera.principal_point_px, marker.aruco_m / 2
    return np.asarray(_camera_place(matrix, fx, fy, cx, cy, half))


@kernel
def _camera_place(matrix, fx, fy, cx, cy, half):
    columns = np.empty((3, 3))
    for j in range(3):
        unit = 1.0 if j == 2 else half
        columns[0, j] = (matrix[0, j] - cx * matrix[2, j]) / fx / unit
        columns[1, j] = (matrix[1, j] - cy * matrix[2, j]) / fy / unit
        columns[2, j] = matrix[2, j] / unit
    one, two, place = columns[:, 0], columns[:, 1], columns[:, 2].copy()
    scale = math.sqrt(math.sqrt((one * one).sum()) * math.sqrt((two * two).sum()))
    columns /= scale
    place /= scale
    columns[0, 2] = one[1] * two[2] - one[2] * two[1]
    columns[1, 2] = one[2] * two[0] - one[0] * two[2]
    columns[2, 2] = one[0] * two[1] - one[1] * two[0]
    # The columns are orthonormal but for errors, which the inverse bears as well as the nearest rotation.
    back = inverse3(columns)
    camera = np.empty(3)
    for i in range(3):
        camera[i] = -(back[i, 0] * place[0] + back[i, 1] * place[1] + back[i, 2] * place[2])
    return camera
