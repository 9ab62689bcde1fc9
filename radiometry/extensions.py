"""What the thesis's link model leaves out, added one step at a time after `radiometry.corrections`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radiometry import link
from radiometry.corrections import Correction, RangeTerm, solar_band_w_m2
from radiometry.geometry import FloatArray, observation_angle
from radiometry.optics import Camera
from radiometry.sources import LedRing
from radiometry.thesis import PrintedModel

#: Light that passes optics which narrow an LED's beam, over the light that enters; assumption.
BEAM_OPTICS_EFFICIENCY = 0.8


@dataclass(frozen=True)
class Surroundings:
    """What a scenario states and the thesis leaves out.

    Attributes:
        ring: LEDs around the lens, with the beam of the model's settings. Their baseline and pattern are used.
        camera: its two pixel pitches are used.
        tape, absorber: reflectances f(normal, to_source, to_viewer, wavelength_nm) [sr⁻¹].
        sun_phase_rad: angle Sun–target–camera [rad].
        bright_fill, dark_fill: range [m] -> share of the light of a bright bit's and of an absorbing cell's pixel that
            comes from tape.
    """

    ring: LedRing
    camera: Camera
    tape: link.Brdf
    absorber: link.Brdf
    sun_phase_rad: float
    bright_fill: Callable[[FloatArray], FloatArray]
    dark_fill: Callable[[FloatArray], FloatArray]


def extensions(scene: Surroundings) -> tuple[Correction, ...]:
    """The steps from the corrected model to the physics of a scenario, on the optical axis.

    Args:
        scene: what the scenario states.
    """
    baseline, normal = scene.ring.ring_radius_m, np.array([0.0, 0.0, 1.0])
    sun = np.array([np.sin(scene.sun_phase_rad), 0.0, np.cos(scene.sun_phase_rad)])

    def ring_irradiance(s: PrintedModel, intensity: float, r: FloatArray) -> FloatArray:
        cosine = np.cos(observation_angle(baseline, r))
        return intensity * scene.ring.pattern(cosine) * cosine / (r**2 + baseline**2)

    def towards_leds(brdf: link.Brdf) -> RangeTerm:
        def value(s: PrintedModel, r: FloatArray) -> FloatArray:
            angle = observation_angle(baseline, r)
            led = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
            return brdf(normal, led, normal, np.asarray(s.wavelength_m * 1e9))

        return value

    def towards_sun(brdf: link.Brdf) -> RangeTerm:
        return lambda s, r: np.full_like(r, float(brdf(normal, sun, normal, np.asarray(s.wavelength_m * 1e9))))

    def oblong_pixels(s: PrintedModel, r: FloatArray) -> FloatArray:
        return (s.bit_m * s.focal_length_m / r) ** 2 / scene.camera.pixel_area_m2

    def with_background(signal: FloatArray, background: FloatArray, noise: float) -> FloatArray:
        return link.cnr(signal, background, 0.0, noise)

    return (
        Correction(
            "beam optics",
            "A.5 l. 72",
            "narrowing the beam loses nothing",
            f"{BEAM_OPTICS_EFFICIENCY:g} passes",
            "assumption",
            {"beam_efficiency": BEAM_OPTICS_EFFICIENCY},
        ),
        Correction(
            "ring of LEDs",
            "section 6.2",
            "a point source in the lens, even over its cone",
            "E = I·cosⁿα·cosα/(R² + b²), α = atan(b/R)",
            "pattern of a lensed emitter; b is the scenario's",
            {"led_irradiance": ring_irradiance},
        ),
        Correction(
            "lobe of the tape",
            "eq. 6.4",
            "200 sr⁻¹ at every range",
            "f(atan(b/R)), and f(phase) for the Sun",
            "table of the tape in materials/data",
            {"led_brdf": towards_leds(scene.tape), "sun_brdf": towards_sun(scene.tape)},
        ),
        Correction(
            "slanting Sun",
            "eq. 6.1",
            "the Sun stands square to the marker",
            "E·cos(phase)",
            "projected area; the phase is the scenario's",
            {"sun_irradiance": lambda s: solar_band_w_m2() * max(float(sun[2]), 0.0)},
        ),
        Correction(
            "oblong pixels",
            "A.5 l. 11",
            "8.6 × 8.6 µm",
            "8.6 × 8.3 µm",
            "thesis, table 3.1",
            {"bit_px2": oblong_pixels},
        ),
        Correction(
            "blur and neighbours",
            "A.5 l. 83",
            "a bit's light stays within its square",
            "pattern ⊗ point spread ⊗ pixel",
            "`radiometry.link.reflective_fill`",
            {"fill": lambda pixels, r: scene.bright_fill(r)},
        ),
        Correction(
            "background",
            "text of section 6.2; A.5 l. 91–92",
            "S/N, and the background is commented out",
            "CNR = (S − B)/√(S + B + 2σ²)",
            "difference of two independent pixels",
            {
                "led_brdf_dark": towards_leds(scene.absorber),
                "sun_brdf_dark": towards_sun(scene.absorber),
                "fill_dark": lambda pixels, r: scene.dark_fill(r),
                "merit": with_background,
            },
        ),
    )
