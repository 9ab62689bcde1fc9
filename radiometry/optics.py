"""Camera optics: projection, point spread, and radiance to electron rate."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field
from scipy import constants
from scipy.special import ndtr

from radiometry.geometry import FloatArray
from radiometry.spectrum import Spectrum

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class Camera(BaseModel):
    """A monochrome camera's lens and pixel grid. Pixel centres lie at integer coordinates."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    width_px: int = Field(752, ge=16, le=16384, description="columns of the detector")
    height_px: int = Field(580, ge=16, le=16384, description="rows of the detector")
    pixel_pitch_x_m: Positive = Field(8.6e-6, description="column pitch [m]")
    pixel_pitch_y_m: Positive = Field(8.3e-6, description="row pitch [m]")
    focal_length_m: Positive = Field(20.19e-3, description="focal length [m]")
    f_number: Positive = Field(2.8, description="focal length over entrance pupil diameter")
    lens_transmission: Fraction = Field(0.35, description="throughput of lens and filter holder, without the filter")
    psf_sigma_px: float = Field(
        0.5, ge=0, le=20, description="standard deviation of the lens's Gaussian point spread, before the pixel [px]"
    )

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal length in columns and in rows [px]."""
        return self.focal_length_m / self.pixel_pitch_x_m, self.focal_length_m / self.pixel_pitch_y_m

    @property
    def principal_point_px(self) -> tuple[float, float]:
        """Centre of the detector, ((W−1)/2, (H−1)/2) [px]."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K, (3, 3) [px]."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def pixel_area_m2(self) -> float:
        """Area of one pixel [m²], fill factor 1."""
        return self.pixel_pitch_x_m * self.pixel_pitch_y_m

    def project(self, points_camera_m: ArrayLike) -> FloatArray:
        """Image positions (..., 2) [px] of points (..., 3) in the camera frame [m]."""
        points = np.asarray(points_camera_m, float)
        return points[..., :2] / points[..., 2:] * self.focal_px + self.principal_point_px

    def relative_illumination(self) -> FloatArray:
        """Natural fall-off cos⁴ of the field angle at every pixel, (height, width)."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        x = (np.arange(self.width_px) - cx) / fx
        y = (np.arange(self.height_px) - cy) / fy
        return (1.0 + x**2 + y[:, None] ** 2) ** -2


def electrons_per_joule(wavelength_nm: ArrayLike) -> FloatArray:
    """Photons in one joule of light, λ/(hc) [J⁻¹]: electrons at a quantum efficiency of one."""
    return np.asarray(wavelength_nm, float) * 1e-9 / (constants.h * constants.c)


def etendue_m2_sr(camera: Camera) -> float:
    """Area times solid angle of one pixel on the axis [m² sr]: A_pix · π/(4F²), the camera equation at infinity focus."""
    return camera.pixel_area_m2 * np.pi / (4 * camera.f_number**2)


def electron_responsivity(camera: Camera, transmission: Spectrum, quantum_efficiency: Spectrum) -> Spectrum:
    """Electron rate per spectral radiance on the axis [e⁻ s⁻¹ / (W m⁻² sr⁻¹ nm⁻¹) nm⁻¹], sampled every 0.5 nm or finer.

    A_pix · π/(4F²) · T_lens · T_filter(λ) · QE(λ) · λ/(hc). Its integral against L(λ) is the electron rate.
    """
    band = (transmission * quantum_efficiency).resampled(0.5)
    rate = etendue_m2_sr(camera) * camera.lens_transmission * electrons_per_joule(band.wavelength_nm)
    return Spectrum(band.wavelength_nm, band.values * rate)


def wavelength_nodes(transmission: Spectrum, count: int = 4) -> tuple[int, ...]:
    """Whole-nanometre wavelengths at which transport is rendered: Gauss–Legendre nodes of the passband, rounded.

    Args:
        transmission: filter curve; its support is the passband.
        count: nodes, a multiple of four, for the renderer carries four wavelengths a ray.

    Raises:
        ValueError: when the count is not a multiple of four or the band is too narrow to hold distinct nodes.
    """
    if count < 4 or count % 4:
        raise ValueError(f"wavelength nodes: {count}, expected a multiple of 4")
    low, high = transmission.support_nm
    nodes = tuple(
        int(n) for n in np.rint((low + high) / 2 + (high - low) / 2 * np.polynomial.legendre.leggauss(count)[0])
    )
    if len(set(nodes)) < count:
        raise ValueError(f"passband {low:g}-{high:g} nm is too narrow for {count} nodes of whole nanometres")
    return nodes


def node_weights(spectral_weight: Spectrum, nodes_nm: ArrayLike) -> FloatArray:
    """Weights w_k such that Σ w_k T(λ_k) = ∫ w(λ) T(λ) dλ for every transport T that is a cubic through the nodes.

    The weights integrate the Lagrange polynomials of the nodes against w(λ), so line emitters and filter edges are resolved
    by the grid of w and not by the nodes. Interpolation is by groups of four: the four nodes nearest to each λ.

    Args:
        spectral_weight: w(λ), say emitter × responsivity.
        nodes_nm: (n,) increasing wavelengths, n ≥ 4.
    """
    nodes = np.asarray(nodes_nm, float)
    wavelength, value = spectral_weight.wavelength_nm, spectral_weight.values
    step = np.diff(wavelength)
    trapezoid = np.concatenate([[step[0]], step[:-1] + step[1:], [step[-1]]]) / 2
    first = np.clip(np.searchsorted(nodes, wavelength) - 2, 0, len(nodes) - 4)
    weights = np.zeros(len(nodes))
    for j in range(4):
        basis = np.ones_like(wavelength)
        for m in range(4):
            if m != j:
                basis *= (wavelength - nodes[first + m]) / (nodes[first + j] - nodes[first + m])
        np.add.at(weights, first + j, trapezoid * value * basis)
    return weights


def pixel_profile_integral(x_px: ArrayLike, psf_sigma_px: float) -> FloatArray:
    """Response of a pixel at 0 to a half plane that is bright at positions below x [px], between 0 and 1.

    The cumulative of a unit box (the pixel) convolved with a Gaussian (the point spread), in closed form.
    """
    sigma = max(psf_sigma_px, 1e-6)

    def ramp(t: FloatArray) -> FloatArray:  # twice integrated Gaussian density
        z = t / sigma
        return sigma * (z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    x = np.asarray(x_px, float)
    return ramp(x + 0.5) - ramp(x - 0.5)
