"""Camera filters: transmission curves composed from a few parameters."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from radiometry.parameters import Fraction
from radiometry.spectrum import Spectrum

Wavelength = Annotated[float, Field(ge=300, le=1200)]


class Bandpass(BaseModel):
    """A flat-topped bandpass with straight edges. Each edge is `edge_nm` wide and centred on its cut wavelength.

    Raises:
        ValueError: when the cuts do not lie further apart than an edge's width, or the effective index is above 0 but not
            above 1.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    low_nm: Wavelength = Field(800.0, description="wavelength of half transmission, short side [nm]")
    high_nm: Wavelength = Field(900.0, description="wavelength of half transmission, long side [nm]")
    transmission: Fraction = Field(1.0, description="transmission inside the band")
    edge_nm: Annotated[float, Field(gt=0, le=50)] = Field(
        0.1, description="width of each edge, 0 to full transmission [nm]"
    )

    effective_index: Annotated[float, Field(ge=0, le=5)] = Field(
        0.0, description="index that governs the blue shift with the angle of incidence; 0 is none (absorbing glass)"
    )

    @model_validator(mode="after")
    def _index_above_one(self) -> Bandpass:
        if 0 < self.effective_index <= 1:
            raise ValueError(f"effective_index: {self.effective_index:g}, expected 0 (no shift) or more than 1")
        return self

    @model_validator(mode="after")
    def _ordered(self) -> Bandpass:
        if self.high_nm - self.low_nm <= self.edge_nm:
            raise ValueError(
                f"high_nm: {self.high_nm:g} nm must exceed low_nm {self.low_nm:g} nm by more than the edge of {self.edge_nm:g} nm"
            )
        return self

    @property
    def centre_nm(self) -> float:
        """Middle of the band [nm]."""
        return (self.low_nm + self.high_nm) / 2

    def spectrum(self, incidence_rad: float = 0.0) -> Spectrum:
        """Transmission against wavelength [-], linear between four knots.

        Light that meets an interference filter at an angle θ sees every feature shifted to λ √(1 − (sin θ / n)²), where n
        is the effective index (Macleod, Thin-Film Optical Filters, tilted filters).

        Args:
            incidence_rad: angle of incidence θ [rad].

        Example:
            >>> from radiometry.filters import Bandpass
            >>> band = Bandpass(low_nm=800.0, high_nm=900.0, transmission=0.9)
            >>> round(band.spectrum().integral(), 9)
            90.0
        """
        half = self.edge_nm / 2
        knots = np.array([self.low_nm - half, self.low_nm + half, self.high_nm - half, self.high_nm + half])
        if self.effective_index > 0:
            knots = knots * np.sqrt(1 - (np.sin(incidence_rad) / self.effective_index) ** 2)
        return Spectrum(knots, self.transmission * np.array([0.0, 1.0, 1.0, 0.0]))
