"""An exposure bracket made into one image with its noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel, sensor_noise
from detector.sensor.sensor import Sensor
from radiometry.geometry import FloatArray


def fuse(
    sensor: Sensor, frames_dn: list[NDArray[np.uint16]], exposures_s: list[float]
) -> tuple[FloatArray, NoiseModel]:
    """Frames (H, W) of falling exposure as one image, in electrons of the first [e⁻], and its noise.

    Every pixel is read from the longest exposure in which it is not clipped, scaled by the ratio r of the exposures: shot noise
    counts r times, read noise r² times. Where all are clipped the image says nothing: infinite variance.
    """
    gain, sigma = sensor.gain_electrons_per_dn, sensor.total_noise_electrons
    ceiling = sensor_noise(sensor).saturated_above_dn
    image = np.zeros(frames_dn[0].shape, np.float32)
    extra = np.full(image.shape, np.inf)
    for frame, seconds in zip(frames_dn, exposures_s, strict=True):
        unread = np.isinf(extra)
        ratio = exposures_s[0] / seconds
        electrons = (frame - np.float32(sensor.offset_dn)) * np.float32(gain * ratio)
        image[unread] = electrons[unread]
        shot = (ratio - 1) * np.maximum(electrons, 0)
        readable = unread & (frame < ceiling)
        extra[readable] = (shot + (ratio**2 - 1) * sigma**2)[readable]
    return image, NoiseModel(1.0, sigma, extra_variance_dn2=extra)
