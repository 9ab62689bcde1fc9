"""Spectra on a wavelength grid in nanometres: immutable, multiplied with `*`, integrated by the trapezoid rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A function of wavelength, linear between its samples and zero outside them.

    The arrays are copied and made read-only, so a spectrum never changes. Multiplication returns a new one.

    Attributes:
        wavelength_nm: (n,) strictly increasing [nm].
        values: (n,) in the quantity's unit, per nm where it is a density.

    Raises:
        ValueError: when the grid does not increase, the shapes differ, or a value is not finite.

    Example:
        Light of 2 W m⁻² nm⁻¹ through a filter that passes half of it from 800 to 900 nm:

        >>> from radiometry.spectrum import constant
        >>> (constant(2.0) * constant(0.5, 800.0, 900.0)).integral()
        100.0
    """

    wavelength_nm: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        wavelength, values = np.array(self.wavelength_nm, float), np.array(self.values, float)
        if wavelength.ndim != 1 or wavelength.shape != values.shape or len(wavelength) < 2:
            raise ValueError(
                f"spectrum: wavelengths {wavelength.shape} and values {values.shape} must be equal, 1-D, at least 2"
            )
        if not (np.all(np.isfinite(wavelength)) and np.all(np.isfinite(values))):
            raise ValueError("spectrum: every wavelength [nm] and value must be finite")
        if np.any(np.diff(wavelength) <= 0):
            raise ValueError("spectrum: wavelengths [nm] must increase strictly")
        for array in (wavelength, values):
            array.flags.writeable = False
        object.__setattr__(self, "wavelength_nm", wavelength)
        object.__setattr__(self, "values", values)

    def __call__(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Value at any wavelength [nm]; zero outside the samples."""
        return np.interp(np.asarray(wavelength_nm, float), self.wavelength_nm, self.values, left=0.0, right=0.0)

    def __mul__(self, other: Spectrum | float) -> Spectrum:
        """Product on the union of both grids, over their common support. Exact at every knot of either."""
        if not isinstance(other, Spectrum):
            return Spectrum(self.wavelength_nm, self.values * float(other))
        low = max(self.wavelength_nm[0], other.wavelength_nm[0])
        high = min(self.wavelength_nm[-1], other.wavelength_nm[-1])
        if low >= high:
            return Spectrum(np.array([low, low + 1.0]), np.zeros(2))
        grid = np.union1d(self.wavelength_nm, other.wavelength_nm)
        grid = grid[(grid >= low) & (grid <= high)]
        return Spectrum(grid, self(grid) * other(grid))

    __rmul__ = __mul__

    def integral(self) -> float:
        """Integral over wavelength, in the value's unit times nm. Exact where the spectrum itself is sampled."""
        return float(np.trapezoid(self.values, self.wavelength_nm))

    def resampled(self, step_nm: float) -> Spectrum:
        """The same function on a grid no coarser than a step; every original sample stays.

        Args:
            step_nm: largest distance between samples [nm].
        """
        pieces = [
            np.linspace(a, b, max(1, int(np.ceil((b - a) / step_nm))), endpoint=False)
            for a, b in zip(self.wavelength_nm[:-1], self.wavelength_nm[1:], strict=True)
        ]
        grid = np.concatenate([*pieces, self.wavelength_nm[-1:]])
        return Spectrum(grid, self(grid))

    @property
    def support_nm(self) -> tuple[float, float]:
        """First and last wavelength between which the spectrum differs from zero [nm]."""
        nonzero = np.nonzero(self.values)[0]
        if len(nonzero) == 0:
            return float(self.wavelength_nm[0]), float(self.wavelength_nm[-1])
        last = len(self.values) - 1
        return float(self.wavelength_nm[max(nonzero[0] - 1, 0)]), float(self.wavelength_nm[min(nonzero[-1] + 1, last)])


def constant(value: float, low_nm: float = 300.0, high_nm: float = 1200.0) -> Spectrum:
    """A spectrum that has one value between two wavelengths and is zero outside them.

    Args:
        value: in the quantity's unit.
        low_nm: first wavelength [nm].
        high_nm: last wavelength [nm].
    """
    return Spectrum(np.array([low_nm, high_nm]), np.array([value, value], float))


def gaussian_line(centre_nm: float, fwhm_nm: float) -> Spectrum:
    """A Gaussian line of unit area [1/nm], sampled to ±5 sigma in steps of sigma/20.

    The sampled area is normalised to exactly one, so that an integral over the line conserves power.

    Args:
        centre_nm: wavelength of the maximum [nm].
        fwhm_nm: full width at half maximum [nm].

    Raises:
        ValueError: when centre or width is not above zero.

    Example:
        >>> from radiometry.spectrum import gaussian_line
        >>> round(gaussian_line(850.0, 30.0).integral(), 12)
        1.0
    """
    if not (centre_nm > 0 and fwhm_nm > 0):
        raise ValueError(f"line: centre {centre_nm} nm and FWHM {fwhm_nm} nm must be positive")
    sigma = fwhm_nm / (2 * np.sqrt(2 * np.log(2)))
    grid = centre_nm + sigma * np.linspace(-5, 5, 201)
    values = np.exp(-0.5 * ((grid - centre_nm) / sigma) ** 2)
    values[[0, -1]] = 0.0
    return Spectrum(grid, values / np.trapezoid(values, grid))
