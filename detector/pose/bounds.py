"""Cramér–Rao bounds of corners, blobs and pose, from the image model and not from a detector.

For independent pixels of mean μ and variance σ², the Fisher information about parameters θ is F_ij = Σ ∂_iμ ∂_jμ / σ², and no
unbiased estimator has a covariance below F⁻¹ (Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
section 3.9). Nuisance parameters, such as brightness and background, are part of θ, so that the bounds are those of somebody who
must estimate them as well. What the variance itself tells about θ is left out: it adds below 1/(2σ²) of the information.

An image comes sub-sampled, as light on a grid finer than the pixels before the lens's blur. Then its derivatives by every plane
motion of its content, translations to perspective, are exact integrals against the kernel's own derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from detector.pattern.pattern import homography, kernel_sigma_px, pixels_within, project
from radiometry.geometry import FloatArray
from radiometry.optics import Camera, pixel_profile_integral
from scenes.marker import Element, MarkerDesign

#: Displacements (x, y) of `motions`, in the order of the derivatives: x and y count from the frame's centre [px].
MOTIONS = ("(1, 0)", "(0, 1)", "(x, 0)", "(y, 0)", "(0, x)", "(0, y)", "(x², xy)", "(xy, y²)")
#: Kernel deviations kept clear of the marker's outline, beyond which is light that no parameter describes.
CLEARANCE_SIGMA = 2.5
#: Kernel deviations that a pixel gathers light from.
REACH_SIGMA = 6.0


@dataclass(frozen=True)
class FineImage:
    """Light before the lens's blur on `samples` × `samples` sub-pixels of each pixel.

    Attributes:
        rate: (samples · height, samples · width) mean electrons per second, or any rate, of a pixel that shows this light alone.
        samples: sub-pixels along a pixel's side.
        sigma_px: standard deviation of the point spread [px].
    """

    rate: FloatArray
    samples: int
    sigma_px: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the pixel image."""
        return self.rate.shape[0] // self.samples, self.rate.shape[1] // self.samples

    @property
    def centre_px(self) -> FloatArray:
        """Centre of the frame (x, y) [px]."""
        return (np.array(self.shape[::-1]) - 1) / 2

    @cached_property
    def places_px(self) -> tuple[FloatArray, FloatArray]:
        """Column and row positions of the sub-pixels' centres [px]."""
        width, height = self.rate.shape[::-1]
        return (np.arange(width) + 0.5) / self.samples - 0.5, (np.arange(height) + 0.5) / self.samples - 0.5

    def image(self, shift_px: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Rate of every pixel (height, width), the content moved by a shift (x, y) [px]."""
        (kx, _), (ky, _) = self._kernels(shift_px)
        return np.maximum(_through(ky, self.rate, kx), 0.0)

    def of(self, mask: NDArray[np.bool_]) -> FineImage:
        """The same with only the light where a mask of the sub-pixels is true."""
        return FineImage(np.where(mask, self.rate, 0.0), self.samples, self.sigma_px)

    def translations(self, shift_px: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """The first two of `motions`, (2, height, width)."""
        (kx, dx), (ky, dy) = self._kernels(shift_px)
        return np.array([-_through(ky, self.rate, dx), -_through(dy, self.rate, kx)])

    def motions(self, shift_px: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Derivatives (8, height, width) of `image` by moving its content along each of `MOTIONS`, radiance kept.

        With kernel K and displacement δ, ∂I = ∫ L(y) [K(x−y) ∇·δ(y) − ∇K(x−y)·δ(y)] dy: the light L is never differentiated.
        """
        (kx, dx), (ky, dy) = self._kernels(shift_px)
        at = [p - c + s for p, c, s in zip(self.places_px, self.centre_px, shift_px, strict=True)]
        x, y, light = at[0], at[1][:, None], self.rate
        flat = _through(ky, light, kx)
        by_x, by_y = _through(ky, light * x, dx), _through(dy, light * y, kx)
        by_xx, by_xy = _through(ky, light * x**2, dx), _through(dy, light * (x * y), kx)
        by_yx, by_yy = _through(ky, light * (x * y), dx), _through(dy, light * y**2, kx)
        moved = [
            -_through(ky, light, dx),
            -_through(dy, light, kx),
            flat - by_x,
            -_through(ky, light * y, dx),
            -_through(dy, light * x, kx),
            flat - by_y,
            3 * _through(ky, light * x, kx) - by_xx - by_xy,
            3 * _through(ky, light * y, kx) - by_yx - by_yy,
        ]
        return np.array(moved)

    def _kernels(self, shift_px: tuple[float, float]) -> list[tuple[csr_array, csr_array]]:
        """Kernel and its derivative by the pixel's position for columns and rows, (pixels, sub-pixels) each."""
        return [_kernel(n, self.samples, self.sigma_px, s) for n, s in zip(self.shape[::-1], shift_px, strict=True)]


def _through(rows: csr_array, light: FloatArray, columns: csr_array) -> FloatArray:
    """Light on sub-pixels gathered by the kernels of rows and columns, (height, width)."""
    return np.asarray((columns @ (rows @ light).T).T)


@lru_cache(maxsize=64)
def _kernel(pixels: int, samples: int, sigma_px: float, shift_px: float) -> tuple[csr_array, csr_array]:
    """Integral of point spread ⊗ pixel over each sub-pixel, rows adding up to one, and its derivative by the pixel's place.

    Light is averaged over a sub-pixel and then spread evenly over it, which blurs by 1/(6 samples²) px²; the kernel is as much
    narrower.
    """
    sigma_px = float(np.sqrt(max(sigma_px**2 - 1 / (6 * samples**2), (sigma_px / 4) ** 2)))
    edges = np.arange(pixels * samples + 1) / samples - 0.5 + shift_px - np.arange(pixels)[:, None]
    weight = np.diff(pixel_profile_integral(edges, sigma_px), axis=1)
    step = 1e-3
    density = (pixel_profile_integral(edges + step, sigma_px) - pixel_profile_integral(edges - step, sigma_px)) / (
        2 * step
    )
    total = weight.sum(axis=1, keepdims=True)
    far = np.abs(edges[:, :-1] + 0.5 / samples) > REACH_SIGMA * sigma_px + 1
    return tuple(csr_array(np.where(far, 0.0, part)) for part in (weight / total, -np.diff(density, axis=1) / total))


def displacement(places_px: FloatArray) -> FloatArray:
    """What each of `MOTIONS` does to points (n, 2) that count from the frame's centre: (n, 2, 8)."""
    x, y = np.asarray(places_px, float).T
    one, none = np.ones_like(x), np.zeros_like(x)
    by_x = np.stack([one, none, x, y, none, none, x * x, x * y], axis=-1)
    by_y = np.stack([none, one, none, none, x, y, x * y, y * y], axis=-1)
    return np.stack([by_x, by_y], axis=1)


def information(derivatives: FloatArray, variance: FloatArray) -> FloatArray:
    """Fisher information (k, k) from derivatives (k, n) of n pixel means and their variances (n,)."""
    return (derivatives / variance) @ derivatives.T


def bound(derivatives: FloatArray, variance: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Smallest covariance (k, k) of the parameters with derivatives (k, n), nuisance derivatives (m, n) unknown as well.

    Raises:
        ValueError: when the pixels do not determine the parameters.
    """
    everything = np.concatenate([derivatives, nuisance])
    fisher = information(everything, variance)
    scale = np.sqrt(np.diag(fisher))
    if not (np.isfinite(scale).all() and (scale[: len(derivatives)] > 0).all()):
        raise ValueError("bound: a parameter leaves every pixel as it is; expected pixels that depend on it")
    seen = scale > 0
    scaled = fisher[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen])
    if np.linalg.eigvalsh(scaled)[0] < 1e-13:
        raise ValueError("bound: the pixels do not tell the parameters apart")
    k = len(derivatives)
    return np.asarray(np.linalg.inv(scaled)[:k, :k] / np.outer(scale[:k], scale[:k]))


@dataclass(frozen=True)
class Exposure:
    """What turns a rate into a mean and a variance: signal in electrons, so that both are.

    Attributes:
        seconds: exposure [s].
        dark_electrons: mean dark charge.
        noise_electrons: read and quantisation noise, rms.
    """

    seconds: float
    dark_electrons: float
    noise_electrons: float

    def variance(self, rate: FloatArray) -> FloatArray:
        """Variance [electrons²] of pixels of a rate: shot noise of signal and dark charge, read and quantisation noise."""
        return rate * self.seconds + self.dark_electrons + self.noise_electrons**2


def corner_bound(
    fine: FineImage,
    marker: MarkerDesign,
    corners_px: FloatArray,
    exposure: Exposure,
    shift_px: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Bound (8, 8) of the ArUco's corners x0, y0, x1, … [px²] for a pattern that any homography may have imaged.

    Used is the whole face of the marker, less a margin. Nuisance: brightness of pattern and background, and of each element's
    light its brightness and its place, for where a blob stands says nothing of the corners.

    Args:
        fine: the frame on sub-pixels, before the lens's blur.
        marker: its design.
        exposure: exposure, dark charge and noise.
        shift_px: sub-pixel shift of the frame [px].
        corners_px: true corners (4, 2) in the frame, without the shift.
    """
    corners = np.asarray(corners_px, float)
    at = _face(fine, marker, corners + shift_px)
    plane = _plane_m(fine, marker, corners)
    printed = np.abs(plane).max(axis=-1) < marker.aruco_m / 2 * (1 + 2 * marker.gap_fraction)
    pattern = fine.of(printed)
    elements = [fine.of(_opening(e, plane)) for e in marker.elements]
    nuisance = [pattern.image(shift_px)[at], np.ones(len(at[0]))]
    for light in elements:
        nuisance += [light.image(shift_px)[at], *light.translations(shift_px)[:, at[0], at[1]]]
    derivatives = pattern.motions(shift_px)[:, at[0], at[1]] * exposure.seconds
    covariance = bound(derivatives, exposure.variance(fine.image(shift_px)[at]), np.stack(nuisance) * exposure.seconds)
    moved = displacement(corners + shift_px - fine.centre_px).reshape(8, 8)
    return moved @ covariance @ moved.T


def blob_bound(
    fine: FineImage,
    before: FineImage,
    after: FineImage,
    step_m: float,
    marker: MarkerDesign,
    element: Element,
    corners_px: FloatArray,
    exposure: Exposure,
    shift_px: tuple[float, float] = (0.0, 0.0),
) -> float:
    """Bound of the standard deviation of an element's blob along the element [m in the front plane].

    Nuisance: brightness of the blob, of the pattern and of what lies outside the marker, and the absorber's level.

    Args:
        fine: the frame on sub-pixels, before the lens's blur.
        marker: its design.
        exposure: exposure, dark charge and noise.
        shift_px: sub-pixel shift of the frame [px].
        before: the same frame with the blob `step_m` earlier along the element, the openings where they are.
        after: the same with the blob as much later.
        step_m: of the blob [m].
        element: whose blob it is.
        corners_px: true corners (4, 2) of the ArUco in the frame, without the shift.
    """
    half = marker.aruco_m / 2
    corners = np.asarray(corners_px, float)
    plane = _plane_m(fine, marker, corners)
    inside = _opening(element, plane)
    ring = np.abs(plane).max(axis=-1) < half * (1 + 2 * marker.ring_fraction)
    outside = np.abs(plane).max(axis=-1) > marker.size_m / 2
    centre, along, across = (vector[:2] for vector in (element.centre_m, element.along, element.across))
    extent = np.abs(along) * element.length_m / 2 + np.abs(across) * element.width_m / 2
    middle = centre + element.shift_m * along
    place = np.array([[extent[0] / half, 0, middle[0] / half], [0, extent[1] / half, middle[1] / half], [0, 0, 1]])
    moved = homography(corners + shift_px) @ place
    # One and a half pixels around the opening hold what the kernel spreads out of it.
    used = pixels_within(moved / moved[2, 2], 1.0, fine.shape, -1.5).astype(int)
    at = used[:, 1], used[:, 0]
    mean = fine.image(shift_px)[at]
    change = (after.of(inside).image(shift_px)[at] - before.of(inside).image(shift_px)[at]) / (2 * step_m)
    parts = [fine.of(mask).image(shift_px)[at] for mask in (inside, ring, outside)]
    nuisance = np.stack([*parts, np.ones(len(mean))]) * exposure.seconds
    covariance = bound(change[None] * exposure.seconds, exposure.variance(mean), nuisance)
    return float(np.sqrt(covariance[0, 0]))


def _face(fine: FineImage, marker: MarkerDesign, corners_px: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the pixels that see nothing but the marker."""
    clearance = CLEARANCE_SIGMA * kernel_sigma_px(fine.sigma_px)
    used = pixels_within(homography(corners_px), marker.size_m / marker.aruco_m, fine.shape, clearance).astype(np.intp)
    return used[:, 1], used[:, 0]


def _plane_m(fine: FineImage, marker: MarkerDesign, corners_px: FloatArray) -> FloatArray:
    """Coordinates (rows, columns, 2) of the sub-pixels on the marker's plane [m]."""
    column, row = fine.places_px
    points = np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2)
    plane = project(np.linalg.inv(homography(corners_px)), points) * marker.aruco_m / 2
    return plane.reshape(*fine.rate.shape, 2)


def _opening(element: Element, plane_m: FloatArray) -> FloatArray:
    relative = plane_m - (element.centre_m + element.shift_m * element.along)[:2]
    along, across = np.abs(relative @ element.along[:2]), np.abs(relative @ element.across[:2])
    return (along < element.length_m / 2) & (across < element.width_m / 2)


@dataclass(frozen=True)
class Orbit:
    """Frames of one marker seen from a little aside, each with what the step was: for central differences.

    Attributes:
        frames: pairs (before, after) by pitch, yaw and range.
        steps: half of the change between the two [rad, rad, m].
        turns: rotation vectors (2, 3) in the camera frame that a unit of pitch and of yaw turn the marker by.
    """

    frames: tuple[tuple[FineImage, FineImage], ...]
    steps: tuple[float, float, float]
    turns: FloatArray


def pose_bound(
    fine: FineImage,
    orbit: Orbit,
    marker: MarkerDesign,
    camera: Camera,
    translation_m: FloatArray,
    corners_px: FloatArray,
    exposure: Exposure,
    shift_px: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Bound (6, 6) of (ω, δt) [rad, m] as of `detector.pose.pose.Pose.covariance`, from the whole face of the marker.

    Moving the marker is the same as turning the camera, which moves the image as a plane, and then seeing the marker from another
    side or range, which must be rendered. Nuisance: brightness of the pattern and of each element, and background.

    Args:
        fine: the frame on sub-pixels, before the lens's blur.
        marker: its design.
        exposure: exposure, dark charge and noise.
        shift_px: sub-pixel shift of the frame [px].
        orbit: the marker from either side and range.
        camera: of the frame, undistorted, with the principal point in its middle.
        translation_m: (3,) of the marker, on the optical axis.
        corners_px: true corners (4, 2) of the ArUco in the frame, without the shift.
    """
    at = _face(fine, marker, np.asarray(corners_px, float) + shift_px)
    mean = fine.image(shift_px)[at]
    by_motion = fine.motions(shift_px)[:, at[0], at[1]]
    (fx, fy), z = camera.focal_px, float(translation_m[2])
    by_turn = [
        -fy * by_motion[1] - by_motion[7] / fy,
        fx * by_motion[0] + by_motion[6] / fx,
        -fx / fy * by_motion[3] + fy / fx * by_motion[4],
    ]  # about the camera's x, y and z axes
    by_view = [
        (after.image(shift_px)[at] - before.image(shift_px)[at]) / (2 * step)
        for (before, after), step in zip(orbit.frames, orbit.steps, strict=True)
    ]
    # (ω, δt) of a unit of each: turning the camera's content also carries the marker about the camera.
    arm = np.array([[0.0, z, 0.0], [-z, 0.0, 0.0], [0.0, 0.0, 0.0]])  # columns: e × t for t = (0, 0, z)
    unit = np.zeros((6, 6))
    unit[:3, :3] = np.eye(3)
    unit[3:, :3] = arm
    unit[:3, 3:5] = np.asarray(orbit.turns).T
    unit[5, 5] = 1.0
    derivatives = np.linalg.solve(unit.T, np.stack([*by_turn, *by_view]))
    plane = _plane_m(fine, marker, np.asarray(corners_px, float))
    parts = [fine.of(_opening(e, plane)).image(shift_px)[at] for e in marker.elements]
    nuisance = np.stack([*parts, mean - sum(parts), np.ones(len(mean))]) * exposure.seconds
    return bound(derivatives * exposure.seconds, exposure.variance(mean), nuisance)
