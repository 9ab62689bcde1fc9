"""The numbers behind docs/thesis-errata.md, and the page itself from its template."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.resources import files
from textwrap import fill
from typing import Any

import jinja2
import numpy as np
import xarray as xr
from rich.box import SIMPLE_HEAD
from rich.table import Table

from experiments.reporting.formatting import ranges_text, seconds_text
from experiments.thesis.errata.study import completing_steps, full_pixel_snr, thesis_scenario
from radiometry.corrections import (
    CORRECTIONS,
    LED,
    NOISE_IN_QUADRATURE,
    beam_power_w,
    corrected,
    printed_model,
    solar_band_w_m2,
)
from radiometry.sources import LedRing
from radiometry.thesis import PrintedModel

#: Reflectance of a Spectralon panel at 850 nm (Labsphere, 0.975–0.995 over 750–1600 nm).
_SPECTRALON = 0.99
#: BRDF that the listing gives the foil around the marker (line 39) [sr⁻¹].
_LISTING_FOIL_SR = 10.0
#: Power that the thesis allows the LEDs (below equation 6.10) [W].
_POWER_W = 5.0
_WRAP: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
_SHOWN_RANGES_M = (1.0, 8.0, 20.0)


def facts(dataset: xr.Dataset) -> dict[str, Any]:
    """Every number of the page by topic; what `mantis errata --json` prints."""
    return {
        "beam": _beam(),
        "eclipse": _eclipse(dataset),
        "sun": _sun(dataset),
        "sampling": _sampling(dataset),
        "noise": _noise(dataset),
        "power": _power(dataset),
        "tape": _tape(dataset),
        "agreement_percent": 100 * _agreement(dataset),
        "full_pixel_snr": full_pixel_snr(),
    }


def _agreement(dataset: xr.Dataset) -> float:
    """Largest relative difference in signal between the last step's closed form on the axis and the full model."""
    return float(np.abs(dataset.signal_factor.isel(step=-1) - 1).max())


def _beam() -> dict[str, Any]:
    result: dict[str, Any] = {"as_bought_w_sr": PrintedModel().led_count * PrintedModel().led_intensity_w_sr}
    for cone in (16, 8):
        model = printed_model(PrintedModel(light_cone_deg=cone))
        result[f"printed_{cone}deg_w_sr"] = model.intensity_w_sr
        result[f"right_{cone}deg_w_sr"] = corrected(model, CORRECTIONS).intensity_w_sr
    electrical = thesis_scenario(16.0).leds.electrical_power_w * PrintedModel().led_count
    illumination = beam_power_w(result["printed_16deg_w_sr"], 16.0)
    emitted = beam_power_w(result["as_bought_w_sr"], PrintedModel().led_full_angle_deg)
    result |= {"printed_power_w": illumination, "electrical_power_w": electrical, "emitted_power_w": emitted}
    result |= {"printed_over_electrical": illumination / electrical, "printed_over_emitted": illumination / emitted}
    try:
        LedRing(intensity_w_sr=result["printed_16deg_w_sr"] / PrintedModel().led_count, half_angle_deg=8.0)
    except ValueError as refusal:
        result["refusal"] = str(refusal).split("Value error, ")[-1].split(" [type")[0]
    return result


def _at(dataset: xr.Dataset, variable: str, **where: Any) -> float:
    return float(dataset[variable].sel(**where))


def _ranges(dataset: xr.Dataset, chosen: Any) -> str:
    grid = [float(r) for r in dataset.range_m.values]
    return ranges_text(grid, [r for r, c in zip(grid, np.asarray(chosen), strict=True) if c])


def _eclipse(dataset: xr.Dataset) -> dict[str, Any]:
    here = dataset.sel(illumination="eclipse")
    printed, full, auto = here.sel(model="printed"), here.sel(model="full"), here.sel(model="full", exposure="auto")
    result: dict[str, Any] = {
        f"printed_snr_{r}m": _at(printed, "snr", exposure="1/30 s", range_m=r) for r in (6, 7, 8, 9)
    }
    result["printed_snr_20m_fig64"] = _at(printed, "snr", exposure="1/50 s, 8°", range_m=20)
    for model in ("repaired", "full"):
        for r in (8, 20):
            signal = _at(here, "signal", model=model, exposure="1/30 s", range_m=r)
            result[f"{model}_signal_{r}m"] = signal
            result[f"{model}_over_printed_{r}m"] = signal / _at(printed, "signal", exposure="1/30 s", range_m=r)
    filling = full.full_well_fraction.sel(exposure="1/30 s")
    limit = thesis_scenario(16.0).requirement.cnr_min
    result["shape_change"] = result["repaired_over_printed_8m"] / result["repaired_over_printed_20m"]
    return result | {
        "full_over_well_least": float(filling.min()),
        "full_over_well_most": float(filling.max()),
        "fig64_shortest_over_well_least": float(full.full_well_fraction.sel(exposure="1/200 s, 8°").min()),
        "auto_least_s": float(auto.exposure_s.min()),
        "auto_most_s": float(auto.exposure_s.max()),
        "auto_cnr_most": float(auto.cnr.max()),
        "auto_cnr_least": float(auto.cnr.min()),
        "auto_cnr_least_at_m": float(auto.range_m.values[auto.cnr.values.argmin()]),
        "auto_cnr_fails_at": _ranges(dataset, auto.cnr.values < limit),
        "one_led_20m_s": _at(auto, "exposure_s", range_m=20) * PrintedModel().led_count,
    }


def _sun(dataset: xr.Dataset) -> dict[str, Any]:
    here = dataset.sel(exposure="1 ms")
    printed, full = here.sel(model="printed", illumination="sunlit"), here.sel(model="full")
    result: dict[str, Any] = {"band_w_m2": solar_band_w_m2(), "printed_snr_8m": _at(printed, "snr", range_m=8)}
    for r in (8, 20):
        for illumination, key in (("sun alone", "alone"), ("sunlit", "with_leds")):
            for model in ("repaired", "full"):
                signal = _at(here, "signal", model=model, illumination=illumination, range_m=r)
                result[f"{model}_{key}_over_printed_{r}m"] = signal / _at(printed, "signal", range_m=r)
    alone, both = full.sel(illumination="sun alone"), full.sel(illumination="sunlit")
    auto = dataset.sel(model="full", illumination="sunlit", exposure="auto")
    led_share = full.signal.sel(illumination="eclipse") / alone.signal
    limits = thesis_scenario(16.0).requirement
    return result | {
        "alone_over_well_least": float(alone.full_well_fraction.min()),
        "alone_over_well_most": float(alone.full_well_fraction.max()),
        "alone_saturates_at": _ranges(dataset, alone.full_well_fraction.values > limits.full_well_fraction_max),
        "with_leds_over_well_least": float(both.full_well_fraction.min()),
        "with_leds_over_well_most": float(both.full_well_fraction.max()),
        "auto_least_s": float(auto.exposure_s.min()),
        "auto_most_s": float(auto.exposure_s.max()),
        "auto_cnr_least": float(auto.cnr.min()),
        "auto_cnr_most": float(auto.cnr.max()),
        "auto_cnr_fails_at": _ranges(dataset, auto.cnr.values < limits.cnr_min),
        "leds_over_sun_least": float(led_share.min()),
        "leds_over_sun_most": float(led_share.max()),
    }


def _sampling(dataset: xr.Dataset) -> dict[str, Any]:
    s, camera = PrintedModel(), thesis_scenario(16.0).camera
    focal_px, needed = min(camera.focal_px), thesis_scenario(16.0).requirement.px_per_bit_min
    px_per_bit = float(dataset.px_per_bit.sel(range_m=20))
    return {
        "px_per_bit_20m": px_per_bit,
        "needed_px": needed,
        "ends_m": focal_px * s.bit_m / needed,
        "ends_10mm_m": focal_px * 0.010 / needed,
        "bit_for_20m_mm": needed * 20.0 / focal_px * 1e3,
        "focal_for_20m_mm": camera.focal_length_m * 1e3 * needed / px_per_bit,
        "one_pixel_at_m": focal_px * s.bit_m,
        "field_of_view_deg": float(2 * np.degrees(np.arctan(s.detector_px / 2 / focal_px))),
    }


def _noise(dataset: xr.Dataset) -> dict[str, Any]:
    model, s = printed_model(), PrintedModel()
    equal = s.dark_noise_e**2
    signal = dataset.signal.sel(model="printed", illumination="eclipse", exposure="1/30 s").values

    def gain(signal_e: float) -> float:
        charge, none = np.array(signal_e), np.array(0.0)
        return float(
            NOISE_IN_QUADRATURE(model).merit(charge, none, s.dark_noise_e) / model.merit(charge, none, s.dark_noise_e)
        )

    # Lines 82 and 83 of the listing: foil of 10 sr⁻¹ and 1 m² beside a bit of 200 sr⁻¹, each over the square of its own pixels.
    bit, foil = s.bit_m, 1.0
    width = np.arctan(foil / 2 / 8.0) / np.arctan(bit / 2 / 8.0)
    return {
        "equal_at_e": equal,
        "read_noise_dominates_at": _ranges(dataset, signal < equal),
        "quadrature_factor_20m": gain(float(signal[-1])),
        "quadrature_factor_most": gain(equal),
        "listing_bit_over_foil_8m": s.brdf_sr * bit**4 / (_LISTING_FOIL_SR * foil**4) * float(width) ** 2,
        "right_bit_over_foil": s.brdf_sr / _LISTING_FOIL_SR,
    }


def _power(dataset: xr.Dataset) -> dict[str, Any]:
    leds, auto = thesis_scenario(16.0).leds, dataset.sel(model="full", illumination="eclipse", exposure="auto")
    printed = float(leds.energy_per_frame_j(1 / 50))
    longest = float(leds.energy_per_frame_j(float(auto.exposure_s.max())))
    return {
        "printed_energy_j": printed,
        "printed_fps": _POWER_W / printed,
        "energy_j": longest,
        "power_10fps_w": 10 * longest,
    }


def _tape(dataset: xr.Dataset) -> dict[str, Any]:
    scenario = thesis_scenario(16.0)
    lobe = next(r for r in completing_steps(16.0) if "led_brdf" in r.terms).terms["led_brdf"]
    brdf = lobe(PrintedModel(), dataset.range_m.values)
    diffuse = replace(
        corrected(printed_model(), CORRECTIONS), led_brdf=lambda s, r: np.full_like(r, _SPECTRALON / np.pi)
    )
    return {
        "material": scenario.target.tape_material,
        "baseline_m": scenario.leds.ring_radius_m,
        "brdf_1m_sr": float(brdf[0]),
        "brdf_8m_sr": float(brdf[7]),
        "brdf_20m_sr": float(brdf[-1]),
        "spectralon_signal_20m": float(diffuse.signal_e(20.0, 1 / 30, (LED,))),
        "spectralon_snr_20m": float(diffuse.snr(20.0, 1 / 30, (LED,))),
    }


def digits(value: float) -> str:
    """Three significant digits: '0.0193', '91.5', '17 500', '3.47×10⁶'."""
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        rounded = float(f"{value:.3g}")
        text = f"{rounded:.{max(0, 2 - int(np.floor(np.log10(abs(rounded)))))}f}" if rounded else "0"
        return text if rounded < 1e4 else f"{int(rounded):,}".replace(",", "\N{NO-BREAK SPACE}")
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}×10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def _whole(value: float) -> str:
    return f"{value:.0f}" if abs(value) < 1e4 else f"{value:,.0f}".replace(",", "\N{NO-BREAK SPACE}")


def _factor(value: float) -> str:
    if value == 1 or abs(value - 1) < 5e-5:
        return "1"
    return f"{value:.4f}" if abs(value - 1) < 0.1 else digits(value)


def waterfall_rows(dataset: xr.Dataset) -> list[tuple[str, ...]]:
    """Header, then one row a step: factors on signal and SNR in eclipse (1/30 s) and of the Sun alone (1 ms)."""
    cases = [("eclipse", 8.0), ("eclipse", 20.0), ("sun alone", 8.0), ("sun alone", 20.0)]
    rows = [("step", *(f"{illumination}, {r:g} m: {q}" for illumination, r in cases for q in ("S", "SNR")))]
    values = [dataset.sel(illumination=illumination, range_m=r) for illumination, r in cases]

    def line(name: str, *pairs: tuple[str, str]) -> tuple[str, ...]:
        return (name, *(text for pair in pairs for text in pair))

    def state(k: int) -> list[tuple[str, str]]:
        return [(digits(float(v.step_signal[k])), digits(float(v.step_snr[k]))) for v in values]

    rows.append(line("**as printed**", *state(0)))
    for k, step in enumerate(dataset.step.values[1:-1], 1):
        rows.append(
            line(
                str(step),
                *(("×" + _factor(float(v.signal_factor[k])), "×" + _factor(float(v.snr_factor[k]))) for v in values),
            )
        )
        if k == len(CORRECTIONS):
            rows.append(line("**repaired**", *state(k)))
    rows.append(line("**full model**", *state(-1)))
    return rows


def repair_rows() -> list[tuple[str, ...]]:
    """Header, then one row a step: what the thesis prints, what is right, and the source."""
    return [
        ("step", "where", "printed", "right", "source"),
        *((r.name, r.where, r.printed, r.right, r.source) for r in (*CORRECTIONS, *completing_steps(16.0))),
    ]


def model_rows(dataset: xr.Dataset) -> list[tuple[str, ...]]:
    """Header, then one row a case and range: signal [e⁻] and SNR of the three models, CNR and well filling of the full one."""
    heads = (
        "S printed",
        "S repaired",
        "S full",
        "SNR printed",
        "SNR repaired",
        "SNR full",
        "CNR full",
        "S full/well",
    )
    rows: list[tuple[str, ...]] = [("illumination", "exposure", "range", *heads)]
    for illumination, exposure in (
        ("eclipse", "1/30 s"), ("eclipse", "1/50 s, 8°"), ("eclipse", "1/200 s, 8°"), ("eclipse", "auto"),
        ("sunlit", "1 ms"), ("sunlit", "auto"), ("sun alone", "1 ms"),
    ):  # fmt: skip
        for range_m in _SHOWN_RANGES_M:
            at = dataset.sel(illumination=illumination, exposure=exposure, range_m=range_m)
            full = at.sel(model="full")
            label = f"auto, {seconds_text(float(full.exposure_s))}" if exposure == "auto" else exposure
            numbers = [*at.signal.values, *at.snr.values, full.cnr, full.full_well_fraction]
            rows.append((illumination, label, f"{range_m:g} m", *(digits(float(v)) for v in numbers)))
    return rows


def tables(dataset: xr.Dataset) -> list[Table]:
    """The page's waterfall and models for the terminal."""
    result = []
    for title, rows in (
        ("From the printed to the full model", waterfall_rows(dataset)),
        ("Three models", model_rows(dataset)),
    ):
        table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for heading in rows[0]:
            text = heading in ("step", "illumination", "exposure")
            table.add_column(
                re.sub(", |: |(?<=^S) |(?<=NR) ", "\n", heading),
                justify="left" if text else "right",
                no_wrap=True,
            )
        for row in rows[1:]:
            table.add_row(*(text.strip("*") for text in row))
        result.append(table)
    return result


def _markdown(rows: list[tuple[str, ...]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def page(dataset: xr.Dataset) -> str:
    """docs/thesis-errata.md."""
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True)
    environment.filters.update(n=digits, t=seconds_text, whole=_whole)
    template = (files("experiments") / "thesis" / "errata" / "page.md").read_text(encoding="utf-8")
    parts = {
        "waterfall": _markdown(waterfall_rows(dataset)),
        "repairs": _markdown(repair_rows()),
        "models": _markdown(model_rows(dataset)),
    }
    text = environment.from_string(template).render(facts(dataset), tables=parts)
    # Numbers change the length of lines; paragraphs are filled anew.
    blocks = [
        b if b.startswith(("#", "|", "`", "-", "!")) else fill(b, 130, **_WRAP) for b in text.strip().split("\n\n")
    ]
    return "\n\n".join(blocks) + "\n"
