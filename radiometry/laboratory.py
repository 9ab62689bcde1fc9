"""Light sources of a laboratory: LEDs in clusters around the lens, and a halogen spot in the Sun's place."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from scipy import constants

from radiometry.geometry import FloatArray
from radiometry.parameters import Positive
from radiometry.sources import LedRing, Sun
from radiometry.spectrum import Spectrum

#: Luminous efficacy of monochromatic light at 540 THz [lm/W]: the definition of the candela.
EFFICACY_LM_W = 683.0
#: Wavelengths at which the lamp's spectrum is kept [nm]: beyond them no camera of silicon and no eye sees.
_GRID_NM = np.arange(300.0, 1201.0, 5.0)


class LedClusters(LedRing):
    """LEDs in tight clusters, spread evenly on a ring around the lens; the LEDs of a cluster lie on a circle.

    Raises:
        ValueError: when the count is not a multiple of the clusters, or as for `LedRing`.
    """

    clusters: int = Field(3, ge=1, le=100, description="number of clusters on the ring")
    cluster_radius_m: Positive = Field(0.01, description="radius of the circle of a cluster's LEDs [m]")

    def model_post_init(self, _: object) -> None:
        """Check that the LEDs fill the clusters evenly."""
        if self.count % self.clusters:
            raise ValueError(f"count: {self.count} LEDs, expected a multiple of clusters, {self.clusters}")

    def positions_m(self) -> FloatArray:
        """LED positions in the camera frame, (count, 3) [m]: in the plane of the lens, the first cluster on its right."""
        each = self.count // self.clusters
        cluster, led = (2 * np.pi * np.arange(n) / n for n in (self.clusters, each))
        middle = self.ring_radius_m * np.stack([np.cos(cluster), np.sin(cluster)], axis=-1)
        about = self.cluster_radius_m * np.stack([np.cos(led), np.sin(led)], axis=-1) * (each > 1)
        flat = (middle[:, None] + about).reshape(-1, 2)
        return np.column_stack([flat, np.zeros(len(flat))])


class HalogenSpot(Sun):
    """A tungsten halogen lamp in the Sun's place: Planck's spectrum, scaled to the illuminance that a light meter reads."""

    temperature_k: Annotated[float, Field(ge=1000, le=4000)] = Field(3200.0, description="colour temperature [K]")
    illuminance_lx: Positive = Field(20_000.0, description="illuminance on a plane square to the light [lx]")
    lamp_radius_m: Positive = Field(0.10, description="radius of the lamp's lens [m]")
    lamp_distance_m: Positive = Field(4.0, description="distance of the lamp from the marker [m]")

    @property
    def angular_radius_rad(self) -> float:
        """Half the angle that the lamp's lens fills [rad]."""
        return float(np.arctan(self.lamp_radius_m / self.lamp_distance_m))

    def irradiance(self) -> Spectrum:
        """Spectral irradiance on a plane square to the light [W m⁻² nm⁻¹], 300–1200 nm."""
        shape = planck(_GRID_NM, self.temperature_k)
        lumens = EFFICACY_LM_W * np.trapezoid(shape * photopic(_GRID_NM), _GRID_NM)
        return Spectrum(_GRID_NM, shape * (self.illuminance_lx / lumens))


def planck(wavelength_nm: ArrayLike, temperature_k: float) -> FloatArray:
    """Spectral radiance of a black body by Planck's law [W m⁻² sr⁻¹ nm⁻¹].

    Args:
        wavelength_nm: any shape [nm].
        temperature_k: of the body [K].

    Returns:
        Of the shape of the wavelengths.
    """
    metres = np.asarray(wavelength_nm, float) * 1e-9
    exponent = constants.h * constants.c / (metres * constants.k * temperature_k)
    return 2e-9 * constants.h * constants.c**2 / metres**5 / np.expm1(exponent)


def photopic(wavelength_nm: ArrayLike) -> FloatArray:
    """Photopic luminous efficiency V(λ) of the eye [-], by the usual Gaussian fit 1.019 exp(−285.4 (λ/µm − 0.559)²).

    The fit is good to a few per cent.

    Args:
        wavelength_nm: any shape [nm].
    """
    return 1.019 * np.exp(-285.4 * (np.asarray(wavelength_nm, float) / 1000 - 0.559) ** 2)
