"""The page of `mantis power`: what binds the frame rate, and what the LEDs stand."""

from __future__ import annotations

import numpy as np

from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.page import Page
from experiments.thesis.claims import claims_section
from experiments.thesis.power import figures
from experiments.thesis.power.study import PowerResult
from experiments.thesis.power.tables import claims, emitter_rows, range_rows, thesis_rows

ABOUT = (
    "Equation 6.10 of the thesis gives the illuminator's power, P = P_LED · n · t · fps. This page recomputes the frame rate "
    "under 5 W, adds what the equation leaves out (driver, camera, readout, duty, junction temperature), and repeats it with "
    "the exposures that the link budget really needs.",
)
LIMITS = (
    "Driver efficiency 0.85, camera 2.5 W, processor 50 ms and board temperature 60 °C are assumptions; readout is that of "
    "table 7.1.",
    "The junction is one thermal node with the heat capacity of the chip alone, 0.15 mm thick: too hot rather than too cold "
    "for pulses of milliseconds. Data sheets' own curves of permissible pulses were not at hand.",
    "The thesis's LED has no data sheet that could be found; its limits are its sibling's.",
    "No number in the thesis says how far a target may turn between frames; the deviation of the turn rate is shown instead.",
)


def page(result: PowerResult, command: str) -> Page:
    """What the power study says.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
    """
    dataset, power = result.dataset, result.power
    return Page(
        study="power",
        title="Power, frame rate and tumble",
        headline=_headline(result),
        passed=bool((dataset.power_w <= power.limit_w).all()),
        command=command,
        about=ABOUT,
        findings=findings(result),
        sections=(
            claims_section(claims(result)),
            _figures(result),
            Section(
                "tables",
                "Tables",
                (
                    text_table(
                        thesis_rows(result),
                        "Equation 6.10 at the thesis's exposures, 100 LEDs",
                        key="thesis",
                        terminal=True,
                    ),
                    text_table(
                        range_rows(dataset), "As needed: half the full well at every range", key="ranges", inline=False
                    ),
                    text_table(emitter_rows(result.emitters), "What the LEDs stand", key="leds"),
                ),
            ),
        ),
        limits=LIMITS,
        scenario=result.scenario,
        data=dataset,
    )


def _headline(result: PowerResult) -> str:
    dataset, power = result.dataset, result.power
    return (
        f"Power does not bind: {float(dataset.rate.min()):.3g} frames a second at every range, within "
        f"{float(dataset.power_w.max()):.2g} W of {power.limit_w:g} W."
    )


def findings(result: PowerResult) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    dataset, power = result.dataset, result.power
    slow = float(dataset.rate_light.sel(leds=100).min())
    longest, period = np.array(float(dataset.exposure_s.max())), np.array(1 / power.frame_rate_max)
    hottest = max(float(emitter.rise_k(longest, period)) for emitter in result.emitters)
    readout = min(power.frame_rate_max, 1 / power.latency_s if power.latency_s else np.inf)
    tumble = result.scenario.target.tumble_deg_s
    return (
        f"Power: under {power.limit_w:g} W the LEDs alone could flash {slow:,.0f} times a second at the worst range and "
        f"illumination, 100 of them at full power. The camera reads out {readout:.3g} frames a second, and that binds.",
        f"Tumble: at that rate a target at {tumble:g} deg/s turns {float(dataset.turn_deg.max()):.2f} deg from frame to frame; "
        f"the thesis's 1.2 frames a second leave {tumble / 1.19:.1f} deg.",
        f"Sensor: all in all it draws {float(dataset.power_w.max()):.2f} W at most, {power.camera_w:g} W of it the camera "
        "(assumption).",
        f"LEDs: they are on for at most {100 * float(dataset.duty.max()):.2g} % of the time, and a pulse heats a junction by "
        f"{hottest:.1g} K at most; no thermal limit binds.",
    )


def _figures(result: PowerResult) -> Section:
    plots = (
        Plot(
            "rate",
            figures.rate_over_exposure(result),
            "Frames a second under the power limit over the exposure (equation 6.10 for LEDs alone): the thesis's exposures and "
            "those that this project's budget needs.",
        ),
        Plot(
            "range",
            figures.over_range(result),
            "Exposure, frame rate, and how far the marker moves in the image from frame to frame, 100 LEDs.",
        ),
        Plot(
            "pulse",
            figures.junction(result),
            "Junction temperature over the length of a single pulse, and the longest pulse that the link budget asks for.",
        ),
    )
    return Section("figures", "Figures", tuple(Plots((plot,)) for plot in plots))
