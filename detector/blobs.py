"""Sub-pixel position of the blob in an encoding element, by fitting the light its slits let through.

Through slit i, between walls that converge on the virtual line, floor is both lit and seen along an interval that
shrinks linearly with the slit's distance from the blob; the blob is the triangle of those intervals. Its analytic image
is fitted in the marker's plane: position along the element, brightness, background, and light spilt from the foil.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detector.corners import PatternFit, gather
from detector.noise import NoiseModel
from detector.pattern import SQUARE, PixelSet, pixels_within, project
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import Element, MarkerDesign
from scipy.special import ndtr

MAX_PIXELS = 500
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


class Slits:
    """Intervals of floor seen through the slits of one element, for a camera with the light beside its lens."""

    def __init__(self, marker: MarkerDesign, element: Element, camera_m: FloatArray):
        self.pitch = element.length_m / marker.slit_count
        self.start = -element.length_m / 2
        self.count = marker.slit_count
        self.half_slat = marker.slat_fraction * self.pitch / 2
        depth = element.depth_m
        #: Rate at which the sight line leaves the slit's wall, per metre between slit and blob, over the depth.
        leave = depth * (1 / max(camera_m[2], depth) + 1 / element.virtual_depth_m)
        self.follow = leave / (1 - depth / element.virtual_depth_m + leave)
        #: Distance from the blob at which a slit shows nothing [m].
        self.half_width = (self.pitch - 2 * self.half_slat) / self.follow
        # Across the slits a floor point hides behind the side wall where the sight line is oblique.
        k, across = depth / max(camera_m[2], depth), float((camera_m - element.centre_m) @ element.across)
        side = element.width_m / 2
        self.across = max((-side + across * k) / (1 + k), -side), min((side + across * k) / (1 + k), side)

    def seen_up_to(self, u: FloatArray, blob: FloatArray) -> FloatArray:
        """Length of floor seen below each u (n,) for each blob coordinate (k,), (k, n) [m]."""
        index = np.clip(((u - self.start) / self.pitch).astype(int), 0, self.count - 1)
        low, high = self._interval(index[None, :], blob[:, None])
        each_low, each_high = self._interval(np.arange(self.count)[None, :], blob[:, None])
        before = np.pad(np.cumsum(np.maximum(each_high - each_low, 0), axis=1), ((0, 0), (1, 0)))
        return np.take_along_axis(before, np.broadcast_to(index, low.shape), 1) + np.clip(u - low, 0, np.maximum(high - low, 0))

    def _interval(self, index: np.ndarray, blob: FloatArray) -> tuple[FloatArray, FloatArray]:
        low = self.start + index * self.pitch + self.half_slat
        high = low + self.pitch - 2 * self.half_slat
        return low + np.maximum((blob - low) * self.follow, 0), high + np.minimum((blob - high) * self.follow, 0)

    def cut_fraction(self, blob: float) -> float:
        """Part of the blob's triangle that lies beyond the ends of the element."""
        room = (self.count * self.pitch / 2 - abs(blob)) / self.half_width
        return float(np.clip((1 - np.clip(room, -1, 1)) ** 2 / 2 if room > 0 else 1 - (1 + max(room, -1)) ** 2 / 2, 0, 1))


class _ElementImage:
    """Pixels of one element and the cost of a blob at given positions, everything else fitted."""

    def __init__(
        self, image: np.ndarray, fit: PatternFit, marker: MarkerDesign, element: Element, camera_m: FloatArray,
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
        self.count = len(pixels)
        if not self.whole or self.count < 8:
            return
        self.slits = Slits(marker, element, camera_m)
        self.length_m = element.length_m
        seen = PixelSet(pixels, fit.matrix, sigma_px)
        axis = int(np.abs(along[1]) > 0.5)
        sigma_u, sigma_v = (seen.sigma_x, seen.sigma_y) if axis == 0 else (seen.sigma_y, seen.sigma_x)
        self.u = seen.plane[:, axis] * half
        v = seen.plane[:, 1 - axis] * half
        self.sigma_u = float(np.median(sigma_u)) * half
        sigma_v = sigma_v * half
        outwards = np.sign(centre @ across)
        middle = float(centre @ across)
        low, high = (middle + edge for edge in self.slits.across)
        self.across = ndtr((v - low) / sigma_v) - ndtr((v - high) / sigma_v)
        data = gather(image, pixels)
        self.saturated = data >= noise.saturated_above_dn
        self.noise = noise
        ring = half * (1 + 2 * marker.ring_fraction)
        self.data = data - fit.white_dn * ndtr((ring - outwards * v) / sigma_v)
        self.ceiling = noise.saturated_above_dn - (data - self.data)
        self.weight = np.where(self.saturated, 0.0, 1 / noise.variance(np.full(self.count, fit.black_dn)))
        foil = ndtr((outwards * v - marker.size_m / 2) / sigma_v)
        columns = [np.ones(self.count)]
        if foil.max() > 1e-3:
            columns += [foil / foil.max(), foil / foil.max() * self.u / (element.length_m / 2)]
        self.nuisance = np.array(columns)
        self.direction_px = moved, axis

    def profiles(self, blob: FloatArray) -> FloatArray:
        """Blurred light of blobs at `blob` (k,) in every pixel, (k, n); 1 is fully lit floor."""
        step = self.sigma_u / 3
        reach = int(np.ceil(4 * self.sigma_u / step))
        count = int(np.ceil(self.length_m / step)) + 2 * reach + 4
        edges = (np.arange(count + 1) - count / 2) * step
        lit = np.diff(self.slits.seen_up_to(edges, blob), axis=1) / step
        # The cells average over `step`; what is left of the blur is a slightly narrower Gaussian.
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step) ** 2 / (self.sigma_u**2 - step**2 / 6))
        lit = cv2.filter2D(lit, cv2.CV_64F, (kernel / kernel.sum())[None], borderType=cv2.BORDER_CONSTANT)
        at = np.clip((self.u - edges[0]) / step - 0.5, 0, count - 1.001)
        index = at.astype(int)
        part = at - index
        return (lit[:, index] * (1 - part) + lit[:, index + 1] * part) * self.across

    def solve(self, blob: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cost (k,), brightness (k,) and model (k, n) of blobs at given positions, linear parameters at their optimum."""
        profile = self.profiles(blob)
        columns = np.concatenate([profile[:, None], np.broadcast_to(self.nuisance, (len(blob), *self.nuisance.shape))], axis=1)
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
        return np.where(dark, np.inf, cost), level[:, 0], model

    def blank_cost(self) -> float:
        """Cost without any blob."""
        weighted = self.nuisance * self.weight
        level = np.linalg.lstsq(weighted @ self.nuisance.T, weighted @ self.data, rcond=None)[0]
        residual = self.data - level @ self.nuisance
        missed = np.maximum(self.ceiling - level @ self.nuisance, 0)[self.saturated]
        return float(residual**2 @ self.weight + (missed**2).sum() * self.weight.max())


def find_blob(
    image: np.ndarray, fit: PatternFit, marker: MarkerDesign, element: Element, camera: Camera, sigma_px: float, noise: NoiseModel
) -> Blob | str:
    """The blob of an element, or in a few words why there is none."""
    camera_m = camera_in_marker_m(fit.matrix, marker, camera)
    shown = _ElementImage(image, fit, marker, element, camera_m, sigma_px, noise)
    if not shown.whole:
        return "outside the image"
    if shown.count < 8 or np.count_nonzero(shown.weight) < 8:
        return "saturated" if shown.count >= 8 else "too small"
    slits = shown.slits
    reach = element.length_m / 2 + 0.6 * slits.half_width
    start = np.arange(-reach, reach, 0.75 * slits.pitch)
    cost, _, model = shown.solve(start)
    best = int(cost.argmin())
    if not np.isfinite(cost[best]):
        return "no light"
    u = float(start[best])
    shown.weight = np.where(shown.saturated, 0.0, 1 / noise.variance(np.minimum(model[best], shown.ceiling)))
    u = _refine(shown, u, 0.5 * slits.pitch)
    small = 0.05 * slits.pitch
    (_, level, model) = shown.solve(np.array([u]))
    cost = residual_cost = float(shown.solve(np.array([u]))[0][0])
    blank = shown.blank_cost()
    if not blank - cost > DETECTION_CHI2:
        return "no light"
    free = ~shown.saturated
    left = residual_cost - np.count_nonzero(free)
    unexplained = max(left, 0.0) / (blank - cost)
    if unexplained > MAX_UNEXPLAINED:
        return "light is no blob"
    if slits.cut_fraction(u) > MAX_CUT_FRACTION:
        return "cut off at the element's end"
    profile = shown.profiles(np.array([u - small, u, u + small]))
    columns = np.vstack([level[0] * (profile[2] - profile[0]) / (2 * small), profile[1], shown.nuisance])
    scale = np.sqrt((columns**2) @ shown.weight) + 1e-300
    columns /= scale[:, None]
    information = (columns * shown.weight) @ columns.T + 1e-9 * np.eye(len(columns))
    variance = np.linalg.inv(information)[0, 0] / scale[0] ** 2 * max(1.0, residual_cost / max(np.count_nonzero(free) - len(columns), 1))
    half = marker.aruco_m / 2
    ends = (element.centre_m + (u + np.array([[0.0], [small]])) * element.along)[:, :2] / half
    position, beside = project(fit.matrix, ends)
    return Blob(u, position, float(np.sqrt(variance) * np.linalg.norm(beside - position) / small), unexplained)


def _refine(shown: _ElementImage, u: float, step: float) -> float:
    """Minimum of the cost near u: parabolas through three points, ever narrower."""
    for _ in range(4):
        cost, _, _ = shown.solve(u + step * np.array([-1.0, 0.0, 1.0]))
        curvature = cost[0] - 2 * cost[1] + cost[2]
        if not np.isfinite(cost).all():
            return u
        move = 0.5 * (cost[0] - cost[2]) / curvature if curvature > 0 else np.sign(cost[0] - cost[2])
        u += step * float(np.clip(move, -1, 1))
        step *= max(0.3, min(1.0, abs(float(move))))
    return u


def camera_in_marker_m(matrix: FloatArray, marker: MarkerDesign, camera: Camera) -> FloatArray:
    """Camera in the marker frame (3,) [m] from a plane -> image homography (columns r₁, r₂, t up to scale; Zhang 2000)."""
    columns = np.linalg.inv(camera.matrix) @ matrix / (marker.aruco_m / 2, marker.aruco_m / 2, 1)
    columns /= np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    u, _, vt = np.linalg.svd(np.column_stack([columns[:, 0], columns[:, 1], np.cross(columns[:, 0], columns[:, 1])]))
    return -(u @ vt).T @ columns[:, 2]
