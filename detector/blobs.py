"""Sub-pixel position of the blob in an encoding element, by fitting the light its slits let through.

Through slit i, between walls that converge on the virtual line, floor is both lit and seen along an interval that
shrinks linearly with the slit's distance from the blob; the blob is the triangle of those intervals. Its analytic image
is fitted in the marker's plane: position along the element, brightness, background, and light spilt from the foil.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import ndtr

from detector.corners import PatternFit, gather
from detector.noise import NoiseModel
from detector.pattern import SQUARE, PixelSet, pixels_within, project
from detector.slits import Slits
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import Element, MarkerDesign

MAX_PIXELS = 500
#: Gauss–Newton steps from the nearest of the starting positions, three quarters of a slit pitch apart.
STEPS = 3
#: What the slit model leaves in a blob without any noise, standard deviation: a part in pixels, and a part in slit
#: pitches at 1 m that falls with the range, as the lights stand beside the lens and not in it. Measured on ray-traced
#: frames with a ring of 50 mm radius, at 1 to 10 m: 0.1, 0.03, 0.012 and below 0.012 px at 1, 2, 4 and beyond.
MODEL_SIGMA_PX, MODEL_SIGMA_PITCH_M = 0.01, 0.02
#: A blob is found where it lowers chi-square by this much: five standard deviations.
DETECTION_CHI2 = 25.0
#: Largest part of the blob's light that may be lost at the element's end.
MAX_CUT_FRACTION = 0.05
#: Variance left beyond the noise, over the variance explained, above which the light is no blob. Assumption.
MAX_UNEXPLAINED = 0.5


@dataclass(frozen=True)
class Blob:
    """A blob: coordinate along the element in the front plane, and its image."""

    offset_m: float
    position_px: FloatArray  # (2,)
    sigma_px: float  # standard deviation along the element
    unexplained: float


class _ElementImage:
    """Pixels of one element and the cost of a blob at given positions, everything else fitted."""

    def __init__(
        self, image: np.ndarray, fit: PatternFit, marker: MarkerDesign, element: Element, range_m: float,
        sigma_px: float, noise: NoiseModel,
    ):  # fmt: skip
        half = marker.aruco_m / 2
        centre, along, across = (vector[:2] for vector in (element.centre_m, element.along, element.across))
        extent = np.abs(along) * element.length_m / 2 + np.abs(across) * element.width_m / 2
        # The rectangle of the opening as a square of the plane, moved and stretched.
        place = np.array([[extent[0] / half, 0, centre[0] / half], [0, extent[1] / half, centre[1] / half], [0, 0, 1]])
        moved = fit.matrix @ place
        pixels = pixels_within(moved / moved[2, 2], 1.0, (image.shape[0], image.shape[1]), -0.5, most=MAX_PIXELS)
        self.whole = bool(
            (project(moved, SQUARE) > -0.5).all() and (project(moved, SQUARE) < np.array(image.shape[::-1]) - 0.5).all()
        )
        pixels = noise.readable(pixels)
        self.count = len(pixels)
        self.gain = 0.0  # chi-square the rough position gains, where most of the blob is in the opening
        if not self.whole or self.count < 8:
            return
        self.marker, self.element, self.fit, self.range_m = marker, element, fit, range_m
        seen = PixelSet(pixels, fit.matrix, sigma_px)
        axis = int(np.abs(along[1]) > 0.5)
        sigma_u, sigma_v = (seen.sigma_x, seen.sigma_y) if axis == 0 else (seen.sigma_y, seen.sigma_x)
        self.u = seen.plane[:, axis] * half
        self.v = v = seen.plane[:, 1 - axis] * half
        self.sigma_u = float(np.median(sigma_u)) * half
        self.sigma_v = sigma_v = sigma_v * half
        outwards = np.sign(centre @ across)
        self.look_from(np.array([0.0, 0.0, range_m]))
        data = gather(image, pixels)
        self.saturated = data >= noise.saturated_above_dn
        self.noise = noise.at(pixels)
        ring = half * (1 + 2 * marker.ring_fraction)
        self.data = data - fit.white_dn * ndtr((ring - outwards * v) / sigma_v)
        self.ceiling = noise.saturated_above_dn - (data - self.data)
        foil = ndtr((outwards * v - marker.size_m / 2) / sigma_v)
        edge = (
            along * self.u.clip(-element.length_m / 2, element.length_m / 2)[:, None]
            + across * outwards * 1.03 * marker.size_m / 2
        )
        self.glare = (foil * _scatter(image, project(fit.matrix, edge / half))) ** 2
        self.weigh(np.full(self.count, fit.black_dn))
        columns = [np.ones(self.count)]
        if foil.max() > 1e-3:
            columns += [foil / foil.max(), foil / foil.max() * self.u / (element.length_m / 2)]
        self.nuisance = np.array(columns)

    def look_from(self, camera_m: FloatArray) -> None:
        """Set where the camera stands in the marker frame."""
        self.slits = Slits(self.marker, self.element, camera_m)
        middle = float(self.element.centre_m @ self.element.across)
        low, high = (middle + edge for edge in self.slits.across)
        self.across = ndtr((self.v - low) / self.sigma_v) - ndtr((self.v - high) / self.sigma_v)

    def rough_position(self) -> float | str:
        """Best of positions three quarters of a pitch apart, or why there is none; sets the weights that go with it."""
        if not self.whole:
            return "outside the image"
        if self.count < 8:
            return "too small"
        if np.count_nonzero(self.weight) < 8:
            return "saturated"
        reach = self.element.length_m / 2 + 0.6 * self.slits.half_width
        start = np.arange(-reach, reach, 0.75 * self.slits.pitch)
        cost, model = self.solve(start)
        best = int(cost.argmin())
        if not np.isfinite(cost[best]):
            return "no light"
        self.weigh(np.minimum(model[best], self.ceiling))
        if self.slits.cut_fraction(float(start[best])) < 0.5:
            self.gain = self.blank_cost() - float(cost[best])
        return float(start[best])

    def measure(self, u: float) -> Blob | str:
        """The blob near a rough position, or why it is none."""
        delta, pitch = 0.05 * self.slits.pitch, self.slits.pitch
        for _ in range(STEPS):
            u += float(np.clip(self.linearise(u, delta).step_m, -0.5 * pitch, 0.5 * pitch))
        found = self.linearise(u, delta)
        gain = self.blank_cost() - found.cost
        if found.brightness_dn <= 0 or not gain > DETECTION_CHI2:
            return "no light"
        unexplained = max(found.cost - found.count, 0.0) / gain
        if unexplained > MAX_UNEXPLAINED:
            return "light is no blob"
        if self.slits.cut_fraction(u) > MAX_CUT_FRACTION:
            return "cut off at the element's end"
        variance = found.variance_m2 * max(1.0, found.cost / max(found.count - 2 - len(self.nuisance), 1))
        element, half = self.element, self.marker.aruco_m / 2
        ends = (element.centre_m + (u + np.array([[0.0], [delta]])) * element.along)[:, :2] / half
        position, beside = project(self.fit.matrix, ends)
        scale = float(np.linalg.norm(beside - position)) / delta  # [px/m]
        model = np.hypot(MODEL_SIGMA_PX, MODEL_SIGMA_PITCH_M / self.range_m * pitch * scale)
        sigma = np.hypot(np.sqrt(variance) * scale, model)
        return Blob(u, position, float(sigma), unexplained)

    def weigh(self, mean_dn: FloatArray) -> None:
        """Weights for pixels of given means: noise, and the foil's unevenness as far as it spills in."""
        self.weight = np.where(self.saturated, 0.0, 1 / (self.noise.variance(mean_dn) + self.glare))

    def profiles(self, blob: FloatArray) -> FloatArray:
        """Blurred light of blobs at `blob` (k,) in every pixel, (k, n); 1 is fully lit floor."""
        step = self.sigma_u / 2
        reach = int(np.ceil(4 * self.sigma_u / step))
        count = int(np.ceil(self.element.length_m / step)) + 2 * reach + 4
        edges = (np.arange(count + 1) - count / 2) * step
        lit = np.diff(self.slits.seen_up_to(edges, blob), axis=1) / step
        # Cells and the interpolation between them blur by step²/12 and step²/6; the Gaussian does the rest.
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step) ** 2 / (self.sigma_u**2 - step**2 / 4))
        lit = np.asarray(
            cv2.filter2D(lit, cv2.CV_64F, (kernel / kernel.sum())[None], borderType=cv2.BORDER_CONSTANT), float
        )
        at = np.clip((self.u - edges[0]) / step - 0.5, 0, count - 1.001)
        index = at.astype(int)
        part = at - index
        return (lit[:, index] * (1 - part) + lit[:, index + 1] * part) * self.across

    def solve(self, blob: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cost (k,) and model (k, n) of blobs at given positions, levels at their optimum."""
        profile = self.profiles(blob)
        columns = np.concatenate(
            [profile[:, None], np.broadcast_to(self.nuisance, (len(blob), *self.nuisance.shape))], axis=1
        )
        weighted = columns * self.weight
        normal = weighted @ columns.transpose(0, 2, 1)
        diagonal = np.einsum("kii->ki", normal)
        diagonal += 1e-9 * diagonal.max(1, keepdims=True) + 1e-300
        level = np.linalg.solve(normal, (weighted @ self.data)[..., None])[..., 0]
        # A dark blob is none.
        dark = level[:, 0] <= 0
        model = np.einsum("kc,kcn->kn", level, columns)
        residual = self.data - model
        cost = residual**2 @ self.weight
        if self.saturated.any():
            short = np.maximum(self.ceiling - model, 0)[:, self.saturated]
            cost = cost + (short**2).sum(1) * float(self.weight.max())
        return np.where(dark, np.inf, cost), model

    def blank_cost(self) -> float:
        """Cost without any blob."""
        weighted = self.nuisance * self.weight
        level = np.linalg.lstsq(weighted @ self.nuisance.T, weighted @ self.data, rcond=None)[0]
        residual = self.data - level @ self.nuisance
        missed = np.maximum(self.ceiling - level @ self.nuisance, 0)[self.saturated]
        return float(residual**2 @ self.weight + (missed**2).sum() * self.weight.max())

    def linearise(self, blob: float, delta: float) -> _Linear:
        """Gauss–Newton step and information at one position."""
        below, at, above = self.profiles(np.array([blob - delta, blob, blob + delta]))
        columns = np.vstack([at, self.nuisance])
        level = _least_squares(columns, self.weight, self.data)[0]
        model = level @ columns
        residual = self.data - model
        # A saturated pixel pulls only where the model falls short of saturation.
        short = self.ceiling - model
        residual[self.saturated] = np.maximum(short[self.saturated], 0)
        weight = np.where(self.saturated & (short > 0), self.weight.max(), self.weight)
        columns = np.vstack([level[0] * (above - below) / (2 * delta), columns])
        step, variance = _least_squares(columns, weight, residual)
        count = int(np.count_nonzero(weight))
        return _Linear(float(step[0]), float(variance[0]), float(level[0]), float(residual**2 @ weight), count)


@dataclass(frozen=True)
class _Linear:
    step_m: float
    variance_m2: float
    brightness_dn: float
    cost: float
    count: int


def _scatter(image: np.ndarray, points_px: FloatArray) -> float:
    """Standard deviation of the pixel values nearest to points (n, 2)."""
    at = np.clip(np.rint(points_px), 0, np.array(image.shape[::-1]) - 1)
    return float(gather(image, at).std())


def _least_squares(columns: FloatArray, weight: FloatArray, data: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted least squares on columns (c, n): coefficients (c,) and their variances (c,)."""
    scale = np.sqrt(columns**2 @ weight) + 1e-140
    columns = columns / scale[:, None]
    inverse = np.linalg.inv((columns * weight) @ columns.T + 1e-9 * np.eye(len(columns)))
    return inverse @ (columns @ (weight * data)) / scale, np.diag(inverse) / scale**2


def find_blobs(
    image: np.ndarray, fit: PatternFit, marker: MarkerDesign, camera: Camera, sigma_px: float, noise: NoiseModel
) -> dict[str, Blob | str]:
    """The blob of each element by name, or in a few words why there is none."""
    by_homography = camera_in_marker_m(fit.matrix, marker, camera)
    range_m = float(np.linalg.norm(by_homography))
    shown = {e.name: _ElementImage(image, fit, marker, e, range_m, sigma_px, noise) for e in marker.elements}
    roughly = {name: element.rough_position() for name, element in shown.items()}
    # The homography of a small marker knows the attitude badly; the blobs themselves tell where the camera stands.
    camera_m = _camera_from_blobs(marker, shown, roughly, by_homography)
    found: dict[str, Blob | str] = {}
    for name, start in roughly.items():
        if isinstance(start, str):
            found[name] = start
        else:
            shown[name].look_from(camera_m)
            found[name] = shown[name].measure(start)
    return found


def _camera_from_blobs(
    marker: MarkerDesign, shown: dict[str, _ElementImage], roughly: dict[str, float | str], otherwise: FloatArray
) -> FloatArray:
    """Camera in the marker frame (3,) [m], its direction from the clearest blob along each axis."""
    range_m = float(np.linalg.norm(otherwise))
    slope = otherwise[:2] / otherwise[2]
    for axis, pair in enumerate((("top", "bottom"), ("left", "right"))):
        clearest = 0.0
        for element in marker.elements:
            u = roughly[element.name]
            if element.name in pair and not isinstance(u, str) and shown[element.name].gain > clearest:
                clearest = shown[element.name].gain
                slope[axis] = u / range_m + (u - element.virtual_offset_m) / element.virtual_depth_m
    return np.append(slope, 1.0) * range_m / np.sqrt(1 + slope @ slope)


def camera_in_marker_m(matrix: FloatArray, marker: MarkerDesign, camera: Camera) -> FloatArray:
    """Camera in the marker frame (3,) [m] from a plane -> image homography (columns r₁, r₂, t up to scale; Zhang 2000)."""
    columns = np.linalg.inv(camera.matrix) @ matrix / (marker.aruco_m / 2, marker.aruco_m / 2, 1)
    columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    u, _, vt = np.linalg.svd(np.column_stack([columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1])]))
    return -(u @ vt).T @ columns[:, 2]
