"""The numbers of the errata page, by topic."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments.reporting.formatting import ranges_text
from experiments.thesis.errata.plan import BEAM_DEG
from experiments.thesis.errata.study import ErrataResult, full_pixel_snr, link_model
from radiometry.corrections import LED, NOISE_IN_QUADRATURE, beam_power_w, printed_model, solar_band_w_m2
from radiometry.sources import LedRing
from radiometry.thesis import PrintedModel

#: Reflectance of a Spectralon panel at 850 nm (Labsphere, 0.975–0.995 over 750–1600 nm).
_SPECTRALON = 0.99
#: BRDF that the listing gives the foil around the marker (line 39) [sr⁻¹], and that foil's width [m].
_LISTING_FOIL_SR, _LISTING_FOIL_M = 10.0, 1.0
#: Power that the thesis allows the LEDs (below equation 6.10) [W].
_POWER_W = 5.0


@dataclass(frozen=True)
class Beam:
    """Radiant intensity of the LEDs and the power that it takes, and the words with which such a ring is refused."""

    as_bought_w_sr: float
    printed_16deg_w_sr: float
    corrected_16deg_w_sr: float
    printed_8deg_w_sr: float
    corrected_8deg_w_sr: float
    printed_power_w: float
    electrical_power_w: float
    emitted_power_w: float
    printed_over_electrical: float
    printed_over_emitted: float
    refusal: str


@dataclass(frozen=True)
class Eclipse:
    """LEDs alone at 1/30 s, and at the exposure that half fills the well (`auto_`)."""

    printed_snr_6m: float
    printed_snr_7m: float
    printed_snr_8m: float
    printed_snr_9m: float
    printed_snr_20m_fig64: float
    corrected_signal_8m: float
    corrected_signal_20m: float
    corrected_over_printed_8m: float
    corrected_over_printed_20m: float
    full_signal_8m: float
    full_signal_20m: float
    full_over_printed_8m: float
    full_over_printed_20m: float
    shape_change: float
    full_over_well_least: float
    full_over_well_most: float
    fig64_shortest_over_well_least: float
    auto_least_s: float
    auto_most_s: float
    auto_cnr_most: float
    auto_cnr_least: float
    auto_cnr_least_at_m: float
    auto_cnr_fails_at: str
    one_led_20m_s: float


@dataclass(frozen=True)
class Sunlight:
    """The Sun alone (`alone_`) and with the LEDs on (`with_leds_`) at 1 ms, and at the automatic exposure (`auto_`)."""

    band_w_m2: float
    printed_snr_8m: float
    corrected_alone_over_printed_8m: float
    corrected_alone_over_printed_20m: float
    full_alone_over_printed_8m: float
    full_alone_over_printed_20m: float
    corrected_with_leds_over_printed_8m: float
    corrected_with_leds_over_printed_20m: float
    full_with_leds_over_printed_8m: float
    full_with_leds_over_printed_20m: float
    alone_over_well_least: float
    alone_over_well_most: float
    alone_saturates_at: str
    with_leds_over_well_least: float
    with_leds_over_well_most: float
    auto_least_s: float
    auto_most_s: float
    auto_cnr_least: float
    auto_cnr_most: float
    auto_cnr_fails_at: str
    leds_over_sun_least: float
    leds_over_sun_most: float


@dataclass(frozen=True)
class Sampling:
    """Pixels per bit, where they end, and what would reach 20 m."""

    px_per_bit_20m: float
    needed_px: float
    ends_m: float
    ends_10mm_m: float
    bit_for_20m_mm: float
    focal_for_20m_mm: float
    one_pixel_at_m: float
    field_of_view_deg: float


@dataclass(frozen=True)
class Noise:
    """Read noise against shot noise, and the listing's ratio of bit to foil."""

    equal_at_e: float
    read_noise_dominates_at: str
    quadrature_factor_20m: float
    quadrature_factor_most: float
    listing_bit_over_foil_8m: float
    right_bit_over_foil: float


@dataclass(frozen=True)
class Power:
    """Energy of a frame and frames a second at 1/50 s, and at the longest automatic exposure in eclipse."""

    printed_energy_j: float
    printed_fps: float
    energy_j: float
    power_10fps_w: float


@dataclass(frozen=True)
class Tape:
    """Reflectance of the tape over range, and what a white diffuse bit would send."""

    material: str
    baseline_m: float
    brdf_1m_sr: float
    brdf_8m_sr: float
    brdf_20m_sr: float
    spectralon_signal_20m: float
    spectralon_snr_20m: float


@dataclass(frozen=True)
class Facts:
    """Every number of the page by topic; `mantis errata --json` prints them."""

    beam: Beam
    eclipse: Eclipse
    sun: Sunlight
    sampling: Sampling
    noise: Noise
    power: Power
    tape: Tape
    agreement_percent: float
    full_pixel_snr: float


def facts(result: ErrataResult) -> Facts:
    """The numbers that follow from the three models."""
    # The last step's closed form on the axis and the full model are two computations of the same signal.
    agreement = np.abs(result.dataset.signal_factor.isel(step=-1) - 1).max()
    return Facts(
        beam=_beam(result),
        eclipse=_eclipse(result),
        sun=_sunlight(result),
        sampling=_sampling(result),
        noise=_noise(result),
        power=_power(result),
        tape=_tape(result),
        agreement_percent=100 * float(agreement),
        full_pixel_snr=full_pixel_snr(result.scenario),
    )


def _beam(result: ErrataResult) -> Beam:
    thesis = PrintedModel()
    printed, corrected = (
        {beam: link_model(m, beam).intensity_w_sr for beam in (16.0, 8.0)} for m in ("printed", "corrected")
    )
    as_bought = thesis.led_count * thesis.led_intensity_w_sr
    electrical = result.scenario.leds.electrical_power_w * thesis.led_count
    power, emitted = beam_power_w(printed[16.0], 16.0), beam_power_w(as_bought, thesis.led_full_angle_deg)
    return Beam(
        as_bought_w_sr=as_bought,
        printed_16deg_w_sr=printed[16.0],
        corrected_16deg_w_sr=corrected[16.0],
        printed_8deg_w_sr=printed[8.0],
        corrected_8deg_w_sr=corrected[8.0],
        printed_power_w=power,
        electrical_power_w=electrical,
        emitted_power_w=emitted,
        printed_over_electrical=power / electrical,
        printed_over_emitted=power / emitted,
        refusal=_refusal(printed[16.0] / thesis.led_count),
    )


def _refusal(intensity_w_sr: float) -> str:
    """With which words a ring of LEDs of this intensity each is refused; empty where it is not."""
    try:
        LedRing(intensity_w_sr=intensity_w_sr, half_angle_deg=8.0)
    except ValueError as refusal:
        return str(refusal).split("Value error, ")[-1].split(" [type")[0]
    return ""


def _ranges(dataset: xr.Dataset, chosen: NDArray[np.bool_]) -> str:
    grid = [float(r) for r in dataset.range_m.values]
    return ranges_text(grid, [r for r, c in zip(grid, chosen, strict=True) if c])


def _eclipse(result: ErrataResult) -> Eclipse:
    here = result.dataset.sel(illumination="eclipse")
    printed, corrected, full = (here.sel(model=model, exposure="1/30 s") for model in ("printed", "corrected", "full"))
    auto = here.sel(model="full", exposure="auto")
    shortest = here.sel(model="full", exposure="1/200 s, 8°")
    snr = {r: float(printed.snr.sel(range_m=r)) for r in (6, 7, 8, 9)}
    first = {r: float(printed.signal.sel(range_m=r)) for r in (8, 20)}
    fixed = {r: float(corrected.signal.sel(range_m=r)) for r in (8, 20)}
    whole = {r: float(full.signal.sel(range_m=r)) for r in (8, 20)}
    return Eclipse(
        printed_snr_6m=snr[6],
        printed_snr_7m=snr[7],
        printed_snr_8m=snr[8],
        printed_snr_9m=snr[9],
        printed_snr_20m_fig64=float(here.snr.sel(model="printed", exposure="1/50 s, 8°", range_m=20)),
        corrected_signal_8m=fixed[8],
        corrected_signal_20m=fixed[20],
        corrected_over_printed_8m=fixed[8] / first[8],
        corrected_over_printed_20m=fixed[20] / first[20],
        full_signal_8m=whole[8],
        full_signal_20m=whole[20],
        full_over_printed_8m=whole[8] / first[8],
        full_over_printed_20m=whole[20] / first[20],
        shape_change=(fixed[8] / first[8]) / (fixed[20] / first[20]),
        full_over_well_least=float(full.full_well_fraction.min()),
        full_over_well_most=float(full.full_well_fraction.max()),
        fig64_shortest_over_well_least=float(shortest.full_well_fraction.min()),
        auto_least_s=float(auto.exposure_s.min()),
        auto_most_s=float(auto.exposure_s.max()),
        auto_cnr_most=float(auto.cnr.max()),
        auto_cnr_least=float(auto.cnr.min()),
        auto_cnr_least_at_m=float(auto.range_m.values[auto.cnr.values.argmin()]),
        auto_cnr_fails_at=_ranges(here, auto.cnr.values < result.scenario.requirement.cnr_min),
        one_led_20m_s=float(auto.exposure_s.sel(range_m=20)) * PrintedModel().led_count,
    )


def _sunlight(result: ErrataResult) -> Sunlight:
    here = result.dataset.sel(exposure="1 ms")
    full, limits = here.sel(model="full"), result.scenario.requirement
    alone, both = full.sel(illumination="sun alone"), full.sel(illumination="sunlit")
    auto = result.dataset.sel(model="full", illumination="sunlit", exposure="auto")
    led_share = full.signal.sel(illumination="eclipse") / alone.signal

    def over_printed(model: str, illumination: str, range_m: float) -> float:
        at = here.signal.sel(range_m=range_m)
        printed = at.sel(model="printed", illumination="sunlit")
        return float(at.sel(model=model, illumination=illumination)) / float(printed)

    return Sunlight(
        band_w_m2=solar_band_w_m2(),
        printed_snr_8m=float(here.snr.sel(model="printed", illumination="sunlit", range_m=8)),
        corrected_alone_over_printed_8m=over_printed("corrected", "sun alone", 8),
        corrected_alone_over_printed_20m=over_printed("corrected", "sun alone", 20),
        full_alone_over_printed_8m=over_printed("full", "sun alone", 8),
        full_alone_over_printed_20m=over_printed("full", "sun alone", 20),
        corrected_with_leds_over_printed_8m=over_printed("corrected", "sunlit", 8),
        corrected_with_leds_over_printed_20m=over_printed("corrected", "sunlit", 20),
        full_with_leds_over_printed_8m=over_printed("full", "sunlit", 8),
        full_with_leds_over_printed_20m=over_printed("full", "sunlit", 20),
        alone_over_well_least=float(alone.full_well_fraction.min()),
        alone_over_well_most=float(alone.full_well_fraction.max()),
        alone_saturates_at=_ranges(here, alone.full_well_fraction.values > limits.full_well_fraction_max),
        with_leds_over_well_least=float(both.full_well_fraction.min()),
        with_leds_over_well_most=float(both.full_well_fraction.max()),
        auto_least_s=float(auto.exposure_s.min()),
        auto_most_s=float(auto.exposure_s.max()),
        auto_cnr_least=float(auto.cnr.min()),
        auto_cnr_most=float(auto.cnr.max()),
        auto_cnr_fails_at=_ranges(here, auto.cnr.values < limits.cnr_min),
        leds_over_sun_least=float(led_share.min()),
        leds_over_sun_most=float(led_share.max()),
    )


def _sampling(result: ErrataResult) -> Sampling:
    thesis, camera = PrintedModel(), result.scenario.camera
    focal_px, needed = min(camera.focal_px), result.scenario.requirement.px_per_bit_min
    px_per_bit = float(result.dataset.px_per_bit.sel(range_m=20))
    return Sampling(
        px_per_bit_20m=px_per_bit,
        needed_px=needed,
        ends_m=focal_px * thesis.bit_m / needed,
        ends_10mm_m=focal_px * 0.010 / needed,
        bit_for_20m_mm=needed * 20.0 / focal_px * 1e3,
        focal_for_20m_mm=camera.focal_length_m * 1e3 * needed / px_per_bit,
        one_pixel_at_m=focal_px * thesis.bit_m,
        field_of_view_deg=float(2 * np.degrees(np.arctan(thesis.detector_px / 2 / focal_px))),
    )


def _noise(result: ErrataResult) -> Noise:
    model, thesis = printed_model(), PrintedModel()
    equal = thesis.dark_noise_e**2
    signal = result.dataset.signal.sel(model="printed", illumination="eclipse", exposure="1/30 s").values

    def gain(signal_e: float) -> float:
        charge, none = np.array(signal_e), np.array(0.0)
        corrected = NOISE_IN_QUADRATURE(model).merit(charge, none, thesis.dark_noise_e)
        return float(corrected / model.merit(charge, none, thesis.dark_noise_e))

    # Lines 82 and 83 of the listing: foil of 10 sr⁻¹ and 1 m² beside a bit of 200 sr⁻¹, each over the square of its own pixels.
    bit, foil = thesis.bit_m, _LISTING_FOIL_M
    width = np.arctan(foil / 2 / 8.0) / np.arctan(bit / 2 / 8.0)
    return Noise(
        equal_at_e=equal,
        read_noise_dominates_at=_ranges(result.dataset, signal < equal),
        quadrature_factor_20m=gain(float(signal[-1])),
        quadrature_factor_most=gain(equal),
        listing_bit_over_foil_8m=thesis.brdf_sr * bit**4 / (_LISTING_FOIL_SR * foil**4) * float(width) ** 2,
        right_bit_over_foil=thesis.brdf_sr / _LISTING_FOIL_SR,
    )


def _power(result: ErrataResult) -> Power:
    leds = result.scenario.leds
    auto = result.dataset.exposure_s.sel(model="full", illumination="eclipse", exposure="auto")
    printed, longest = (float(leds.energy_per_frame_j(seconds)) for seconds in (1 / 50, float(auto.max())))
    return Power(printed_energy_j=printed, printed_fps=_POWER_W / printed, energy_j=longest, power_10fps_w=10 * longest)


def _tape(result: ErrataResult) -> Tape:
    lobe = next(step.terms["led_brdf"] for step in result.steps if "led_brdf" in step.terms)
    brdf = lobe(PrintedModel(), np.array([1.0, 8.0, 20.0]))
    corrected = link_model("corrected", BEAM_DEG)
    diffuse = replace(corrected, led_brdf=lambda s, r: np.full_like(r, _SPECTRALON / np.pi))
    return Tape(
        material=result.scenario.target.tape_material,
        baseline_m=result.scenario.leds.ring_radius_m,
        brdf_1m_sr=float(brdf[0]),
        brdf_8m_sr=float(brdf[1]),
        brdf_20m_sr=float(brdf[2]),
        spectralon_signal_20m=float(diffuse.signal_e(20.0, 1 / 30, (LED,))),
        spectralon_snr_20m=float(diffuse.snr(20.0, 1 / 30, (LED,))),
    )
