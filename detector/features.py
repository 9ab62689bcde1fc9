"""Features of a Mantis Marker in one frame: identity, corners, blobs and virtual points, each with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from detector.elements.blobs import Blob, find_blobs
from detector.pattern.corners import PatternFit, refined
from detector.pattern.decode import decoder_of
from detector.pattern.find import find_pattern
from detector.pattern.pattern import CLEARANCE, KNOWING_REACH, SQUARE, kernel_sigma_px, project
from detector.sensor.defects import isolated, without
from detector.sensor.noise import NoiseModel, estimate_noise
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import ELEMENT_NAMES, MarkerDesign

#: What a Gaussian in place of point spread and pixel's box leaves in the measured variance σ², standard deviation times σ² [px⁴].
#: Measured on synthetic frames with a point spread of 0.3 to 0.8 px.
MODEL_BLUR_PX4 = 0.0012


@dataclass(frozen=True)
class Features:
    """What was found of a marker in an image. Pixel centres lie at integer coordinates (column, row)."""

    identity: int | None
    """Decoded identity; another than the marker's where only such a one was seen."""
    corners_px: FloatArray | None
    """Corners of the ArUco square, (4, 2), the marker's top left first, clockwise [px]."""
    corners_covariance_px2: FloatArray | None
    """Covariance of each corner, (4, 2, 2) [px²]."""
    blobs_px: dict[str, FloatArray | None]
    """Blob of each element, by name: its point on the element's centre line in the front plane, (2,) [px]."""
    blob_sigma_px: dict[str, float]
    """Standard deviation of each found blob along its element [px]."""
    virtual_points_px: dict[str, FloatArray]
    """Images (2,) of the virtual points whose two blobs were found, by `MarkerDesign.virtual_points_m` key [px]."""
    reason: str | None
    """What is missing and why, in one line; None when everything was found."""
    joint_covariance_px2: FloatArray | None = field(default=None, repr=False)
    """Covariance of all eight corner coordinates x0, y0, x1, ..., (8, 8) [px²]."""
    blur_px: float | None = None
    """Point spread as measured in the image: standard deviation of the Gaussian nearest to it, the pixel's box taken out [px]."""
    blur_deviation_px: float | None = None
    """Standard deviation of that measurement [px]."""

    @property
    def detected(self) -> bool:
        """True where the marker was decoded with the right identity and its corners were found."""
        return self.corners_px is not None

    @property
    def corner_covariance_px2(self) -> FloatArray:
        """Covariance of all eight corner coordinates (8, 8) [px²]; block by block where their correlation is not known."""
        if self.joint_covariance_px2 is not None:
            return self.joint_covariance_px2
        assert self.corners_covariance_px2 is not None
        covariance = np.zeros((8, 8))
        for k, block in enumerate(self.corners_covariance_px2):
            covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        return covariance


def find_features(
    image: ArrayLike,
    marker: MarkerDesign,
    camera: Camera,
    noise: NoiseModel | None = None,
    light_ring_m: float | None = None,
) -> Features:
    """Find the marker in an image of a lens without distortion and measure its corners and blobs.

    Blur, levels of light and outliers are found in the image itself.

    Args:
        image: (height, width) digital numbers or electrons, integer or real, of any bit depth.
        marker: the design that is looked for.
        camera: its focal length and principal point give the perspective through the slits; its point spread is a first guess of
            the blur, which is measured.
        noise: of the image; estimated from it where it is not given.
        light_ring_m: radius of the LED ring around the lens [m], 0 for light from the lens itself, None where it is not known.
            Light from the side shifts what the slits show at short range.

    Returns:
        What was found, with uncertainties; what is missing has its reason.

    Raises:
        ValueError: when the image is not two-dimensional or holds non-finite values.
    """
    frame = _checked(image)
    noise = noise or estimate_noise(frame)
    search = find_pattern(frame, marker, kernel_sigma_px(camera.psf_sigma_px), noise)
    found = search.fit
    if found is None:
        return Features(
            identity=search.other,
            corners_px=None,
            corners_covariance_px2=None,
            blobs_px=dict.fromkeys(ELEMENT_NAMES),
            blob_sigma_px={},
            virtual_points_px={},
            reason=search.reason,
        )
    noise = _without_defects(frame, found, decoder_of(marker).pattern.outline, noise)
    blobs = find_blobs(frame, found, marker, camera, sigma_px=found.sigma_px, noise=noise, light_ring_m=light_ring_m)
    found = _refined(found, frame, marker, blobs, noise)
    good = {name: blob for name, blob in blobs.items() if isinstance(blob, Blob)}
    missing = [f"{name} blob: {why}" for name, why in blobs.items() if isinstance(why, str)]
    virtual = _virtual_points(found, good, marker.aruco_m / 2)
    joint = found.covariance_px2
    return Features(
        identity=marker.identity,
        corners_px=found.corners_px,
        corners_covariance_px2=np.array([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(4)]),
        blobs_px={name: good[name].position_px if name in good else None for name in ELEMENT_NAMES},
        blob_sigma_px={name: blob.sigma_px for name, blob in good.items()},
        virtual_points_px=virtual,
        reason="; ".join(missing) or None,
        joint_covariance_px2=joint,
        blur_px=math.sqrt(max(found.sigma_px**2 - 1 / 12, 0.0)),
        blur_deviation_px=_blur_deviation_px(found),
    )


def _blur_deviation_px(fit: PatternFit) -> float:
    """Standard deviation of the point spread's: of s = √(σ² − 1/12) it is σ/s times that of σ, and of s² near zero."""
    point_spread_2 = max(fit.sigma_px**2 - 1 / 12, 0.0)
    of_square = math.hypot(2 * fit.sigma_px * fit.sigma_deviation_px, MODEL_BLUR_PX4 / fit.sigma_px**2)
    return of_square / (math.sqrt(point_spread_2) + math.sqrt(point_spread_2 + of_square))


def _without_defects(frame: np.ndarray, fit: PatternFit, outline: float, noise: NoiseModel) -> NoiseModel:
    """The noise, with the pixels on the marker that stand alone as no light does saying nothing."""
    reach = project(fit.matrix, outline * SQUARE)
    left, top = np.maximum(np.floor(reach.min(axis=0)).astype(int) - 2, 0)
    right, bottom = np.ceil(reach.max(axis=0)).astype(int) + 3
    part = slice(top, max(bottom, top)), slice(left, max(right, left))
    if min(frame[part].shape) < 3:
        return noise
    bad = isolated(frame[part], noise)
    if not bad.any():
        return noise
    everywhere = np.zeros(frame.shape, np.bool_)
    everywhere[part] = bad
    return without(noise, everywhere)


def _refined(
    fit: PatternFit,
    frame: np.ndarray,
    marker: MarkerDesign,
    blobs: dict[str, Blob | str],
    noise: NoiseModel,
) -> PatternFit:
    """The fit with what the dark parts of the elements add to it, where they are close enough to the ring."""
    pattern = decoder_of(marker).pattern
    side_px = max(math.dist(fit.corners_px[k], fit.corners_px[k - 1]) for k in range(4))
    if (marker.gap_fraction - marker.ring_fraction) * side_px > (KNOWING_REACH + CLEARANCE) * fit.sigma_px:
        return fit
    lit, half = pattern.openings.copy(), marker.aruco_m / 2
    for opening, name in zip(lit, ELEMENT_NAMES, strict=True):
        blob = blobs[name]
        if isinstance(blob, Blob):
            along = opening[:2] if name in ("top", "bottom") else opening[2:]
            along[0] = max(along[0], (blob.offset_m - blob.half_width_m) / half)
            along[1] = min(along[1], (blob.offset_m + blob.half_width_m) / half)
    return refined(fit, frame, pattern, lit, noise)


def _virtual_points(fit: PatternFit, blobs: dict[str, Blob], half_m: float) -> dict[str, FloatArray]:
    """Images of the virtual points: lines through two blobs along the slats cross, in the front plane, right above them."""
    pairs = [(h, v) for h in ("top", "bottom") for v in ("right", "left") if h in blobs and v in blobs]
    if not pairs:
        return {}
    crossings = np.array([(blobs[h].offset_m, blobs[v].offset_m) for h, v in pairs]) / half_m
    return dict(zip([f"{h}_{v}" for h, v in pairs], project(fit.matrix, crossings), strict=True))


def _checked(image: ArrayLike) -> np.ndarray:
    frame = np.asarray(image)
    if frame.ndim != 2 or min(frame.shape) < 16:
        raise ValueError(f"image: shape {frame.shape}, expected (H, W) of at least 16 × 16 pixels")
    if not (np.issubdtype(frame.dtype, np.integer) or np.issubdtype(frame.dtype, np.floating)):
        raise ValueError(f"image: dtype {frame.dtype}, expected integer or real numbers")
    if not np.isfinite(frame).all():
        raise ValueError("image: holds NaN or infinity, expected finite values")
    return frame
