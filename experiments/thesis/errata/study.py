"""The thesis's radiometric analysis in three models side by side: as printed, repaired slip by slip, and in full.

* *printed*: section 6.2 and listing A.5, slips included (`radiometry.thesis`);
* *repaired*: the same assumptions, flat tape of 200 sr⁻¹ and ideal optics, without the slips (`radiometry.corrections`);
* *full*: `chain.link_budget` of the same LEDs, beam, bit and camera with tape lobe, point spread, neighbours and background.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr

from experiments import chain
from experiments.scenario import Scenario, load_scenario
from materials import library
from radiometry import link
from radiometry.corrections import LED, REPAIRS, SUN, Repair, printed_model, repaired, waterfall
from radiometry.extensions import BEAM_OPTICS_EFFICIENCY, Surroundings, completions
from radiometry.geometry import FloatArray
from radiometry.thesis import PrintedModel
from scenes.projection.visible import visible_tape

MODELS = ("printed", "repaired", "full")
#: Sources by illumination. The thesis's sunlit case has its LEDs on; "sun alone" is the frame without them.
LIGHTS: dict[str, tuple[str, ...]] = {"eclipse": (LED,), "sunlit": (LED, SUN), "sun alone": (SUN,)}
#: Label -> full beam angle [deg] and exposure [s] of the thesis's figures 6.3 and 6.4; 'auto' is each model's own.
EXPOSURES: dict[str, tuple[float, float | str]] = {
    "1/30 s": (16.0, 1 / 30),
    "1 ms": (16.0, 1e-3),
    **{f"1/{n} s, 8°": (8.0, 1 / n) for n in (50, 100, 150, 200)},
    "auto": (16.0, "auto"),
}
#: The exposure at which the waterfall of an illumination is taken.
WATERFALL_EXPOSURE = {"eclipse": "1/30 s", "sunlit": "1 ms", "sun alone": "1 ms"}
RANGES_M = tuple(float(r) for r in range(1, 21))


def thesis_scenario(cone_deg: float, range_m: float = 1.0) -> Scenario:
    """The default scenario with the thesis's beam and 5 mm bit; the rest of it is the thesis's already or not in the thesis."""
    scenario = load_scenario()
    beam = repaired(printed_model(PrintedModel(light_cone_deg=cone_deg)), REPAIRS)
    leds = {
        **scenario.leds.model_dump(),
        "count": beam.settings.led_count,
        "intensity_w_sr": BEAM_OPTICS_EFFICIENCY * beam.intensity_w_sr / beam.settings.led_count,
        "half_angle_deg": cone_deg / 2,
    }
    size = scenario.marker.size_m * beam.settings.bit_m / scenario.marker.bit_m
    marker = {**scenario.marker.model_dump(), "size_m": size}
    return scenario.at(range_m=range_m, leds=leds, marker=marker)


@cache
def pattern_fill(range_m: float) -> tuple[float, float]:
    """Share of the light of a bright bit's and of a dark cell's pixels that comes from tape, for the 5 mm bit."""
    scenario = thesis_scenario(16.0, range_m)
    view, marker = chain.view(scenario), scenario.marker
    tape, parts = visible_tape(view)

    def share(centres_m: FloatArray) -> float:
        pixels = [np.column_stack(p[::-1]) for p in chain.bit_pixels(view, centres_m)]
        return float(
            np.mean([link.reflective_fill(p, tape, scenario.camera.psf_sigma_px, parts).mean() for p in pixels])
        )

    return share(marker.white_bit_centres_m()), share(marker.black_bit_centres_m())


def completing_steps(cone_deg: float) -> tuple[Repair, ...]:
    """The steps from the repaired model to the full one's physics."""
    scenario = thesis_scenario(cone_deg)

    def fill(which: int) -> Callable[[FloatArray], FloatArray]:
        return lambda r: np.vectorize(lambda range_m: pattern_fill(float(range_m))[which], otypes=[float])(r)

    target = scenario.target
    surroundings = Surroundings(
        scenario.leds,
        scenario.camera,
        library.load(target.tape_material).brdf,
        library.load(target.absorber_material).brdf,
        float(np.radians(scenario.sun.phase_deg)),
        fill(0),
        fill(1),
    )
    return completions(surroundings)


@cache
def _full_rates(cone_deg: float) -> FloatArray:
    """Signal and background of the full model [e-/s], (2, light, range)."""
    rates = {}
    for illumination in ("eclipse", "sunlit"):
        budgets = [chain.link_budget(thesis_scenario(cone_deg, r), illumination) for r in RANGES_M]
        rates[illumination] = np.array([[b.signal_rate, b.background_rate] for b in budgets]).T
    # Light adds up, so the Sun's share is what remains without the LEDs'.
    return np.stack([rates["eclipse"], rates["sunlit"], rates["sunlit"] - rates["eclipse"]], axis=1)


def _rates(model: str, cone_deg: float) -> FloatArray:
    """Signal and background of a model [e-/s], (2, light, range)."""
    if model == "full":
        return _full_rates(cone_deg)
    link_model = printed_model(PrintedModel(light_cone_deg=cone_deg))
    if model == "repaired":
        link_model = repaired(link_model, REPAIRS)
    ranges = np.array(RANGES_M)
    signal = [link_model.signal_e(ranges, 1.0, sources) for sources in LIGHTS.values()]
    return np.stack([np.stack(signal), np.zeros((len(LIGHTS), len(ranges)))])


def models_dataset() -> xr.Dataset:
    """Charges, SNR, CNR and well filling of the three models over range, illumination and exposure."""
    scenario = thesis_scenario(16.0)
    auto, sensor, ranges = scenario.auto_exposure, scenario.sensor, np.array(RANGES_M)
    well, noise = chain.usable_well_electrons(sensor), sensor.total_noise_electrons
    shape = (len(MODELS), len(LIGHTS), len(EXPOSURES), len(RANGES_M))
    signal, background, seconds = np.empty(shape), np.empty(shape), np.empty(shape)
    for m, model in enumerate(MODELS):
        for e, (cone_deg, exposure) in enumerate(EXPOSURES.values()):
            rates = _rates(model, cone_deg)
            if isinstance(exposure, str):
                time = np.clip(auto.full_well_fraction * well / rates[0], auto.shortest_s, auto.longest_s)
            else:
                time = np.full(rates[0].shape, exposure)
            signal[m, :, e], background[m, :, e], seconds[m, :, e] = rates[0] * time, rates[1] * time, time
    snr, cnr = link.snr(signal, 0.0, noise), link.cnr(signal, background, 0.0, noise)
    snr[0], cnr[:2] = signal[0] / PrintedModel().noise_e(signal[0]), np.nan
    speed = scenario.target.tumble_speed_m_s
    variables = {
        "exposure_s": (seconds, "s", "exposure"),
        "signal": (signal, "electron", "mean charge of a bright bit's pixels, were there no full well"),
        "background": (background, "electron", "mean charge of the absorbing cells' pixels, were there no full well"),
        "snr": (snr, "1", "signal-to-noise ratio, noise as the model defines it"),
        "cnr": (cnr, "1", "contrast-to-noise ratio; only the full model has a background"),
        "full_well_fraction": (signal / well, "1", "bright bit over full well"),
        "smear_px": (link.smear_px(scenario.camera, ranges, speed, seconds), "pixel", "motion during the exposure"),
    }
    dims = ("model", "illumination", "exposure", "range_m")
    bit_px = min(chain.bit_scale_px(chain.view(scenario))) * scenario.marker.bit_m * scenario.range_m / ranges
    return xr.Dataset(
        {name: (dims, values, {"units": unit, "long_name": text}) for name, (values, unit, text) in variables.items()},
        coords={
            "model": list(MODELS),
            "illumination": list(LIGHTS),
            "exposure": list(EXPOSURES),
            "beam_deg": ("exposure", [c for c, _ in EXPOSURES.values()], {"units": "degree", "long_name": "beam"}),
            "range_m": ("range_m", ranges, {"units": "m", "long_name": "range"}),
            "px_per_bit": ("range_m", bit_px, {"units": "pixel", "long_name": "pixels along a 5 mm bit"}),
        },
    )


def waterfall_dataset(models: xr.Dataset) -> xr.Dataset:
    """Signal and SNR after each step from the printed to the full model, over illumination and range."""
    ranges, cone_deg = np.array(RANGES_M), EXPOSURES["1/30 s"][0]
    steps, start = (*REPAIRS, *completing_steps(cone_deg)), printed_model(PrintedModel(light_cone_deg=cone_deg))
    signal, snr = (np.empty((len(steps) + 2, len(LIGHTS), len(ranges))) for _ in range(2))
    for n, (illumination, sources) in enumerate(LIGHTS.items()):
        case = models.sel(illumination=illumination, exposure=WATERFALL_EXPOSURE[illumination])
        seconds = float(EXPOSURES[WATERFALL_EXPOSURE[illumination]][1])
        made = waterfall(start, steps, ranges, seconds, sources)
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


def compute() -> xr.Dataset:
    """All of the study as one labelled dataset."""
    models = models_dataset()
    attributes = {"Conventions": "CF-1.11", "title": "The thesis's link budget as printed, repaired, and in full"}
    dataset = xr.merge([models, waterfall_dataset(models)], combine_attrs="drop", join="outer")
    return dataset.assign_attrs(**attributes, **chain.provenance(thesis_scenario(16.0)))


def run(out_dir: Path | None = None) -> xr.Dataset:
    """The three models, and where a folder is given its files: thesis-errata.md, figures/errata_*.svg, data/errata.nc and .csv.

    The folder is laid out as docs/, so that ``mantis errata -o docs`` makes the committed page again. Nothing is random.
    """
    dataset = compute()
    if out_dir is not None:
        from experiments.reporting.figures import save_svg
        from experiments.reporting.files import write_netcdf, write_text
        from experiments.thesis.errata import figures as errata_figures
        from experiments.thesis.errata import page as errata_page

        for folder in ("figures", "data"):
            (out_dir / folder).mkdir(parents=True, exist_ok=True)
        for name, figure in errata_figures.figures(dataset).items():
            save_svg(figure, out_dir / "figures" / f"errata_{name}.svg")
        write_netcdf(dataset, out_dir / "data" / "errata.nc")
        write_text(steps_csv(dataset), out_dir / "data" / "errata.csv")
        write_text(errata_page.page(dataset), out_dir / "thesis-errata.md")
    return dataset


def steps_csv(dataset: xr.Dataset, ranges_m: tuple[float, ...] = (1.0, 8.0, 20.0)) -> str:
    """The waterfall as CSV, one step, illumination and range a line, at some ranges."""
    lines = ["step,light,range_m,signal_e,snr,signal_factor,snr_factor"]
    for illumination in dataset.illumination.values:
        for range_m in ranges_m:
            for step in dataset.step.values:
                at = dataset.sel(step=step, illumination=illumination, range_m=range_m)
                values = (at.step_signal, at.step_snr, at.signal_factor, at.snr_factor)
                lines.append(
                    ",".join([f'"{step}"', str(illumination), f"{range_m:g}", *(f"{float(v):.6g}" for v in values)])
                )
    return "\n".join(lines) + "\n"


def full_pixel_snr() -> float:
    """The best SNR that one exposure can have: that of a full well."""
    sensor = thesis_scenario(EXPOSURES["1/30 s"][0]).sensor
    return float(link.snr(chain.usable_well_electrons(sensor), 0.0, sensor.total_noise_electrons))


def limit_margins(dataset: xr.Dataset) -> dict[str, FloatArray]:
    """Factor by which the full model in eclipse meets each closure criterion over range; below 1 it fails."""
    limits = thesis_scenario(EXPOSURES["1/30 s"][0]).requirement
    full = dataset.sel(model="full", illumination="eclipse")
    filling = {e: full.sel(exposure=e).full_well_fraction.values for e in ("1/30 s", "1 ms", "auto")}
    return {
        "sampling, 2 px/bit": dataset.px_per_bit.values / limits.px_per_bit_min,
        "CNR 10, automatic exposure": full.sel(exposure="auto").cnr.values / limits.cnr_min,
        "0.7 full well, automatic": limits.full_well_fraction_max / filling["auto"],
        "0.7 full well, 1 ms": limits.full_well_fraction_max / filling["1 ms"],
        "0.7 full well, 1/30 s": limits.full_well_fraction_max / filling["1/30 s"],
    }
