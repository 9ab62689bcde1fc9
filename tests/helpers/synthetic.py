"""Synthetic frames of a marker plane for tests: exact projection, no ray tracer.

The pattern is sampled at jittered sub-pixel positions; a floor point of an encoding element counts where the straight
rays to the camera and to the light both leave its slit, between flat slats of no other reflection than the absorber's.
"""

from __future__ import annotations

import cv2
import numpy as np

from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray, attitude_matrix
from radiometry.optics import Camera
from scenes.marker import Element, MarkerDesign

#: A sensor like the thesis's: 14 bits, 28 e⁻ read noise (quantisation included).
NOISE = NoiseModel(gain_dn_per_electron=0.5, read_noise_dn=14.1, offset_dn=64.0, saturation_dn=16383.0)


def pose_at(
    range_m: float,
    pitch_deg: float = 0.0,
    yaw_deg: float = 0.0,
    roll_deg: float = 0.0,
    shift_px: tuple[float, float] = (0.0, 0.0),
    camera: Camera | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Rotation and translation of a marker whose centre is `shift_px` off the principal point."""
    focal = np.array((camera or Camera()).focal_px)
    rotation = attitude_matrix(*np.radians([pitch_deg, yaw_deg, roll_deg]))
    return rotation, np.append(np.array(shift_px) / focal, 1.0) * range_m


def range_for(bit_px: float, marker: MarkerDesign, camera: Camera) -> float:
    """Range [m] at which a frontal bit spans `bit_px` columns."""
    return camera.focal_px[0] * marker.bit_m / bit_px


def foil(shape: tuple[int, int], level: float, rng: np.random.Generator) -> FloatArray:
    """Crinkled foil: facets of very different brightness with smooth shading, mean about `level`."""
    coarse = cv2.resize(
        rng.normal(size=(shape[0] // 6 + 2, shape[1] // 6 + 2)), shape[::-1], interpolation=cv2.INTER_CUBIC
    )
    fine = cv2.resize(
        rng.normal(size=(shape[0] // 2 + 2, shape[1] // 2 + 2)), shape[::-1], interpolation=cv2.INTER_NEAREST
    )
    return level * np.exp(1.2 * coarse + 0.4 * fine - 0.8)


def reflectance(
    marker: MarkerDesign, points: FloatArray, camera_m: FloatArray, lights_m: FloatArray, absorber: float
) -> FloatArray:
    """Relative radiance of front-plane points (n, 2) [m] seen from `camera_m` and lit from the mean of `lights_m` (k, 3)."""
    out = np.full(len(points), absorber)
    half = marker.aruco_m / 2
    reach = np.abs(points).max(1)
    out[reach < half * (1 + 2 * marker.ring_fraction)] = 1.0
    inside = reach < half
    column = ((points[inside, 0] + half) / marker.bit_m).astype(int).clip(0, len(marker.bits) - 1)
    row = ((half - points[inside, 1]) / marker.bit_m).astype(int).clip(0, len(marker.bits) - 1)
    out[inside] = np.where(marker.bits[row, column], 1.0, absorber)
    for element in marker.elements:
        local = points - element.centre_m[:2]
        u, v = local @ element.along[:2], local @ element.across[:2]
        opening = (np.abs(u) < element.length_m / 2) & (np.abs(v) < element.width_m / 2)
        lit = np.mean([_lit(marker, element, u[opening], v[opening], camera_m, light) for light in lights_m], axis=0)
        out[opening] = absorber + (1 - absorber) * lit
    return out


def _lit(
    marker: MarkerDesign, e: Element, u: FloatArray, v: FloatArray, camera_m: FloatArray, light_m: FloatArray
) -> FloatArray:
    pitch, t = e.length_m / marker.slit_count, e.depth_m
    shrink = 1 - t / e.virtual_depth_m
    low = np.floor((u + e.length_m / 2) / pitch) * pitch - e.length_m / 2 + marker.slat_fraction * pitch / 2
    high = low + (1 - marker.slat_fraction) * pitch

    def seat(point: FloatArray) -> tuple[float, float, float]:
        return float((point - e.centre_m) @ e.along), float((point - e.centre_m) @ e.across), float(point[2])

    cu, cv_, cz = seat(camera_m)
    floor_u, floor_v = u + (u - cu) * t / cz, v + (v - cv_) * t / cz
    lu, lv, lz = seat(light_m)
    back = t / (t + lz)
    front_u, front_v = floor_u + (lu - floor_u) * back, floor_v + (lv - floor_v) * back

    def between(value: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        return (value > a) & (value < b)

    walls = [e.virtual_offset_m + (edge - e.virtual_offset_m) * shrink for edge in (low, high)]
    side = e.width_m / 2
    return (
        between(u, low, high)
        & between(floor_u, *walls)
        & (np.abs(floor_v) < side)
        & between(front_u, low, high)
        & (np.abs(front_v) < side)
    ).astype(float)


def electrons(
    marker: MarkerDesign,
    camera: Camera,
    rotation: FloatArray,
    translation_m: FloatArray,
    rng: np.random.Generator,
    *,
    white: float = 6500.0,
    absorber: float = 0.02,
    foil_level: float = 0.3,
    samples: int = 8,
    ring_radius_m: float = 0.0,
    light_count: int = 8,
) -> FloatArray:
    """Mean electrons (height, width) of a frame: marker before crinkled foil, blurred by the point spread and the pixel.

    `white` electrons for a resolved reflective bit; `foil_level` is relative to it, 0 for a black background. The
    light is at the camera, or on a ring of `ring_radius_m` around it.
    """
    background = foil((camera.height_px, camera.width_px), foil_level, rng)
    half = marker.size_m / 2
    outline = (
        np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]]) @ rotation.T + translation_m
    )
    corners = camera.project(outline)
    pad = int(np.ceil(5 * camera.psf_sigma_px)) + 3
    x0, y0 = (np.floor(corners.min(0)).astype(int) - pad).tolist()
    x1, y1 = (np.ceil(corners.max(0)).astype(int) + pad + 1).tolist()
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, camera.width_px), min(y1, camera.height_px)
    s = samples
    shape = (s * (y1 - y0), s * (x1 - x0))
    column = x0 - 0.5 + (np.arange(shape[1]) + rng.random(shape)) / s
    row = y0 - 0.5 + (np.arange(shape[0])[:, None] + rng.random(shape)) / s
    plane = np.linalg.inv(camera.matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], translation_m]))
    points = np.stack([column, row, np.ones(shape)], -1).reshape(-1, 3) @ plane.T
    points = points[:, :2] / points[:, 2:]
    fine = np.repeat(np.repeat(background[y0:y1, x0:x1], s, 0), s, 1).ravel()
    on = np.abs(points).max(1) < half
    angle = 2 * np.pi * np.arange(light_count if ring_radius_m else 1) / light_count
    ring = ring_radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    camera_m = -rotation.T @ translation_m
    fine[on] = reflectance(marker, points[on], camera_m, (ring - translation_m) @ rotation, absorber)
    image = background.copy()
    image[y0:y1, x0:x1] = _blur_and_bin(fine.reshape(shape), s, camera.psf_sigma_px)
    return white * image


def _blur_and_bin(fine: FloatArray, s: int, sigma_px: float) -> FloatArray:
    """Gaussian of `sigma_px`, then mean over s × s sub-pixels."""
    if sigma_px > 0:
        reach = int(np.ceil(6 * sigma_px * s))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (sigma_px * s)) ** 2)
        kernel /= kernel.sum()
        fine = cv2.sepFilter2D(fine, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    h, w = fine.shape
    return fine.reshape(h // s, s, w // s, s).mean((1, 3))


def expose(mean_electrons: FloatArray, rng: np.random.Generator, noise: NoiseModel = NOISE) -> np.ndarray:
    """Digital numbers (uint16): shot noise, read noise, gain, offset, rounding and clipping at saturation."""
    shot = rng.poisson(np.minimum(mean_electrons, 1e12)).astype(float)
    dn = noise.offset_dn + noise.gain_dn_per_electron * shot + noise.read_noise_dn * rng.standard_normal(shot.shape)
    return np.clip(np.rint(dn), 0, noise.saturation_dn).astype(np.uint16)
