"""The report of `mantis errata`: the thesis's conclusions beside what is true, and the three models with every step "
"between."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import xarray as xr

from experiments.reporting.blocks import Block, Bullets, Card, Download, Figures, Section, Text, text_table
from experiments.reporting.formatting import number, seconds_text
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import assumptions, footer, reproduction
from experiments.thesis.errata import figures as errata_figures
from experiments.thesis.errata import page
from experiments.thesis.errata.study import steps_csv, thesis_scenario

CAPTIONS = {
    "eclipse": "SNR over range in eclipse: printed, repaired and full; open markers where the pixel overflows.",
    "sun": "SNR over range in sunlight at 1 ms, with the LEDs on and without.",
    "waterfall_eclipse": "Signal and SNR at 8 m in eclipse, from the printed to the full model.",
    "waterfall_sun": "Signal and SNR at 8 m of the Sun alone, from the printed to the full model.",
    "limit": "Pixels per bit over range, and the margin of each criterion of the full model in eclipse.",
}
LIMITS = (
    "The reflectance of tape away from its lobe (0.10 sr⁻¹ repaired, from the material in full), the loss of the beam optics "
    "(0.8), the baseline of the LEDs, the full well and the coating of the dark cells: assumptions, the thesis gives none "
    "of them.",
    "Table values of the tape come from standards for road signs and hold for visible light.",
    "Below a pixel a bit the contrast depends on how the pattern falls on the pixels; here the marker stands centred and "
    "square.",
    "Foil, Earth light and stray light are left out.",
    "The camera of all three models is the thesis's mixture: geometry of the VBS camera, quantum efficiency and read noise "
    "of the GT4096 NIR.",
)


def html(dataset: xr.Dataset, command: str) -> str:
    """The report as one HTML text that loads nothing from elsewhere.

    Args:
        dataset: of `study.run`.
        command: the command line that made it.
    """
    facts, scenario = page.facts(dataset), thesis_scenario(16.0)
    plots = errata_figures.figures(dataset)
    steps = [tuple(text.strip("*") for text in row) for row in page.waterfall_rows(dataset)]

    def picture(name: str) -> Block:
        return Figures((figure(plots[name], name, CAPTIONS[name]),), CAPTIONS[name])

    evidence = (
        Section("eclipse", "Eclipse", (picture("eclipse"),)),
        Section("sun", "Sunlight", (picture("sun"),)),
        Section("limit", "The real limit at 20 m", (picture("limit"),)),
        Section(
            "steps",
            "From the printed to the full model, step by step",
            (
                Text(
                    (
                        "Each factor is the model after the step over the model before it; from ‘background’ on SNR is the "
                        "CNR. The last step and the full model are two computations of the same physics and agree to "
                        f"{facts['agreement_percent']:.2g} %.",
                    )
                ),
                picture("waterfall_eclipse"),
                picture("waterfall_sun"),
                text_table(steps, "Step by step", compact=True),
                Download("Save steps at 1, 8 and 20 m as CSV", "mantis-errata-steps.csv", steps_csv(dataset)),
            ),
        ),
        Section("repairs", "What each step repairs", (text_table(page.repair_rows(), "Each step"),), wordy=True),
        Section("models", "Three models", (text_table(page.model_rows(dataset), "Case by case", compact=True),)),
    )
    return render(
        Report(
            "The thesis's link budget as printed, repaired slip by slip, and in full",
            "Mantis errata",
            _headline(facts),
            None,
            tuple(_cards(facts)),
            (),
            evidence,
            (Bullets(LIMITS), *assumptions(scenario)),
            tuple(reproduction(scenario, dataset.attrs, command)),
            footer(dataset.attrs),
        )
    )


def _headline(facts: dict[str, Any]) -> str:
    eclipse, sampling = facts["eclipse"], facts["sampling"]
    return (
        f"In eclipse the printed signal is {number(eclipse['repaired_over_printed_8m'])} times too small at 8 m; light is "
        f"not what is missing: saturation fails first, and sampling ends the range at {number(sampling['ends_m'])} m."
    )


def _cards(facts: dict[str, Any]) -> Iterator[Card]:
    eclipse, sun, sampling, beam = (facts[key] for key in ("eclipse", "sun", "sampling", "beam"))
    yield Card(
        "Eclipse, 1/30 s",
        f"{number(eclipse['full_over_well_least'])} to {number(eclipse['full_over_well_most'])} full wells",
        "charge of a bright bit; the thesis concludes that light is missing above 8 m",
        (
            f"printed SNR {number(eclipse['printed_snr_8m'])} at 8 m",
            f"half a well takes {seconds_text(eclipse['auto_least_s'])} to {seconds_text(eclipse['auto_most_s'])}",
        ),
        False,
    )
    yield Card(
        "Sunlight, 1 ms",
        "right by accident",
        f"for the Sun alone; the printed SNR is {number(sun['printed_snr_8m'])} at every range",
        (
            f"repaired signal of the Sun alone: {number(sun['repaired_alone_over_printed_8m'])} of the printed one",
            f"with the LEDs on {number(sun['with_leds_over_well_least'])} to {number(sun['with_leds_over_well_most'])} full "
            "wells",
        ),
        None,
    )
    yield Card(
        "Sampling, bit of 5 mm",
        f"{number(sampling['px_per_bit_20m'])} px/bit at 20 m",
        f"{sampling['needed_px']:g} needed: ends at {number(sampling['ends_m'])} m",
        (
            f"20 m takes a bit of {number(sampling['bit_for_20m_mm'])} mm, or a lens of "
            f"{number(sampling['focal_for_20m_mm'])} mm",
        ),
        False,
    )
    yield Card(
        "Beam",
        f"{number(beam['printed_16deg_w_sr'])} W/sr",
        f"as printed; as bought {number(beam['as_bought_w_sr'])} W/sr",
        (f"{number(beam['printed_over_electrical'])} times the LEDs' electrical power",),
        False,
    )
