"""Frames made into one image with the noise of it: the difference of two, and the rungs of an exposure ladder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.sensor import pair
from detector.sensor.noise import NoiseModel
from detector.sensor.sensor import Sensor
from radiometry.geometry import FloatArray


def difference(
    sensor: Sensor, on_dn: NDArray[np.uint16], off_dn: NDArray[np.uint16], motion_px: FloatArray, scale: float = 1.0
) -> tuple[FloatArray, NoiseModel]:
    """First frame of a sensor minus `scale` times the second [e⁻], shifted back by a motion (2,) [px], and the noise of it.

    See `detector.sensor.pair.difference`.
    """
    gain = sensor.gain_electrons_per_dn
    well = (sensor.saturation_dn - sensor.offset_dn) * gain
    on, off = ((frame - np.float32(sensor.offset_dn)) * np.float32(gain) for frame in (on_dn, off_dn))
    return pair.difference(on, off, NoiseModel(1.0, sensor.total_noise_electrons, 0.0, well), motion_px, scale)


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
