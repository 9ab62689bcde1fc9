"""Light in pixels on which it was not imaged: veiling glare, and stray light of a Sun outside the field."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray
from radiometry.optics import Camera, electrons_per_joule
from radiometry.spectrum import Spectrum


def add_veiling_glare(rate: ArrayLike, glare: float, mean_rate: float | None = None) -> FloatArray:
    """Electron rates after a fraction of the frame's light has been spread evenly over the frame: (1 − g) rate + g · mean.

    This is the uniform form of the veiling glare index (ISO 9358:1994, integral method). It keeps the sum over the frame.
    It leaves out light that scatters out of the frame, or into the frame from outside.

    Args:
        rate: of any pixels [e⁻/s]; of the whole frame where the mean is not given.
        glare: fraction g.
        mean_rate: mean over the whole frame, without glare [e⁻/s].

    Returns:
        Of the shape of the rates [e⁻/s].
    """
    rate = np.asarray(rate, float)
    mean = float(np.mean(rate)) if mean_rate is None else mean_rate
    return (1 - glare) * rate + glare * mean


def point_source_transmittance(camera: Camera, angle_rad: ArrayLike) -> FloatArray:
    """Irradiance of the detector over that of a plane square to a distant source, against the source's angle from the axis [-].

    As defined for stray light (E. Fest, Stray Light Analysis and Control, SPIE Press, 2013). The logarithm is linear
    between the rows of the camera's table. The first row holds for smaller angles, too. Beyond the last row, and without a
    table, the result is zero.

    Args:
        camera: for its table.
        angle_rad: angle from the optical axis, any shape [rad].
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
    """Electron rate of every pixel from a source outside the field [e⁻/s]: PST(θ) · A_pix · ∫ E(λ) T_filter(λ) QE(λ) λ/hc dλ.

    The filter counts as at normal incidence, because stray light reaches it scattered by the lens.

    Args:
        camera: for its table and pixel area.
        angle_rad: angle θ of the source from the optical axis [rad].
        irradiance: of a plane square to the source [W m⁻² nm⁻¹].
        transmission: of the filter [-].
        quantum_efficiency: of the sensor [-].
    """
    band = (transmission * quantum_efficiency).resampled(0.5)
    per_irradiance = Spectrum(
        band.wavelength_nm, band.values * electrons_per_joule(band.wavelength_nm) * camera.pixel_area_m2
    )
    return float(point_source_transmittance(camera, angle_rad)) * (irradiance * per_irradiance).integral()
