"""The closed form of `chain.link_budget` over many parameter sets at once: a frontal marker, averaged over sub-pixel phases.

Transport is computed once for each tape, marker size, range and Sun; focal length, F-number, LED count and the factors of
uncertain assumptions then only multiply it. What it leaves out against `chain.link_budget`: where on the pixels the marker
happens to stand, light from the encoding elements' slits, and the face beyond the marker's edge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.close.constraints import Constraints, at_life
from materials import library
from radiometry import link
from radiometry.geometry import FRONTAL, FloatArray
from radiometry.optics import pixel_profile_integral
from radiometry.spectrum import constant
from scenes.marker import MarkerDesign

#: By what the average over sub-pixel phases differs at most from `chain.link_budget`'s one phase, signal and background over
#: signal: where a bit has two to four pixels, and where it has more.
PHASE_DIFFERENCE, FINE_DIFFERENCE = 0.05, 0.01
#: LEDs that stand for the ring: its mean over the bits no longer changes with their number.
_RING_LEDS = 24
#: Sub-pixel phases along an axis over which the fill is averaged.
_PHASES = 16
#: Sampling and point spread between which the fill is interpolated; of a bit of more pixels the pixel no longer matters, only the
#: point spread over the bit.
_FILL_PX = np.geomspace(0.4, 16.0, 40)
_FILL_SIGMA_PX = np.array(
    [0.0, 0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0]
)


@dataclass(frozen=True)
class Sets:
    """Parameter sets as arrays (n,) that broadcast; `tape` and `size` index the form's tapes and marker sizes.

    `factors` scale assumptions, by the keys of `constraints.UNCERTAIN`; those left out are 1.
    """

    tape: FloatArray
    size: FloatArray
    focal_length_m: FloatArray
    f_number: FloatArray
    led_count: FloatArray
    factors: Mapping[str, FloatArray] = field(default_factory=dict)

    def factor(self, key: str) -> FloatArray:
        """Factor on an assumption, (n,) or (1,)."""
        return np.atleast_1d(np.asarray(self.factors.get(key, 1.0), float))

    def take(self, index: NDArray[np.intp]) -> Sets:
        """Some of the sets, or one of them many times; factors must be single or as many as the result."""
        tape, size, focal, f_number, count = np.broadcast_arrays(
            self.tape, self.size, self.focal_length_m, self.f_number, self.led_count
        )
        return Sets(tape[index], size[index], focal[index], f_number[index], count[index], self.factors)


@dataclass(frozen=True)
class Rates:
    """Electrons per second, (n, lights, ranges); lights are eclipse and then the Sun at each phase.

    `led_*` is of one LED. `foil` is the peak of a facet that mirrors the Sun.
    """

    led_signal: FloatArray
    led_background: FloatArray
    sun_signal: FloatArray
    sun_background: FloatArray
    foil: FloatArray


@dataclass(frozen=True)
class ClosedForm:
    """Tables of one scenario's sources, sensor and materials, for sets that share them. Made by `closed_form`.

    Attributes:
        scenario: the base scenario, its materials and LEDs new or at the end of the mission.
        tapes: names of the tapes when new.
        led_tape: electrons per second of one LED, (lobe: retro and the rest, tape, size, bit: white and black, range).
        led_absorber: the same of the absorber, (size, bit, range).
        sun_tape, sun_absorber, sun_foil: of the Sun, (lobe, tape, phase), (phase,), (phase,).
        falloff: natural fall-off of the lens at the bits, (size, bit, range).
        last_angle_rad: last tabulated observation angle of each tape, (tape,); infinite without a retro lobe.
    """

    scenario: Scenario
    tapes: tuple[str, ...]
    sizes_m: FloatArray
    ranges_m: FloatArray
    phases_deg: FloatArray
    led_tape: FloatArray
    led_absorber: FloatArray
    sun_tape: FloatArray
    sun_absorber: FloatArray
    sun_foil: FloatArray
    falloff: FloatArray
    last_angle_rad: FloatArray

    def px_per_bit(self, sets: Sets) -> FloatArray:
        """Pixels along a bit's shorter side, (n, ranges)."""
        camera = self.scenario.camera
        pitch = max(camera.pixel_pitch_x_m, camera.pixel_pitch_y_m)
        scale = self.sizes_m[sets.size] * sets.focal_length_m * sets.factor("focal_length") * self.bit_fraction / pitch
        return np.atleast_1d(scale)[:, None] / self.ranges_m

    def blur_sigma_px(self, sets: Sets) -> FloatArray:
        """Standard deviation of the point spread, (n, ranges): `optics.blur_sigma_px` with focus at the farthest range."""
        camera = self.scenario.camera
        pixel_m = np.sqrt(camera.pixel_area_m2)
        diffraction = 0.42 * self.scenario.filter.centre_nm * 1e-9 * np.atleast_1d(sets.f_number) / pixel_m
        in_focus = np.maximum(camera.psf_sigma_px * sets.factor("psf"), diffraction)[:, None]
        circle_m = np.atleast_1d(sets.focal_length_m**2 / sets.f_number)[:, None] * (
            1 / self.ranges_m - 1 / self.ranges_m[-1]
        )
        return np.hypot(in_focus, circle_m / 4 / pixel_m)

    @property
    def bit_fraction(self) -> float:
        """Side of a bit over side of the marker."""
        return self.scenario.marker.bit_m / self.scenario.marker.size_m

    def rates(self, sets: Sets) -> Rates:
        """Rates of every set at every light and range."""
        camera, marker = self.scenario.camera, self.scenario.marker
        aspect = camera.pixel_pitch_x_m / camera.pixel_pitch_y_m
        sigma = self.blur_sigma_px(sets)
        px = self.px_per_bit(sets) * max(1.0, 1 / aspect)  # along x, whichever side is the shorter
        fill = _interpolate_fill(marker, aspect, px, sigma)

        gain = (camera.f_number / sets.f_number) ** 2
        gain = np.atleast_1d(gain * sets.factor("quantum_efficiency") * sets.factor("lens_transmission"))[:, None]
        life = np.atleast_1d(sets.factor("retro") * sets.factor("retro_life"))[:, None]
        diffuse, absorber = (np.atleast_1d(sets.factor(k))[:, None] for k in ("tape_diffuse", "absorber"))
        tape, size = np.broadcast_arrays(np.atleast_1d(sets.tape), np.atleast_1d(sets.size))

        angle = np.arctan(self.scenario.leds.ring_radius_m / self.ranges_m)
        beyond = np.maximum(angle / self.last_angle_rad[tape][:, None], 1.0)
        tail = beyond ** (np.log(np.atleast_1d(sets.factor("retro_tail"))[:, None]) / np.log(3.0))
        leds, suns = [], []
        for bit in (0, 1):
            lit = self.led_tape[0, tape, size, bit] * life * tail + self.led_tape[1, tape, size, bit] * diffuse
            dark = self.led_absorber[size, bit] * absorber
            one = (
                (fill[bit] * lit + (1 - fill[bit]) * dark) * gain * np.atleast_1d(sets.factor("led_intensity"))[:, None]
            )
            leds.append(one[:, None, :])
            lit = self.sun_tape[0, tape] * life + self.sun_tape[1, tape] * diffuse
            dark = self.sun_absorber * absorber
            here = fill[bit][:, None, :]
            sun = (here * lit[..., None] + (1 - here) * dark[..., None]) * (gain * self.falloff[size, bit])[:, None, :]
            suns.append(np.concatenate([np.zeros_like(sun[:, :1]), sun], axis=1))
        foil = self.sun_foil * np.atleast_1d(sets.factor("foil_lobe"))[:, None] * gain
        foil = np.concatenate([np.zeros_like(foil[:, :1]), foil], axis=1)[..., None]
        return Rates(leds[0], leds[1], suns[0], suns[1], foil)


def closed_form(
    base: Scenario,
    constraints: Constraints,
    end: bool,
    tapes: tuple[str, ...] | None = None,
    sizes_m: tuple[float, ...] | None = None,
) -> ClosedForm:
    """Tables of transport at the ranges and phases of the constraints; all else is the base scenario's, its tilt taken as none.

    Args:
        base: the scenario as new.
        constraints: ranges, phases, and what may be changed.
        end: with materials and LEDs at the end of the mission.
        tapes: names of tapes; None takes those of the constraints.
        sizes_m: sizes of the marker [m]; None takes those of the constraints.
    """
    tapes = tapes or constraints.tapes
    made = [at_life(base.at(target={**base.target.model_dump(), "tape_material": t}), constraints, end) for t in tapes]
    scenario, materials = made[0], [library.load(s.target.tape_material) for s in made]
    sizes = np.array(sizes_m or constraints.marker_sizes_m)
    ranges, phases = np.array(constraints.ranges_m), np.array(constraints.phases_deg)
    response = chain.responsivity(scenario)
    wavelength = link.band_grid(response)
    ring = scenario.leds.model_copy(update={"count": _RING_LEDS})
    led = ring.model_copy(update={"count": 1}).spectral_intensity()
    sun = scenario.sun.irradiance()
    nothing = constant(0.0)
    lobes = [
        [replace(m, diffuse=nothing, gloss=nothing) for m in materials],
        [replace(m, retro=nothing) for m in materials],
    ]
    absorber = library.load(scenario.target.absorber_material)
    bits = (scenario.marker.white_bit_centres_m(), scenario.marker.black_bit_centres_m())

    led_tape = np.empty((2, len(tapes), len(sizes), 2, len(ranges)))
    led_absorber, falloff = (np.empty((len(sizes), 2, len(ranges))) for _ in range(2))
    for s, b, r in np.ndindex(len(sizes), 2, len(ranges)):
        points = bits[b] * (sizes[s] / scenario.marker.size_m)
        viewer = np.array([0.0, 0.0, ranges[r]])
        positions = (ring.positions_m() - viewer) @ FRONTAL
        fade = (1 + np.sum(points**2, axis=1) / ranges[r] ** 2) ** -2
        falloff[s, b, r] = fade.mean()

        def rate(brdf: link.Brdf, where: tuple = (points, viewer, positions, fade)) -> float:
            points, viewer, positions, fade = where
            transport = link.ring_transport(
                points, viewer, positions, axis=FRONTAL[2], ring=ring, brdf=brdf, wavelength_nm=wavelength
            )
            return float(np.mean(link.electron_rate(transport, wavelength, led, response) * fade))

        led_absorber[s, b, r] = rate(absorber.brdf)
        for lobe, tape in np.ndindex(2, len(tapes)):
            led_tape[lobe, tape, s, b, r] = rate(lobes[lobe][tape].brdf)

    def sunlit(brdf: link.Brdf, phase: float) -> float:
        to_sun = np.array([np.sin(phase), 0.0, np.cos(phase)])
        transport = link.sun_transport(np.zeros(3), np.array([0.0, 0.0, 1.0]), to_sun, brdf, wavelength)
        return float(link.electron_rate(transport, wavelength, sun, response))

    def mirrored(brdf: link.Brdf, phase: float) -> float:
        """A facet that stands square between the Sun and the camera."""
        half = np.array([np.sin(phase / 2), 0.0, np.cos(phase / 2)])
        source, viewer = np.array([[np.sin(phase), 0.0, np.cos(phase)]]), np.array([[0.0, 0.0, 1.0]])
        transport = brdf(half, source, viewer, wavelength) * np.cos(phase / 2)
        return float(link.electron_rate(transport, wavelength, sun, response))

    radians = np.radians(phases)
    foil = library.load(scenario.target.face_material)
    tables = [m.lobes.retro for m in materials]
    return ClosedForm(
        scenario=scenario,
        tapes=tapes,
        sizes_m=sizes,
        ranges_m=ranges,
        phases_deg=phases,
        led_tape=led_tape,
        led_absorber=led_absorber,
        sun_tape=np.array([[[sunlit(m.brdf, p) for p in radians] for m in lobe] for lobe in lobes]),
        sun_absorber=np.array([sunlit(absorber.brdf, p) for p in radians]),
        sun_foil=np.array([mirrored(foil.brdf, p) for p in radians]),
        falloff=falloff,
        last_angle_rad=np.array([np.radians(t.observation_deg[-1]) if t else np.inf for t in tables]),
    )


def _interpolate_fill(marker: MarkerDesign, aspect: float, px: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Share of light from tape in a white and a black bit's pixels, (2, ...), at pixels a bit along x and a point spread."""
    px, sigma = np.broadcast_arrays(px, sigma_px)
    sigma = np.clip(sigma * np.minimum(_FILL_PX[-1] / px, 1), _FILL_SIGMA_PX[0], _FILL_SIGMA_PX[-1])
    px = np.clip(px, _FILL_PX[0], _FILL_PX[-1])
    table = fill_table(marker.model_copy(update={"size_m": 1.0}), round(aspect, 9))
    look_up = RegularGridInterpolator((np.log(_FILL_PX), _FILL_SIGMA_PX), np.moveaxis(table, 0, -1), method="linear")
    return np.moveaxis(look_up(np.stack([np.log(px), sigma], axis=-1)), -1, 0)


@lru_cache(maxsize=8)
def fill_table(marker: MarkerDesign, aspect: float) -> FloatArray:
    """Mean fill over all sub-pixel phases, (2: white and black bits, px per bit along x, point spread).

    A frontal cell lies square to the pixels, so its share of a pixel is a product of a share along x and one along y, and so
    is its mean over phases.

    Args:
        marker: whose bits are seen.
        aspect: column pitch over row pitch.
    """
    cells = marker.reflective_rectangles_m() / marker.bit_m
    bits = [c[:, :2] / marker.bit_m for c in (marker.white_bit_centres_m(), marker.black_bit_centres_m())]
    table = np.empty((2, len(_FILL_PX), len(_FILL_SIGMA_PX)))
    for i, px in enumerate(_FILL_PX):
        for k, sigma in enumerate(_FILL_SIGMA_PX):
            for b, centres in enumerate(bits):
                share = [
                    _mean_share(
                        centres[:, axis], cells[:, 2 * axis : 2 * axis + 2], px * (aspect if axis else 1.0), sigma
                    )
                    for axis in (0, 1)
                ]
                table[b, i, k] = np.mean(np.sum(share[0] * share[1], axis=1))
    return table


def _mean_share(centres: FloatArray, cells: FloatArray, px: float, sigma_px: float) -> FloatArray:
    """Share of each cell's interval in the pixels of each centre, (centres, cells), over sub-pixel phases; lengths in bits."""
    half = float(link.sampling_window_px(px)) / 2
    reach = int(np.ceil(half)) + 1
    phase = (np.arange(_PHASES) + 0.5) / _PHASES - 0.5
    values, which = np.unique(np.round(centres, 6), return_inverse=True)
    spans, span = np.unique(np.round(cells, 6), axis=0, return_inverse=True)
    centre = values[:, None] * px + phase  # (values, phases)
    pixel = np.rint(centre)[..., None] + np.arange(-reach, reach + 1)
    inside = np.abs(pixel - centre[..., None]) <= half
    weight = inside / inside.sum(axis=-1, keepdims=True) / _PHASES
    edges = spans * px + phase[:, None, None]  # (phases, spans, 2)
    offset = edges[None, :, None] - pixel[..., None, None]
    share = np.diff(pixel_profile_integral(offset, sigma_px), axis=-1)[..., 0]
    return np.einsum("vpi,vpis->vs", weight, share)[which][:, span.ravel()]
