"""The thesis's radiometric analysis in three models side by side: as printed, with its errors corrected, and in full.

* *printed*: section 6.2 and listing A.5, errors included (`radiometry.thesis`);
* *corrected*: the same assumptions, flat tape of 200 sr⁻¹ and ideal optics, without the errors (`radiometry.corrections`);
* *full*: `chain.link_budget` of the same LEDs, beam, bit and camera with tape lobe, point spread, neighbours and background.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario, load_scenario
from experiments.thesis.errata.plan import BEAM_DEG, FULL, Plan
from materials import library
from radiometry import link
from radiometry.corrections import CORRECTIONS, LED, SUN, Correction, LinkModel, corrected, printed_model, waterfall
from radiometry.extensions import BEAM_OPTICS_EFFICIENCY, Surroundings, extensions
from radiometry.geometry import FloatArray
from radiometry.thesis import PrintedModel
from scenes.projection.visible import visible_tape

MODELS = ("printed", "corrected", "full")
#: Sources by illumination. The thesis's sunlit case has its LEDs on; "sun alone" is the frame without them.
SOURCES: dict[str, tuple[str, ...]] = {"eclipse": (LED,), "sunlit": (LED, SUN), "sun alone": (SUN,)}


@dataclass(frozen=True)
class ErrataResult:
    """The three models and the steps between them.

    Attributes:
        scenario: the thesis's system, see `load`.
        plan: what was walked through.
        dataset: charges, SNR, CNR and well filling by (model, illumination, exposure, range_m), and signal and SNR after each
            step by (step, illumination, range_m).
        steps: corrections, then extensions, in the order in which they are made.
    """

    scenario: Scenario
    plan: Plan
    dataset: xr.Dataset
    steps: tuple[Correction, ...]


def load(overrides: tuple[str, ...] = (), seed: int | None = None) -> Scenario:
    """The thesis's system: the default scenario with the thesis's bit of 5 mm and its beam of 16°.

    The rest of the default scenario is the thesis's already, or is not in the thesis.
    """
    scenario = load_scenario(None, overrides if seed is None else (*overrides, f"seed={seed}"))
    size = scenario.marker.size_m * PrintedModel().bit_m / scenario.marker.bit_m
    marker = {**scenario.marker.model_dump(), "size_m": size}
    return _with_beam(scenario.at(range_m=1.0, marker=marker), BEAM_DEG)


def _with_beam(scenario: Scenario, beam_deg: float) -> Scenario:
    """The scenario with the thesis's LEDs narrowed to a beam of this full angle."""
    beam = corrected(printed_model(PrintedModel(light_cone_deg=beam_deg)), CORRECTIONS)
    leds = {
        **scenario.leds.model_dump(),
        "count": beam.settings.led_count,
        "intensity_w_sr": BEAM_OPTICS_EFFICIENCY * beam.intensity_w_sr / beam.settings.led_count,
        "half_angle_deg": beam_deg / 2,
    }
    return scenario.at(leds=leds)


def run(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> ErrataResult:
    """Compute the three models over range, and every step between them. Nothing is random."""
    steps = (*CORRECTIONS, *extension_steps(scenario))
    models = _models(scenario, plan)
    dataset = xr.merge([models, _steps(models, steps, plan)], combine_attrs="drop", join="outer")
    attributes = {"Conventions": "CF-1.11", "title": "The thesis's link budget as printed, corrected, and in full"}
    return ErrataResult(scenario, plan, dataset.assign_attrs(**attributes, **chain.provenance(scenario)), steps)


def extension_steps(scenario: Scenario) -> tuple[Correction, ...]:
    """The steps from the corrected model to the full one's physics."""

    @cache
    def pattern_fill(range_m: float) -> tuple[float, float]:
        return _pattern_fill(scenario.at(range_m=range_m))

    def fill(which: int) -> Callable[[FloatArray], FloatArray]:
        return lambda r: np.vectorize(lambda range_m: pattern_fill(float(range_m))[which], otypes=[float])(r)

    target = scenario.target
    return extensions(
        Surroundings(
            ring=scenario.leds,
            camera=scenario.camera,
            tape=library.load(target.tape_material).brdf,
            absorber=library.load(target.absorber_material).brdf,
            sun_phase_rad=float(np.radians(scenario.sun.phase_deg)),
            bright_fill=fill(0),
            dark_fill=fill(1),
        )
    )


def _pattern_fill(scenario: Scenario) -> tuple[float, float]:
    """Share of the light of a bright bit's and of a dark cell's pixels that comes from tape."""
    view, marker = chain.view(scenario), scenario.marker
    tape, parts = visible_tape(view)

    def share(centres_m: FloatArray) -> float:
        pixels = [np.column_stack(p[::-1]) for p in chain.bit_pixels(view, centres_m)]
        return float(
            np.mean([link.reflective_fill(p, tape, scenario.camera.psf_sigma_px, parts).mean() for p in pixels])
        )

    return share(marker.white_bit_centres_m()), share(marker.black_bit_centres_m())


def link_model(model: str, beam_deg: float) -> LinkModel:
    """The printed or the corrected model with a beam of this full angle."""
    printed = printed_model(PrintedModel(light_cone_deg=beam_deg))
    return printed if model == "printed" else corrected(printed, CORRECTIONS)


def _full_rates(scenario: Scenario, beam_deg: float, ranges_m: tuple[float, ...]) -> FloatArray:
    """Signal and background of the full model [e-/s], (2, illumination, range)."""
    beam, rates = _with_beam(scenario, beam_deg), {}
    for illumination in ("eclipse", "sunlit"):
        budgets = [chain.link_budget(beam.at(range_m=r), illumination) for r in ranges_m]
        rates[illumination] = np.array([[b.signal_rate, b.background_rate] for b in budgets]).T
    # Light adds up, so the Sun's share is what remains without the LEDs'.
    return np.stack([rates["eclipse"], rates["sunlit"], rates["sunlit"] - rates["eclipse"]], axis=1)


def _thesis_rates(model: str, beam_deg: float, ranges_m: tuple[float, ...]) -> FloatArray:
    """The same of the printed or the corrected model, which have no background."""
    chosen, ranges = link_model(model, beam_deg), np.array(ranges_m)
    signal = np.stack([chosen.signal_e(ranges, 1.0, sources) for sources in SOURCES.values()])
    return np.stack([signal, np.zeros_like(signal)])


def _models(scenario: Scenario, plan: Plan) -> xr.Dataset:
    """Charges, SNR, CNR and well filling of the three models over range, illumination and exposure."""
    auto, sensor, ranges = scenario.auto_exposure, scenario.sensor, np.array(plan.ranges_m)
    well, noise = chain.usable_well_electrons(sensor), sensor.total_noise_electrons
    shape = (len(MODELS), len(SOURCES), len(plan.exposures), len(ranges))
    signal, background, seconds = np.empty(shape), np.empty(shape), np.empty(shape)
    beams = {beam for beam, _ in plan.exposures.values()}
    rates = {(model, beam): _thesis_rates(model, beam, plan.ranges_m) for model in MODELS[:2] for beam in beams}
    rates |= {("full", beam): _full_rates(scenario, beam, plan.ranges_m) for beam in beams}
    for m, model in enumerate(MODELS):
        for e, (beam, exposure) in enumerate(plan.exposures.values()):
            bright, dark = rates[model, beam]
            if isinstance(exposure, str):
                time = np.clip(auto.full_well_fraction * well / bright, auto.shortest_s, auto.longest_s)
            else:
                time = np.full(bright.shape, exposure)
            signal[m, :, e], background[m, :, e], seconds[m, :, e] = bright * time, dark * time, time
    snr, cnr = link.snr(signal, 0.0, noise), link.cnr(signal, background, 0.0, noise)
    snr[0], cnr[:2] = signal[0] / PrintedModel().noise_e(signal[0]), np.nan
    smear = link.smear_px(scenario.camera, ranges, scenario.target.tumble_speed_m_s, seconds)
    variables = {
        "exposure_s": (seconds, "s", "exposure"),
        "signal": (signal, "electron", "mean charge of a bright bit's pixels, were there no full well"),
        "background": (background, "electron", "mean charge of the absorbing cells' pixels, were there no full well"),
        "snr": (snr, "1", "signal-to-noise ratio, noise as the model defines it"),
        "cnr": (cnr, "1", "contrast-to-noise ratio; only the full model has a background"),
        "full_well_fraction": (signal / well, "1", "bright bit over full well"),
        "smear_px": (smear, "pixel", "motion during the exposure"),
    }
    dims = ("model", "illumination", "exposure", "range_m")
    bit_px = min(chain.bit_scale_px(chain.view(scenario))) * scenario.marker.bit_m * scenario.range_m / ranges
    beam_about = {"units": "degree", "long_name": "beam"}
    return xr.Dataset(
        {name: (dims, values, {"units": unit, "long_name": text}) for name, (values, unit, text) in variables.items()},
        coords={
            "model": list(MODELS),
            "illumination": list(SOURCES),
            "exposure": list(plan.exposures),
            "beam_deg": ("exposure", [beam for beam, _ in plan.exposures.values()], beam_about),
            "range_m": ("range_m", ranges, {"units": "m", "long_name": "range"}),
            "px_per_bit": ("range_m", bit_px, {"units": "pixel", "long_name": "pixels along a 5 mm bit"}),
        },
    )


def _steps(models: xr.Dataset, steps: tuple[Correction, ...], plan: Plan) -> xr.Dataset:
    """Signal and SNR after each step from the printed to the full model, over illumination and range."""
    ranges, start = np.array(plan.ranges_m), link_model("printed", BEAM_DEG)
    signal, snr = (np.empty((len(steps) + 2, len(SOURCES), len(ranges))) for _ in range(2))
    for n, (illumination, sources) in enumerate(SOURCES.items()):
        label = plan.step_exposure[illumination]
        case = models.sel(illumination=illumination, exposure=label)
        made = waterfall(start, steps, ranges, float(plan.exposures[label][1]), sources)
        full, printed = case.sel(model="full"), case.sel(model="printed")
        signal[:, n] = [printed.signal.values, *(step.signal_e for step in made), full.signal.values]
        snr[:, n] = [printed.snr.values, *(step.snr for step in made), full.cnr.values]
    dims, names = ("step", "illumination", "range_m"), ["as printed", *(step.name for step in steps), "full model"]
    one = np.ones((1, *signal.shape[1:]))
    variables = {
        "step_signal": (signal, "electron", "mean charge of a bright bit's pixel after the step"),
        "step_snr": (snr, "1", "signal-to-noise ratio after the step, contrast-to-noise ratio from the background on"),
        "signal_factor": (np.concatenate([one, signal[1:] / signal[:-1]]), "1", "factor of the step on the signal"),
        "snr_factor": (np.concatenate([one, snr[1:] / snr[:-1]]), "1", "factor of the step on the SNR"),
    }
    return xr.Dataset(
        {name: (dims, values, {"units": unit, "long_name": text}) for name, (values, unit, text) in variables.items()},
        coords={"step": names},
    )


def full_pixel_snr(scenario: Scenario) -> float:
    """The best SNR that one exposure can have: that of a full well."""
    sensor = scenario.sensor
    return float(link.snr(chain.usable_well_electrons(sensor), 0.0, sensor.total_noise_electrons))


def limit_margins(result: ErrataResult) -> dict[str, FloatArray]:
    """Factor by which the full model in eclipse meets each closure criterion over range; below 1 it fails."""
    limits = result.scenario.requirement
    full = result.dataset.sel(model="full", illumination="eclipse")
    filling = {e: full.sel(exposure=e).full_well_fraction.values for e in ("1/30 s", "1 ms", "auto")}
    return {
        "sampling, 2 px/bit": full.px_per_bit.values / limits.px_per_bit_min,
        "CNR 10, automatic exposure": full.sel(exposure="auto").cnr.values / limits.cnr_min,
        "0.7 full well, automatic": limits.full_well_fraction_max / filling["auto"],
        "0.7 full well, 1 ms": limits.full_well_fraction_max / filling["1 ms"],
        "0.7 full well, 1/30 s": limits.full_well_fraction_max / filling["1/30 s"],
    }
