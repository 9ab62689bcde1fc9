"""Light that reaches pixels it was not imaged on: veiling glare, and the Sun from outside the field."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray
from radiometry.optics import Camera, electrons_per_joule
from radiometry.spectrum import Spectrum


def add_veiling_glare(rate: ArrayLike, glare: float, mean_rate: float | None = None) -> FloatArray:
    """Electron rates when a fraction of the frame's light is spread evenly over it: (1 − g) rate + g · mean.

    The uniform form of the veiling glare index (ISO 9358:1994, integral method). The sum over the frame is kept; light that
    scatters out of the frame, or into it from scenery outside, is left out.

    Args:
        rate: of any pixels; of the whole frame where the mean is not given.
        glare: fraction g.
        mean_rate: over the whole frame, without glare.
    """
    rate = np.asarray(rate, float)
    mean = float(np.mean(rate)) if mean_rate is None else mean_rate
    return (1 - glare) * rate + glare * mean


def point_source_transmittance(camera: Camera, angle_rad: ArrayLike) -> FloatArray:
    """Irradiance of the detector over that of a plane square to a distant source, at an angle from the camera's axis.

    As defined for stray light (E. Fest, Stray Light Analysis and Control, SPIE Press, 2013). Log-linear between the rows of
    the camera's table; the first row holds further in; beyond the last, and without a table, it is zero.
    """
    angle = np.degrees(np.asarray(angle_rad, float))
    if not camera.point_source_transmittance:
        return np.zeros_like(angle)
    at_deg, transmittance = np.array(camera.point_source_transmittance, float).T
    value = np.exp(np.interp(angle, at_deg, np.log(transmittance)))
    # The angle of a Sun at a given phase carries a rounding error that must not step over the table's end.
    return np.where(angle <= at_deg[-1] + 1e-9, value, 0.0)


def stray_rate(
    camera: Camera, angle_rad: float, irradiance: Spectrum, transmission: Spectrum, quantum_efficiency: Spectrum
) -> float:
    """Electrons per second in every pixel from a source outside the field: PST(θ) · A_pix · ∫ E(λ) T_filter(λ) QE(λ) λ/hc dλ.

    The filter counts as at normal incidence: stray light comes scattered from the lens.
    """
    band = (transmission * quantum_efficiency).resampled(0.5)
    per_irradiance = Spectrum(
        band.wavelength_nm, band.values * electrons_per_joule(band.wavelength_nm) * camera.pixel_area_m2
    )
    return float(point_source_transmittance(camera, angle_rad)) * (irradiance * per_irradiance).integral()
