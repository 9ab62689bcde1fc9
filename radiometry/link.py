"""The closed-form link budget: electrons of a bit, SNR, CNR, sampling and smear, without rendering.

Every function broadcasts. Lengths are in metres; the marker plane is z = 0 of the marker frame with its normal along z.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray
from radiometry.optics import Camera, pixel_profile_integral
from radiometry.sources import LedRing
from radiometry.spectrum import Spectrum

#: BRDF f(normal, to_source, to_viewer, wavelength_nm) [sr⁻¹] of unit vectors (..., 3).
Brdf = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]

_NORMAL = np.array([0.0, 0.0, 1.0])


def _unit(vector: FloatArray) -> FloatArray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def ring_transport(
    points_m: ArrayLike,
    viewer_m: ArrayLike,
    leds_m: ArrayLike,
    axis: ArrayLike,
    ring: LedRing,
    brdf: Brdf,
    wavelength_nm: ArrayLike,
) -> FloatArray:
    """Radiance of an unshadowed point towards the viewer per unit on-axis intensity of the whole ring [m⁻²].

    L/I₀ = mean over the LEDs of p(θ) f(ω_led, ω_viewer) cosθ_i / d², with the pattern p of `LedRing`.

    Args:
        points_m: (..., 3) on the marker plane.
        viewer_m: (3,) centre of the lens.
        leds_m: (k, 3) positions of the LEDs.
        axis: (3,) unit vector along which the LEDs aim.
        wavelength_nm: (w,).

    Returns:
        (..., w).
    """
    points = np.asarray(points_m, float)[..., None, None, :]
    leds = np.asarray(leds_m, float)[:, None, :]
    wavelength = np.asarray(wavelength_nm, float)
    towards = leds - points
    distance2 = np.sum(towards**2, axis=-1)
    to_led = towards / np.sqrt(distance2)[..., None]
    to_viewer = _unit(np.asarray(viewer_m, float) - points)
    strength = ring.pattern(-to_led @ np.asarray(axis, float)) * np.clip(to_led[..., 2], 0, None) / distance2
    return np.mean(brdf(_NORMAL, to_led, to_viewer, wavelength) * strength, axis=-2)


def sun_transport(
    points_m: ArrayLike, viewer_m: ArrayLike, to_sun: ArrayLike, brdf: Brdf, wavelength_nm: ArrayLike
) -> FloatArray:
    """Radiance of an unshadowed point towards the viewer per unit solar irradiance [sr⁻¹]: f cosθ_i, (..., w)."""
    to_viewer = _unit(np.asarray(viewer_m, float) - np.asarray(points_m, float))[..., None, :]
    to_sun = np.asarray(to_sun, float)
    return brdf(_NORMAL, to_sun, to_viewer, np.asarray(wavelength_nm, float)) * max(to_sun[2], 0.0)


def electron_rate(
    transport: ArrayLike, wavelength_nm: ArrayLike, strength: Spectrum, responsivity: Spectrum
) -> FloatArray:
    """Electron rate of a pixel on the axis [e⁻/s]: ∫ T(λ) s(λ) r(λ) dλ, T linear between its samples.

    Args:
        transport: (..., w) radiance per unit source strength.
        wavelength_nm: (w,) its wavelengths; they must span the band.
        strength: spectral intensity or irradiance of the source.
        responsivity: of the camera, `optics.electron_responsivity`.
    """
    band = strength * responsivity
    grid, value = band.wavelength_nm, band.values
    step = np.diff(grid)
    trapezoid = np.concatenate([[step[0]], step[:-1] + step[1:], [step[-1]]]) / 2 * value
    nodes = np.asarray(wavelength_nm, float)
    upper = np.clip(np.searchsorted(nodes, grid), 1, len(nodes) - 1)
    share = np.clip((grid - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]), 0, 1)
    weights = np.bincount(upper, trapezoid * share, len(nodes)) + np.bincount(
        upper - 1, trapezoid * (1 - share), len(nodes)
    )
    return np.asarray(transport, float) @ weights


def band_grid(responsivity: Spectrum, step_nm: float = 5.0) -> FloatArray:
    """Wavelengths at which the closed form evaluates reflectance: the band in steps of `step_nm` or finer [nm]."""
    low, high = responsivity.support_nm
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step_nm)) + 1))


def sampling_window_px(bit_px: ArrayLike) -> FloatArray:
    """Width of the square about a bit's centre whose pixels count as the bit's [px]: its middle half, one pixel at least."""
    return np.maximum(np.asarray(bit_px, float) / 2, 1.0)


def reflective_fill(pixels_px: ArrayLike, rectangles_px: ArrayLike, psf_sigma_px: float) -> FloatArray:
    """Share of each pixel's light that comes from reflective cells, (n,).

    The pattern of rectangles is convolved with point spread and pixel, both separable, so each rectangle adds a product of two
    differences of `optics.pixel_profile_integral`.

    Args:
        pixels_px: (n, 2) pixel centres in the marker's own axes, scaled to pixels.
        rectangles_px: (m, 4) reflective cells x0, x1, y0, y1 likewise.
    """
    pixels, cells = np.asarray(pixels_px, float), np.asarray(rectangles_px, float)
    share = [
        pixel_profile_integral(cells[:, 2 * axis + 1] - pixels[:, axis, None], psf_sigma_px)
        - pixel_profile_integral(cells[:, 2 * axis] - pixels[:, axis, None], psf_sigma_px)
        for axis in (0, 1)
    ]
    return np.sum(share[0] * share[1], axis=1)


def smear_px(camera: Camera, range_m: ArrayLike, speed_m_s: ArrayLike, exposure_s: ArrayLike) -> FloatArray:
    """Length that a point moving across the line of sight draws on the detector during an exposure [px], the finer pitch."""
    return (
        max(camera.focal_px) * np.asarray(speed_m_s, float) * np.asarray(exposure_s, float) / np.asarray(range_m, float)
    )


def snr(signal_e: ArrayLike, dark_e: ArrayLike, noise_e: ArrayLike) -> FloatArray:
    """Signal-to-noise ratio S / √(S + D + σ²), with read noise and quantisation in σ [electrons]."""
    signal = np.asarray(signal_e, float)
    return signal / np.sqrt(signal + np.asarray(dark_e, float) + np.asarray(noise_e, float) ** 2)


def cnr(signal_e: ArrayLike, background_e: ArrayLike, dark_e: ArrayLike, noise_e: ArrayLike) -> FloatArray:
    """Contrast-to-noise ratio (S − B) / √((S + D + σ²) + (B + D + σ²)) [electrons]."""
    signal, background = np.asarray(signal_e, float), np.asarray(background_e, float)
    variance = signal + background + 2 * (np.asarray(dark_e, float) + np.asarray(noise_e, float) ** 2)
    return (signal - background) / np.sqrt(variance)
