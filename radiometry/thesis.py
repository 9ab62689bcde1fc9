"""The thesis's radiometric analysis as printed (section 6.2 and listing A.5), with its errors, for comparison only.

Each error is named where it stands; docs/thesis-errata.md says what is right. Nothing else may build on this module.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants

from radiometry.geometry import FloatArray


@dataclass(frozen=True)
class PrintedModel:
    """Parameters of listing A.5 in the listing's own units, and its formulas."""

    led_count: int = 100
    led_intensity_w_sr: float = 3.5
    led_full_angle_deg: float = 24.0
    light_cone_deg: float = 16.0
    bit_m: float = 0.005
    brdf_sr: float = 200.0
    sun_irradiance_w_m2: float = 100.0
    field_of_view_deg: float = 16.0
    detector_px: int = 752
    pixel_pitch_mm: float = 8.6e-3  # error: taken for metres
    focal_length_m: float = 20.19e-3
    f_number: float = 2.8
    throughput: float = 0.35
    quantum_efficiency: float = 0.35
    wavelength_m: float = 850e-9
    dark_noise_e: float = 28.2  # error: this is read noise

    @property
    def intensity_w_sr(self) -> float:
        """Radiant intensity of the array, 40 kW/sr at a cone of 16°."""
        catalogue = np.arctan(self.led_full_angle_deg / 2) ** 2  # error: degrees taken for radians; atan for tan
        spread = np.arctan(np.radians(self.light_cone_deg) / 2) ** 2  # error: a flat disc, atan for tan
        return self.led_count * self.led_intensity_w_sr * catalogue / spread

    def signal_e(self, range_m: ArrayLike, exposure_s: ArrayLike, *, sun: bool) -> FloatArray:
        """Electrons of a bit's pixel (equations 6.2 to 6.8).

        Args:
            range_m: distance of the marker [m].
            exposure_s: exposure time [s]; broadcasts with the range.
            sun: whether the Sun shines on the marker as well.
        """
        range_m = np.asarray(range_m, float)
        bit_area = self.bit_m**2
        bit_px = np.arctan(self.bit_m / 2 / range_m) / (np.radians(self.field_of_view_deg) / 2) * self.detector_px
        leds = self.intensity_w_sr * bit_area / range_m**2  # error: flux on the bit, not irradiance
        irradiance = leds + (self.sun_irradiance_w_m2 if sun else 0.0)
        radiance = irradiance * self.brdf_sr  # error: the retro peak serves the Sun too
        lens = np.pi * (self.focal_length_m / self.f_number) ** 2 / range_m**2  # error: diameter taken for radius
        per_pixel = radiance * bit_area * lens / bit_px**2  # error: divides below one pixel, too
        photons = (
            per_pixel * self.pixel_pitch_mm**2 * self.wavelength_m / (constants.h * constants.c)
        )  # error: a second pixel area
        return photons * np.asarray(exposure_s, float) * self.quantum_efficiency * self.throughput

    def noise_e(self, signal_e: ArrayLike) -> FloatArray:
        """Noise [electrons] (equation 6.9). Error: the terms are added, not their squares.

        Args:
            signal_e: signal, any shape [electrons].
        """
        return np.sqrt(np.asarray(signal_e, float)) + self.dark_noise_e

    def snr(self, range_m: ArrayLike, exposure_s: ArrayLike, *, sun: bool) -> FloatArray:
        """Signal-to-noise ratio as plotted in the thesis's figures 6.3 and 6.4.

        Args:
            range_m: distance of the marker [m].
            exposure_s: exposure time [s]; broadcasts with the range.
            sun: whether the Sun shines on the marker as well.
        """
        signal = self.signal_e(range_m, exposure_s, sun=sun)
        return signal / self.noise_e(signal)
