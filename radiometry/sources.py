"""Light sources: the Sun outside the atmosphere, the sunlit Earth, and the chaser's ring of near-infrared LEDs."""

from __future__ import annotations

from functools import cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from radiometry.geometry import FloatArray
from radiometry.parameters import Fraction, Positive, PositiveFraction
from radiometry.spectrum import Spectrum, gaussian_line

#: Angular radius of the Sun at 1 au [rad] (0.2665°; IAU 2015 nominal solar radius over the astronomical unit).
SUN_ANGULAR_RADIUS_RAD = 6.957e8 / 1.495978707e11


@cache
def am0_spectrum() -> Spectrum:
    """Solar spectral irradiance at 1 au outside the atmosphere [W m⁻² nm⁻¹], 280–4000 nm.

    The extraterrestrial column of ASTM G173-03, as shipped by colour-science; 101.31 W/m² over 800–900 nm.
    """
    with np.printoptions():  # which the import changes for the whole process
        from colour.plotting.datasets.astm_g_173 import SD_ASTMG173_ETR

    return Spectrum(SD_ASTMG173_ETR.wavelengths, SD_ASTMG173_ETR.values)


class Sun(BaseModel):
    """The Sun as seen from the target."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    phase_deg: Annotated[float, Field(ge=0, le=180)] = Field(45.0, description="angle Sun–target–camera [deg]")
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        60.0, description="side on which the Sun stands: 0 to the camera's right, 90 above [deg]"
    )
    distance_au: Positive = Field(1.0, description="distance Sun–target [au]")

    @property
    def angular_radius_rad(self) -> float:
        """Half the apparent diameter of the disc [rad]."""
        return SUN_ANGULAR_RADIUS_RAD / self.distance_au

    def irradiance(self) -> Spectrum:
        """Spectral irradiance on a plane square to the Sun [W m⁻² nm⁻¹]; falls with the distance squared."""
        return am0_spectrum() * (1.0 / self.distance_au**2)


class Earth(BaseModel):
    """The sunlit Earth as seen from the target: a disc of one radiance, that of a Lambertian surface under an overhead Sun.

    This is an upper bound. The Earth is darker in another phase or at its limb; over cloud it is brighter than its mean
    albedo.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    phase_deg: Annotated[float, Field(ge=0, le=180)] = Field(
        90.0,
        description="angle between the Earth's centre and the camera, seen from the target [deg]; 90: both on one orbit",
    )
    azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = Field(
        -90.0, description="side on which the Earth stands: 0 to the camera's right, 90 above [deg]"
    )
    angular_radius_deg: Annotated[float, Field(gt=0, le=85)] = Field(
        70.0,
        description="half the angle that the disc fills [deg]; 70: asin of 6371 km over 6371 + 400 km, low Earth orbit",
    )
    albedo: Fraction = Field(
        0.3,
        description="reflected over received sunlight, the same at all wavelengths; 0.3: mean of the planet (Bond albedo)",
    )

    @property
    def angular_radius_rad(self) -> float:
        """Half the angle that the disc fills [rad]."""
        return float(np.radians(self.angular_radius_deg))

    def radiance(self, sun: Sun) -> Spectrum:
        """Spectral radiance of the disc [W m⁻² sr⁻¹ nm⁻¹]: albedo · E_sun / π (Lambert's law).

        Args:
            sun: that lights the Earth.
        """
        return sun.irradiance() * (self.albedo / np.pi)


class LedRing(BaseModel):
    """LEDs spread evenly on a ring around the lens, all aimed along the optical axis.

    The pattern of one LED is I(θ) = I₀ cosⁿθ with n = ln ½ / ln cos θ½, the usual model of a lensed emitter.

    Raises:
        ValueError: when the pattern would radiate more power than the LED is given.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    count: int = Field(100, ge=1, le=100_000, description="number of LEDs that are on")
    ring_radius_m: Positive = Field(0.05, le=25, description="radius of the ring: the baseline LED to lens [m]")
    intensity_w_sr: Positive = Field(3.5, description="radiant intensity of one LED on its axis [W/sr]")
    half_angle_deg: Annotated[float, Field(gt=0, lt=90)] = Field(
        12.0, description="angle from the axis at which intensity has halved [deg]"
    )
    centroid_nm: Annotated[float, Field(ge=350, le=1150)] = Field(850.0, description="centre of the emission line [nm]")
    fwhm_nm: Annotated[float, Field(gt=0, le=200)] = Field(
        30.0, description="full width at half maximum of the line [nm]"
    )
    electrical_power_w: Positive = Field(2.1, description="electrical power of one LED while it is on [W]")
    wall_plug_limit: Fraction = Field(1.0, description="largest credible optical over electrical power")
    longest_pulse_s: Positive = Field(
        100.0, description="longest pulse the LEDs stand at this power [s]; default: as long as any exposure, no limit"
    )
    duty_max: PositiveFraction = Field(
        1.0, description="largest share of time the LEDs may be on at this power; default: no limit"
    )

    @model_validator(mode="after")
    def _conserves_energy(self) -> LedRing:
        limit = self.wall_plug_limit * self.electrical_power_w
        if self.optical_power_w > limit:
            light, excess = self.optical_power_w, self.optical_power_w / limit
            raise ValueError(
                f"intensity_w_sr: {self.intensity_w_sr:g} W/sr with a half angle of {self.half_angle_deg:g} deg is "
                f"2π·I₀/(n+1) = {light:.3g} W of light (n = {self.exponent:.1f}) from one LED that is given "
                f"{self.electrical_power_w:g} W × {self.wall_plug_limit:g} = {limit:.3g} W: {excess:.1f} times too much"
            )
        return self

    @property
    def exponent(self) -> float:
        """Exponent n of the pattern I₀ cosⁿθ that halves the intensity at the half angle."""
        return float(np.log(0.5) / np.log(np.cos(np.radians(self.half_angle_deg))))

    @property
    def optical_power_w(self) -> float:
        """Light of one LED [W]: ∫ I₀ cosⁿθ dΩ = 2π I₀ / (n + 1) over the half space."""
        return float(2 * np.pi * self.intensity_w_sr / (self.exponent + 1))

    @property
    def total_intensity_w_sr(self) -> float:
        """Radiant intensity of the whole ring on its axis [W/sr]."""
        return self.count * self.intensity_w_sr

    def pattern(self, cos_angle: ArrayLike) -> FloatArray:
        """Intensity relative to the axis [-]: cosⁿθ, and zero behind the LED.

        Args:
            cos_angle: cosine of the angle from the axis, any shape.

        Example:
            The intensity halves at the half angle:

            >>> import numpy as np
            >>> from radiometry.sources import LedRing
            >>> ring = LedRing(half_angle_deg=12.0)
            >>> round(float(ring.pattern(np.cos(np.radians(12.0)))), 9)
            0.5
        """
        return np.clip(np.asarray(cos_angle, float), 0.0, None) ** self.exponent

    def positions_m(self) -> FloatArray:
        """Positions of the LEDs in the camera frame, (count, 3) [m]: in the plane of the lens, the first one on its right."""
        angle = 2 * np.pi * np.arange(self.count) / self.count
        return self.ring_radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)

    def spectral_intensity(self) -> Spectrum:
        """On-axis intensity of the whole ring [W sr⁻¹ nm⁻¹]."""
        return gaussian_line(self.centroid_nm, self.fwhm_nm) * self.total_intensity_w_sr

    def energy_per_frame_j(self, pulse_s: ArrayLike) -> FloatArray:
        """Electrical energy of one pulse of all LEDs [J]: P · count · t, equation 6.10 of the thesis without the frame rate.

        Args:
            pulse_s: length t of the pulse, any shape [s].
        """
        return self.electrical_power_w * self.count * np.asarray(pulse_s, float)

    def pulse_allowed(self, pulse_s: ArrayLike, frames_per_second: ArrayLike = 0.0) -> NDArray[np.bool_]:
        """Whether a pulse is short enough for the LEDs, and a train of pulses within their duty cycle.

        t ≤ t_max and t · fps ≤ d_max, the two bounds that data sheets of LEDs give.

        Args:
            pulse_s: length t of a pulse [s].
            frames_per_second: pulses per second [s⁻¹], 0 for a single pulse; broadcasts with the length.
        """
        pulse, duty = np.asarray(pulse_s, float), np.asarray(pulse_s, float) * np.asarray(frames_per_second, float)
        return (pulse <= self.longest_pulse_s) & (duty <= self.duty_max * (1 + 1e-12))
