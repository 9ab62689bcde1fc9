"""Camera filters: transmission curves composed from a few parameters."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from radiometry.optics import Fraction
from radiometry.spectrum import Spectrum

Wavelength = Annotated[float, Field(ge=300, le=1200)]


class Bandpass(BaseModel):
    """A flat-topped bandpass with straight edges; `edge_nm` wide, centred on the two cut wavelengths."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    low_nm: Wavelength = Field(800.0, description="wavelength of half transmission, short side [nm]")
    high_nm: Wavelength = Field(900.0, description="wavelength of half transmission, long side [nm]")
    transmission: Fraction = Field(1.0, description="transmission inside the band")
    edge_nm: Annotated[float, Field(gt=0, le=50)] = Field(
        0.1, description="width of each edge, 0 to full transmission [nm]"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Bandpass:
        if self.high_nm - self.low_nm <= self.edge_nm:
            raise ValueError(
                f"high_nm: {self.high_nm:g} nm must exceed low_nm {self.low_nm:g} nm by more than the edge of {self.edge_nm:g} nm"
            )
        return self

    def spectrum(self) -> Spectrum:
        """Transmission against wavelength, between 0 and 1, linear between its four knots."""
        half = self.edge_nm / 2
        knots = np.array([self.low_nm - half, self.low_nm + half, self.high_nm - half, self.high_nm + half])
        return Spectrum(knots, self.transmission * np.array([0.0, 1.0, 1.0, 0.0]))
