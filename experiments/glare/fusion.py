"""Frames made into one image with the noise of it: the difference of two, and the rungs of an exposure ladder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.noise import NoiseModel
from detector.sensor import Sensor
from radiometry.geometry import FloatArray

#: What resampling and the error of the motion leave in a registered frame, as a shift [px]; tells the noise model how far
#: to trust pixels where the subtracted light is steep. Assumption.
REGISTRATION_SIGMA_PX = 0.05


def difference(
    sensor: Sensor, on_dn: NDArray[np.uint16], off_dn: NDArray[np.uint16], motion_px: FloatArray, scale: float = 1.0
) -> tuple[FloatArray, NoiseModel]:
    """First frame minus `scale` times the second [e⁻], the second shifted back by a motion (2,) [px], and the noise of it.

    The subtracted light counts twice in the variance: as shot noise of the first frame and, with read noise, through the
    shift's kernel, of the second. Where either is clipped, the difference says nothing: infinite variance.
    """
    gain, sigma = sensor.gain_electrons_per_dn, sensor.total_noise_electrons
    on, off = ((frame - np.float32(sensor.offset_dn)) * np.float32(gain) for frame in (on_dn, off_dn))
    single = NoiseModel(1 / gain, sigma / gain, sensor.offset_dn, sensor.saturation_dn)
    clipped = (on_dn >= single.saturated_above_dn) | (
        shifted((off_dn >= single.saturated_above_dn).astype(np.float32), motion_px, power=2) > 0
    )
    sun = np.float32(scale) * shifted(off, motion_px)
    down, across = np.gradient(sun)
    steep = REGISTRATION_SIGMA_PX**2 * (down**2 + across**2) if motion_px.any() else 0.0
    own = np.float32(scale**2) * shifted(np.maximum(off, 0) + np.float32(sigma**2), motion_px, power=2)
    extra = np.maximum(sun, 0) + own + steep
    return on - sun, NoiseModel(1.0, sigma, extra_variance_dn2=np.where(clipped, np.inf, extra))


def shifted(image: FloatArray, motion_px: FloatArray, power: int = 1) -> FloatArray:
    """The image (H, W) moved back by a motion (2,) [px], by cubic convolution (Keys 1981, a = −½) with repeated edges.

    With `power` 2 the kernel is squared: variances of the moved image from those of the image.
    """
    from scipy.ndimage import correlate1d

    result = np.asarray(image, np.float32)
    for axis, move in ((1, motion_px[0]), (0, motion_px[1])):
        whole = int(np.floor(move))
        t = np.abs(np.arange(-1, 3) - (move - whole))
        kernel = np.where(t < 1, 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2) ** power
        padded = np.zeros(2 * (abs(whole) + 2) + 1)
        middle = len(padded) // 2
        padded[middle + whole - 1 : middle + whole + 3] = kernel
        result = correlate1d(result, padded, axis=axis, mode="nearest")
    return result


def fused(
    sensor: Sensor, rungs_dn: list[NDArray[np.uint16]], exposures_s: list[float]
) -> tuple[FloatArray, NoiseModel]:
    """Frames of falling exposure as one image, in electrons of the first [e⁻], and its noise.

    Every pixel is read from the longest exposure in which it is not clipped, scaled by the ratio r of the exposures: shot noise
    counts r times, read noise r² times. Where all are clipped the image says nothing: infinite variance.
    """
    gain, sigma = sensor.gain_electrons_per_dn, sensor.total_noise_electrons
    ceiling = NoiseModel(1 / gain, sigma / gain, sensor.offset_dn, sensor.saturation_dn).saturated_above_dn
    image = np.zeros(rungs_dn[0].shape, np.float32)
    extra = np.full(image.shape, np.inf)
    for frame, seconds in zip(rungs_dn, exposures_s, strict=True):
        open_ = np.isinf(extra)
        ratio = exposures_s[0] / seconds
        electrons = (frame - np.float32(sensor.offset_dn)) * np.float32(gain * ratio)
        image[open_] = electrons[open_]
        shot = (ratio - 1) * np.maximum(electrons, 0)
        readable = open_ & (frame < ceiling)
        extra[readable] = (shot + (ratio**2 - 1) * sigma**2)[readable]
    return image, NoiseModel(1.0, sigma, extra_variance_dn2=extra)
