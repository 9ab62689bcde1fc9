"""Pixel noise as the detector needs it: variance of a digital number, and the level where it saturates."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from detector.sensor.sensor import Sensor
from radiometry.geometry import FloatArray

#: Pixels this many read-noise deviations below the saturation level count as saturated: read noise is added after
#: the full well clips. Assumption.
SATURATION_MARGIN_SIGMA = 4.0


#: The brightest pixels of a frame are a plateau of full ones where so many of them lie within so many read-noise deviations, at
#: least this many deviations above the dark level, and scatter by no more than this times the read noise.
PLATEAU_PIXELS, PLATEAU_SIGMAS, PLATEAU_CONTRAST, PLATEAU_SPREAD = 12, 10.0, 80.0, 1.5


@dataclass(frozen=True)
class NoiseModel:
    """Linear camera model: DN = offset + gain · electrons, with shot noise and Gaussian read noise."""

    gain_dn_per_electron: float
    read_noise_dn: float
    offset_dn: float = 0.0
    saturation_dn: float = np.inf
    extra_variance_dn2: FloatArray | None = field(default=None, compare=False, repr=False)
    """Variance beyond that of shot and read noise, by pixel, (H, W) [DN²]. Infinite where a reading says nothing. A difference
    of two frames has it from the light that was subtracted."""

    def __post_init__(self) -> None:
        for key in ("gain_dn_per_electron", "read_noise_dn"):
            if not (np.isfinite(value := getattr(self, key)) and value >= 0):
                raise ValueError(f"{key}: {value}, expected a finite number >= 0")
        if not np.isfinite(self.offset_dn):
            raise ValueError(f"offset_dn: {self.offset_dn}, expected a finite number [DN]")
        if not self.saturation_dn > self.offset_dn:
            raise ValueError(f"saturation_dn: {self.saturation_dn}, expected above offset_dn {self.offset_dn} [DN]")

    @property
    def saturated_above_dn(self) -> float:
        """Readings at or above this level count as saturated [DN]."""
        return self.saturation_dn - min(
            SATURATION_MARGIN_SIGMA * self.read_noise_dn, 0.1 * (self.saturation_dn - self.offset_dn)
        )

    def variance(self, dn: ArrayLike) -> FloatArray:
        """Temporal variance [DN²] of a pixel of mean `dn`: σ_r² + gain · (DN − offset), and the extra one of its place.

        With an extra variance, `dn` must have its shape.
        """
        return self.of(dn, 0.0 if self.extra_variance_dn2 is None else self.extra_variance_dn2)

    def of(self, dn: ArrayLike, extra_dn2: ArrayLike) -> FloatArray:
        """Variance [DN²] of pixels of mean `dn` (n,) with an extra variance (n,)."""
        signal = np.maximum(np.asarray(dn, float) - self.offset_dn, 0.0)
        return self.read_noise_dn**2 + self.gain_dn_per_electron * signal + np.asarray(extra_dn2, float)

    def readable(self, pixels: FloatArray) -> FloatArray:
        """Those of some pixels (n, 2), column and row, whose readings say something."""
        if self.extra_variance_dn2 is None:
            return pixels
        column, row = pixels.astype(np.intp).T
        return pixels[np.isfinite(self.extra_variance_dn2[row, column])]


def noise_of(sensor: Sensor, image: NDArray[Any]) -> NoiseModel | None:
    """Noise of an image (height, width) [DN]; None where its number type or range shows that it is not the sensor's."""
    container = np.uint8 if sensor.bits <= 8 else np.uint16
    if image.dtype != container or image.max(initial=0) > sensor.max_dn:
        return None
    return sensor_noise(sensor)


def sensor_noise(sensor: Sensor) -> NoiseModel:
    """Noise of a sensor's own frames: its gain, read noise, offset and saturation."""
    gain = 1 / sensor.gain_electrons_per_dn
    return NoiseModel(gain, sensor.total_noise_electrons * gain, sensor.offset_dn, sensor.saturation_dn)


def estimate_noise(image: np.ndarray) -> NoiseModel:
    """Rough noise of a single frame (H, W): read noise and offset of its dark parts, no shot noise, saturation if clipped.

    The read noise is the robust scatter of second differences along rows, which passes over slow shading (Immerkær 1996
    uses the same idea in two dimensions). The gain cannot be told from one frame without flat areas and is left zero.
    """
    data = np.asarray(image[::4], float)
    second = data[:, 2:] - 2 * data[:, 1:-1] + data[:, :-2]
    level = data[:, 1:-1]
    dark = level <= np.median(level)
    spread = 1.4826 * float(np.median(np.abs(second[dark]))) / np.sqrt(6.0)
    top = float(image.max())
    floor = 0.3 if np.issubdtype(image.dtype, np.integer) else 0.0
    # A maximum shared by many pixels is a clip, not a coincidence.
    clipped = np.count_nonzero(image >= top) >= 8
    low = float(np.percentile(data, 5))
    read = max(spread, floor, 1e-6 * (top - low), 1e-12)
    full = plateau(image, read, low)
    if not np.isfinite(full) and clipped and top > low:
        full = top
    return NoiseModel(0.0, read, low, full)


def plateau(image: np.ndarray, read_noise_dn: float, dark_dn: float) -> float:
    """Level [DN] at which the brightest pixels of an image (H, W) are full, infinite where none are.

    A full well clips before the read noise is added, and a converter may shift or scale what it reads: so the pixels at the top
    do not share one number, but scatter about a level by the read noise alone. Pixels that are not full, so far above the dark
    level, scatter by their shot noise, and fewer and fewer are that bright.
    """
    top = float(image.max())
    reach = PLATEAU_SIGMAS * read_noise_dn
    brightest = np.asarray(image[image > top - 2 * reach], float)
    full = brightest[brightest > top - reach]
    level = float(np.median(full))
    if (
        len(full) < PLATEAU_PIXELS
        or len(full) < 0.75 * len(brightest)
        or level - dark_dn < PLATEAU_CONTRAST * read_noise_dn
    ):
        return np.inf
    spread = 1.4826 * float(np.median(np.abs(full - level)))
    return level if spread < PLATEAU_SPREAD * read_noise_dn else np.inf
