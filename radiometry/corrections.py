"""The thesis's link model, corrected one error at a time.

`printed_model` is listing A.5 as a product of named terms. A `Correction` replaces some of these terms. Its factor on
signal and SNR is found by evaluating the model before and after it, and is never stored. `CORRECTIONS` mend the errors
within the thesis's own assumptions (ideal optics, flat tape of 200 sr⁻¹). `radiometry.extensions` then adds the physics
that a scenario states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radiometry import link
from radiometry.geometry import FloatArray
from radiometry.optics import electrons_per_joule
from radiometry.sources import am0_spectrum
from radiometry.spectrum import constant
from radiometry.thesis import PrintedModel

#: Which sources shine: the LEDs alone are the eclipse, LEDs and Sun the sunlit case; the Sun alone is a frame without LEDs.
LED, SUN = "led", "sun"
#: BRDF of white sheeting away from its retro lobe [sr⁻¹]: a luminance factor near 0.3 over π; assumption.
SHEETING_BRDF_SR = 0.10

#: A quantity of the settings and the range.
RangeTerm = Callable[[PrintedModel, FloatArray], FloatArray]
#: Share of light that comes from tape, from the pixels per bit and the range.
FillTerm = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class LinkModel:
    """Signal of a bit's pixel as a product of terms, each of which a correction may replace. Lengths are in metres.

    Attributes:
        settings: the thesis's parameters.
        catalogue_half_angle_rad: full angle of the emitter [deg] -> its half angle [rad].
        cone_sr: half angle of a cone [rad] -> its solid angle [sr].
        beam_efficiency: light that leaves the beam optics over the light that enters.
        led_irradiance: (settings, intensity on the axis [W/sr], range) -> irradiance of the bit [W/m²].
        sun_irradiance: settings -> irradiance of the bit [W/m²].
        led_brdf, sun_brdf: reflectance of the bit [sr⁻¹].
        led_brdf_dark, sun_brdf_dark: reflectance of the absorbing cells [sr⁻¹].
        lens_sr: solid angle of the lens as seen from the bit.
        bit_px2: number of pixels that the bit's image covers.
        fill: (pixels per bit, range) -> share of the light of a bright bit's pixel that comes from tape.
        fill_dark: the same for the absorbing cells beside the bit.
        further_area: an area in arbitrary units by which the listing multiplies once more.
        merit: (signal, background, read noise) [electrons] -> SNR or CNR.
    """

    settings: PrintedModel
    catalogue_half_angle_rad: Callable[[float], float]
    cone_sr: Callable[[float], float]
    beam_efficiency: float
    led_irradiance: Callable[[PrintedModel, float, FloatArray], FloatArray]
    sun_irradiance: Callable[[PrintedModel], float]
    led_brdf: RangeTerm
    sun_brdf: RangeTerm
    led_brdf_dark: RangeTerm
    sun_brdf_dark: RangeTerm
    lens_sr: RangeTerm
    bit_px2: RangeTerm
    fill: FillTerm
    fill_dark: FillTerm
    further_area: float
    merit: Callable[[FloatArray, FloatArray, float], FloatArray]

    @property
    def intensity_w_sr(self) -> float:
        """Radiant intensity of all LEDs, spread evenly over the beam's cone [W/sr]."""
        s = self.settings
        emitted = self.cone_sr(self.catalogue_half_angle_rad(s.led_full_angle_deg))
        beam = self.cone_sr(float(np.radians(s.light_cone_deg)) / 2)
        return s.led_count * s.led_intensity_w_sr * emitted / beam * self.beam_efficiency

    def signal_e(self, range_m: ArrayLike, exposure_s: ArrayLike, sources: Iterable[str]) -> FloatArray:
        """Electrons of a bright bit's pixel.

        Args:
            range_m: distance of the marker [m].
            exposure_s: exposure time [s]; broadcasts with the range.
            sources: `LED`, `SUN` or both.
        """
        return self._charge(range_m, exposure_s, sources, self.fill)

    def background_e(self, range_m: ArrayLike, exposure_s: ArrayLike, sources: Iterable[str]) -> FloatArray:
        """Electrons of an absorbing cell's pixel beside the bit; zero until the background is added to the model.

        Args:
            range_m: distance of the marker [m].
            exposure_s: exposure time [s]; broadcasts with the range.
            sources: `LED`, `SUN` or both.
        """
        return self._charge(range_m, exposure_s, sources, self.fill_dark)

    def snr(self, range_m: ArrayLike, exposure_s: ArrayLike, sources: Iterable[str]) -> FloatArray:
        """Signal-to-noise ratio as the model defines it; contrast-to-noise ratio once the model has a background.

        Args:
            range_m: distance of the marker [m].
            exposure_s: exposure time [s]; broadcasts with the range.
            sources: `LED`, `SUN` or both.
        """
        signal = self.signal_e(range_m, exposure_s, sources)
        return self.merit(signal, self.background_e(range_m, exposure_s, sources), self.settings.dark_noise_e)

    def _charge(self, range_m: ArrayLike, exposure_s: ArrayLike, sources: Iterable[str], fill: FillTerm) -> FloatArray:
        s, distance = self.settings, np.asarray(range_m, float)
        bright, dark = np.zeros_like(distance), np.zeros_like(distance)
        for source in sources:
            if source == LED:
                irradiance = self.led_irradiance(s, self.intensity_w_sr, distance)
                bright = bright + irradiance * self.led_brdf(s, distance)
                dark = dark + irradiance * self.led_brdf_dark(s, distance)
            else:
                bright = bright + self.sun_irradiance(s) * self.sun_brdf(s, distance)
                dark = dark + self.sun_irradiance(s) * self.sun_brdf_dark(s, distance)
        pixels = self.bit_px2(s, distance)
        share = fill(pixels, distance)
        flux = (share * bright + (1 - share) * dark) * s.bit_m**2 * self.lens_sr(s, distance) / pixels
        electrons = electrons_per_joule(s.wavelength_m * 1e9) * s.quantum_efficiency * s.throughput
        return flux * self.further_area * electrons * np.asarray(exposure_s, float)


@dataclass(frozen=True)
class Correction:
    """One change of the link model. Call it with a model to get the changed model.

    Attributes:
        name: short, for tables and figures.
        where: equation of the thesis's section 6.2 or line of listing A.5.
        printed: what the thesis does.
        right: what is right, as a formula.
        source: where that formula or number comes from.
        terms: fields of `LinkModel` and what replaces them.
    """

    name: str
    where: str
    printed: str
    right: str
    source: str
    terms: dict[str, Any]

    def __call__(self, model: LinkModel) -> LinkModel:
        """The model with this correction made and nothing else changed."""
        return replace(model, **self.terms)


@dataclass(frozen=True)
class Step:
    """The model after one more correction.

    Attributes:
        correction: the one made in this step.
        signal_e: signal after it [electrons].
        snr: SNR or CNR after it.
        signal_factor: signal after over signal before.
        snr_factor: SNR after over SNR before.
    """

    correction: Correction
    signal_e: FloatArray
    snr: FloatArray
    signal_factor: FloatArray
    snr_factor: FloatArray


def waterfall(
    model: LinkModel,
    corrections: Iterable[Correction],
    range_m: ArrayLike,
    exposure_s: ArrayLike,
    sources: Iterable[str],
) -> list[Step]:
    """Make corrections one after another and record what each of them does.

    Args:
        model: the model to start from.
        corrections: in the order in which they are made.
        range_m: distances of the marker [m].
        exposure_s: exposure times [s]; broadcast with the ranges.
        sources: `LED`, `SUN` or both.

    Returns:
        A step for each correction; its arrays have the shape to which ranges and exposures broadcast.
    """
    steps, lit = [], tuple(sources)
    signal, snr = model.signal_e(range_m, exposure_s, lit), model.snr(range_m, exposure_s, lit)
    for correction in corrections:
        model = correction(model)
        before = signal, snr
        signal, snr = model.signal_e(range_m, exposure_s, lit), model.snr(range_m, exposure_s, lit)
        steps.append(Step(correction, signal, snr, signal / before[0], snr / before[1]))
    return steps


def corrected(model: LinkModel, corrections: Iterable[Correction]) -> LinkModel:
    """The model after all of these corrections.

    Args:
        model: the model to start from.
        corrections: in the order in which they are made.
    """
    for correction in corrections:
        model = correction(model)
    return model


def beam_power_w(intensity_w_sr: float, full_angle_deg: float) -> float:
    """Light in a cone of even intensity [W]: I · 2π(1 − cos(c/2)). It cannot exceed the power that the LEDs are given.

    Args:
        intensity_w_sr: radiant intensity I within the cone [W/sr].
        full_angle_deg: full angle c of the cone [deg].
    """
    return intensity_w_sr * _cap(float(np.radians(full_angle_deg)) / 2)


@cache
def solar_band_w_m2() -> float:
    """Solar irradiance outside the atmosphere over 800–900 nm [W/m²], ASTM G173-03."""
    return (am0_spectrum() * constant(1.0, 800.0, 900.0)).integral()


def _flat_disc(half_rad: float) -> float:
    return np.pi * float(np.arctan(half_rad)) ** 2


def _cap(half_rad: float) -> float:
    return 2 * np.pi * (1 - float(np.cos(half_rad)))


def _zero(s: PrintedModel, range_m: FloatArray) -> FloatArray:
    return np.zeros_like(range_m)


def _printed_bit_px2(s: PrintedModel, range_m: FloatArray) -> FloatArray:
    return (np.arctan(s.bit_m / 2 / range_m) / (np.radians(s.field_of_view_deg) / 2) * s.detector_px) ** 2


def _square_pixels(s: PrintedModel, range_m: FloatArray) -> FloatArray:
    return (s.bit_m * s.focal_length_m / (s.pixel_pitch_mm * 1e-3 * range_m)) ** 2


def printed_model(settings: PrintedModel | None = None) -> LinkModel:
    """Listing A.5 with all its errors; it gives the same numbers as `PrintedModel.signal_e` and `snr`.

    Args:
        settings: parameters of the listing; default the printed ones.
    """
    settings = settings or PrintedModel()
    return LinkModel(
        settings=settings,
        catalogue_half_angle_rad=lambda full_deg: full_deg / 2,
        cone_sr=_flat_disc,
        beam_efficiency=1.0,
        led_irradiance=lambda s, intensity, r: intensity * s.bit_m**2 / r**2,
        sun_irradiance=lambda s: s.sun_irradiance_w_m2,
        led_brdf=lambda s, r: np.full_like(r, s.brdf_sr),
        sun_brdf=lambda s, r: np.full_like(r, s.brdf_sr),
        led_brdf_dark=_zero,
        sun_brdf_dark=_zero,
        lens_sr=lambda s, r: np.pi * (s.focal_length_m / s.f_number) ** 2 / r**2,
        bit_px2=_printed_bit_px2,
        fill=lambda pixels, r: np.ones_like(r),
        fill_dark=lambda pixels, r: np.zeros_like(r),
        further_area=settings.pixel_pitch_mm**2,
        merit=lambda signal, background, noise: signal / (np.sqrt(signal) + noise),
    )


NOISE_IN_QUADRATURE = Correction(
    "noise added linearly",
    "eq. 6.9; A.5 l. 97",
    "N = √S + 28.2",
    "N = √(S + 28.2²)",
    "independent noises add in variance",
    {"merit": lambda signal, background, noise: link.snr(signal, 0.0, noise)},
)

#: Errors of the thesis in the order of its own derivation. After all of them the model is the physics of its own assumptions.
CORRECTIONS: tuple[Correction, ...] = (
    Correction(
        "degrees taken for radians",
        "A.5 l. 68",
        "emitter's half angle is 12 rad: Ω = π·atan(12)²",
        "12° = 0.209 rad",
        "unit",
        {"catalogue_half_angle_rad": lambda full_deg: float(np.radians(full_deg)) / 2},
    ),
    Correction(
        "flat disc for a cap",
        "A.5 l. 65–70",
        "Ω = π·atan(θ)²",
        "Ω = 2π(1 − cos θ)",
        "solid angle of a cone",
        {"cone_sr": _cap},
    ),
    Correction(
        "flux for irradiance",
        "eq. 6.2, 6.3; A.5 l. 73–76",
        "E = I·w²/R², a flux in W",
        "E = I/R² in W/m²",
        "inverse-square law",
        {"led_irradiance": lambda s, intensity, r: intensity / r**2},
    ),
    Correction(
        "diameter for radius",
        "eq. 6.5; A.5 l. 62",
        "Ω = π·D²/R²",
        "Ω = π·D²/(4R²)",
        "area of a disc",
        {"lens_sr": lambda s, r: np.pi * (s.focal_length_m / s.f_number) ** 2 / (4 * r**2)},
    ),
    Correction(
        "second pixel area, in mm²",
        "eq. 6.7; A.5 l. 11, 87",
        "L·A_bit·Ω/n², which is W a pixel, times (8.6e-3)²",
        "W a pixel as it stands",
        "units; pitch is 8.6 µm",
        {"further_area": 1.0},
    ),
    Correction(
        "field of view of 16°",
        "eq. 6.6; A.5 l. 57",
        "n = atan(w/2R)/8° · 752",
        "n = w·f/(p·R)",
        "pinhole; 20.19 mm and 8.6 µm make 18.2°, not 16°",
        {"bit_px2": _square_pixels},
    ),
    Correction(
        "bits smaller than a pixel",
        "A.5 l. 59–61, 83",
        "divides by n² below one pixel, too",
        "fill = min(1, n²)",
        "a pixel collects no more than the bit sends",
        {"fill": lambda pixels, r: np.minimum(1.0, pixels)},
    ),
    Correction(
        "retro peak for the Sun",
        "eq. 6.4; A.5 l. 79",
        "200 sr⁻¹ for sunlight",
        "0.10 sr⁻¹ away from the lobe",
        "luminance factor of white sheeting near 0.3 over π; assumption",
        {"sun_brdf": lambda s, r: np.full_like(r, SHEETING_BRDF_SR)},
    ),
    Correction(
        "solar band",
        "eq. 6.1",
        "1 W/m²/nm",
        "∫ E dλ over 800–900 nm",
        "ASTM G173-03, extraterrestrial column",
        {"sun_irradiance": lambda s: solar_band_w_m2()},
    ),
    NOISE_IN_QUADRATURE,
)
