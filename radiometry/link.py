"""The closed-form link budget: electrons of a bit, SNR, CNR, sampling and smear, without rendering.

Every function broadcasts. Lengths are in metres. The marker plane is z = 0 of the marker frame, with its normal along z.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

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

    L/I₀ is the mean over the LEDs of p(θ) f(ω_led, ω_viewer) cosθ_i / d², with the pattern p of `LedRing`. All positions
    are in the marker frame.

    Args:
        points_m: points on the marker plane, (..., 3) [m].
        viewer_m: centre of the lens, (3,) [m].
        leds_m: positions of the LEDs, (k, 3) [m].
        axis: unit vector along which the LEDs aim, (3,).
        ring: the LEDs, for their pattern.
        brdf: reflectance of the points [sr⁻¹].
        wavelength_nm: (w,) [nm].

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
    """Radiance of an unshadowed point towards the viewer per unit solar irradiance [sr⁻¹]: f cosθ_i.

    Args:
        points_m: points on the marker plane, (..., 3) [m].
        viewer_m: centre of the lens, (3,) [m].
        to_sun: unit vector to the Sun, (3,).
        brdf: reflectance of the points [sr⁻¹].
        wavelength_nm: (w,) [nm].

    Returns:
        (..., w).
    """
    to_viewer = _unit(np.asarray(viewer_m, float) - np.asarray(points_m, float))[..., None, :]
    to_sun = np.asarray(to_sun, float)
    return brdf(_NORMAL, to_sun, to_viewer, np.asarray(wavelength_nm, float)) * max(to_sun[2], 0.0)


def electron_rate(
    transport: ArrayLike, wavelength_nm: ArrayLike, strength: Spectrum, responsivity: Spectrum
) -> FloatArray:
    """Electron rate of a pixel on the optical axis [e⁻/s]: ∫ T(λ) s(λ) r(λ) dλ, with T linear between its samples.

    Args:
        transport: radiance per unit source strength, (..., w).
        wavelength_nm: wavelengths of the transport, (w,) [nm]; they must span the band.
        strength: spectral intensity or irradiance of the source.
        responsivity: of the camera, from `optics.electron_responsivity`.

    Returns:
        (...).
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
    """Wavelengths at which the closed form evaluates reflectance (n,) [nm]: the whole band in equal steps.

    Args:
        responsivity: of the camera; its support is the band.
        step_nm: largest step [nm].
    """
    low, high = responsivity.support_nm
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step_nm)) + 1))


def sampling_window_px(bit_px: ArrayLike) -> FloatArray:
    """Width of the square about a bit's centre whose pixels count as the bit's [px]: half a bit, and at least one pixel.

    Args:
        bit_px: side of a bit in the image [px].
    """
    return np.maximum(np.asarray(bit_px, float) / 2, 1.0)


def reflective_fill(
    pixels_px: ArrayLike, cells_px: ArrayLike, psf_sigma_px: float, shares: ArrayLike = 1.0
) -> FloatArray:
    """Share of each pixel's light that comes from reflective cells, (n,).

    The pattern is convolved with the point spread and the pixel, and both are separable. A cell that is aligned with the
    pixels adds the product of two differences of `optics.pixel_profile_integral`. Any other cell is cut into rows: exact
    along a row, and by Gauss–Legendre quadrature across the rows (to 1e-6 for a point spread from 0.2 px on, to 3e-4 below
    that).

    Args:
        pixels_px: pixel centres, (n, 2) [px].
        cells_px: reflective cells that do not overlap [px]: rectangles (m, 4) as x0, x1, y0, y1, or corners of convex
            polygons in order, (m, k, 2).
        psf_sigma_px: standard deviation of the point spread [px].
        shares: share of each cell that reflects, evenly spread over it, (m,).
    """
    shares = np.broadcast_to(np.asarray(shares, float), (len(np.asarray(cells_px)),))
    pixels, cells = np.asarray(pixels_px, float), np.asarray(cells_px, float)
    if cells.ndim == 3:
        return _polygon_fill(pixels, cells, psf_sigma_px, shares)
    share = [
        pixel_profile_integral(cells[:, 2 * axis + 1] - pixels[:, axis, None], psf_sigma_px)
        - pixel_profile_integral(cells[:, 2 * axis] - pixels[:, axis, None], psf_sigma_px)
        for axis in (0, 1)
    ]
    return (share[0] * share[1]) @ shares


#: Nodes and weights on −1 … 1 for each stretch of rows between two kinks of the integrand.
_ROWS, _ROW_WEIGHTS = np.polynomial.legendre.leggauss(8)


def _polygon_fill(pixels: FloatArray, polygons: FloatArray, psf_sigma_px: float, shares: FloatArray) -> FloatArray:
    """`reflective_fill` of convex polygons (m, k, 2)."""
    sigma = max(psf_sigma_px, 1e-6)
    reach = 0.5 + 5 * sigma  # the kernel holds 6e-7 beyond
    low, high = polygons.min(axis=1), polygons.max(axis=1)
    near = np.all((high > pixels[:, None] - reach) & (low < pixels[:, None] + reach), axis=-1)
    pixel, cell = np.nonzero(near)
    polygon = polygons[cell] - pixels[pixel, None]
    side = np.roll(polygon, -1, axis=1) - polygon
    whole = _depth(polygon, side) > np.hypot(reach, reach)
    filled = np.bincount(pixel[whole], shares[cell[whole]], len(pixels))
    pixel, cell, polygon, side = (values[~whole] for values in (pixel, cell, polygon, side))
    if len(pixel) == 0:
        return filled

    # Rows between the corners' heights; the kernel itself bends at the pixel's edges, and a slanted side runs through its
    # bends from left to right at heights of their own.
    kinks = np.array([-reach, -0.5, 0.5, reach])
    slope = np.divide(side[..., 1], side[..., 0], out=np.zeros_like(side[..., 0]), where=np.abs(side[..., 0]) > 1e-12)
    passes = (polygon[..., 1, None] + (kinks - polygon[..., 0, None]) * slope[..., None]).reshape(len(polygon), -1)
    bends = np.concatenate([polygon[..., 1], np.broadcast_to([-0.5, 0.5], (len(polygon), 2)), passes], axis=1)
    edges = np.sort(np.clip(bends, -reach, reach), axis=1)
    half = np.diff(edges, axis=1)[..., None] / 2
    row = (edges[:, :-1, None] + half * (1 + _ROWS)).reshape(len(polygon), -1)
    weight = (half * _ROW_WEIGHTS).reshape(len(polygon), -1) * (ndtr((row + 0.5) / sigma) - ndtr((row - 0.5) / sigma))

    height = np.where(np.abs(side[:, None, :, 1]) > 1e-12, side[:, None, :, 1], 0.0)
    along = (row[..., None] - polygon[:, None, :, 1]) / np.where(height == 0, np.inf, height)
    crossed = (along >= 0) & (along <= 1) & (height != 0)
    x = polygon[:, None, :, 0] + along * side[:, None, :, 0]
    left = np.where(crossed, x, np.inf).min(axis=-1)
    right = np.where(crossed, x, -np.inf).max(axis=-1)
    left, right = np.clip(left, -reach, reach), np.clip(right, -reach, reach)
    strip = pixel_profile_integral(right, sigma) - pixel_profile_integral(left, sigma)
    inside = np.sum(weight * np.where(right > left, strip, 0.0), axis=1)
    return filled + np.bincount(pixel, inside * shares[cell], len(pixels))


def _depth(polygon: FloatArray, side: FloatArray) -> FloatArray:
    """How far the origin lies within convex polygons (n, k, 2) from the nearest side, negative outside (n,)."""
    length = np.maximum(np.linalg.norm(side, axis=-1), 1e-12)
    distance = (polygon[..., 0] * side[..., 1] - polygon[..., 1] * side[..., 0]) / length
    return np.maximum(distance.min(axis=1), (-distance).min(axis=1))


def smear_px(camera: Camera, range_m: ArrayLike, speed_m_s: ArrayLike, exposure_s: ArrayLike) -> FloatArray:
    """Length of the trace that a point draws on the detector during an exposure [px of the finer pitch].

    Args:
        camera: for its focal length and pixel pitches.
        range_m: distance of the point [m].
        speed_m_s: speed across the line of sight [m/s].
        exposure_s: exposure time [s].

    Returns:
        Of the shape to which range, speed and exposure broadcast.
    """
    return (
        max(camera.focal_px) * np.asarray(speed_m_s, float) * np.asarray(exposure_s, float) / np.asarray(range_m, float)
    )


def frames_per_second(
    power_w: ArrayLike, energy_j: ArrayLike, pulse_s: ArrayLike = 0.0, duty_max: float = 1.0
) -> FloatArray:
    """Highest frame rate at a mean electrical power [s⁻¹]: the smaller of P / E and, for the duty cycle of the LEDs, d_max / t.

    This is equation 6.10 of the thesis, solved for the frame rate, with the energy of one frame E = P_LED · n · t.

    Args:
        power_w: mean power P that the illuminator may draw [W].
        energy_j: energy E of one frame, from `LedRing.energy_per_frame_j` [J].
        pulse_s: pulse t of one frame [s]; 0 leaves the duty cycle out.
        duty_max: largest share of time on, `LedRing.duty_max`.

    Returns:
        Of the shape to which the arguments broadcast.
    """
    energy, pulse = np.asarray(energy_j, float), np.asarray(pulse_s, float)
    by_duty = np.divide(duty_max, pulse, out=np.full(pulse.shape, np.inf), where=pulse > 0)
    return np.minimum(np.asarray(power_w, float) / energy, by_duty)


def snr(signal_e: ArrayLike, dark_e: ArrayLike, noise_e: ArrayLike) -> FloatArray:
    """Signal-to-noise ratio S / √(S + D + σ²).

    Args:
        signal_e: mean signal S [electrons].
        dark_e: mean dark charge D [electrons].
        noise_e: read noise σ, quantisation included [electrons].

    Returns:
        Of the shape to which the arguments broadcast.

    Example:
        Shot noise alone gives the root of the signal:

        >>> from radiometry.link import snr
        >>> float(snr(10_000.0, 0.0, 0.0))
        100.0
    """
    signal = np.asarray(signal_e, float)
    return signal / np.sqrt(signal + np.asarray(dark_e, float) + np.asarray(noise_e, float) ** 2)


def cnr(signal_e: ArrayLike, background_e: ArrayLike, dark_e: ArrayLike, noise_e: ArrayLike) -> FloatArray:
    """Contrast-to-noise ratio (S − B) / √((S + D + σ²) + (B + D + σ²)) of a bright and a dark pixel.

    Args:
        signal_e: mean charge S of the bright pixel [electrons].
        background_e: mean charge B of the dark pixel [electrons].
        dark_e: mean dark charge D of each [electrons].
        noise_e: read noise σ of each, quantisation included [electrons].

    Returns:
        Of the shape to which the arguments broadcast.

    Example:
        >>> from radiometry.link import cnr
        >>> round(float(cnr(1000.0, 100.0, 0.0, 10.0)), 2)
        24.96
    """
    signal, background = np.asarray(signal_e, float), np.asarray(background_e, float)
    variance = signal + background + 2 * (np.asarray(dark_e, float) + np.asarray(noise_e, float) ** 2)
    return (signal - background) / np.sqrt(variance)
