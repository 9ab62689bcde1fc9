"""What the page shows of the closed form: exposure, ratios, criteria with their limits, and margins over range."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from experiments import chain
from experiments.explore.geometries import Budgets
from experiments.reporting.formatting import number, percent, seconds_text
from experiments.scenario import Scenario
from radiometry import closure, link

#: Criterion of `radiometry.closure` -> what `at_exposure` calls what it judges.
JUDGED = {"saturation": "full_well_fraction", "cnr": "cnr", "sampling": "px_per_bit", "smear": "smear_px"}
NAMES = {"saturation": "charge over full well", "cnr": "CNR", "sampling": "pixels per bit", "smear": "smear"}
#: Ends of each gauge, which is logarithmic.
ENDS = {
    "saturation": (0.01, 10.0),
    "cnr": (0.5, 200.0),
    "sampling": (0.5, 50.0),
    "smear": (1e-6, 5.0),
    "snr": (0.5, 1e3),
}


def numbers(scenario: Scenario, budgets: Budgets, pair: bool) -> dict[str, Any]:
    """The closed form of a state: exposure, levels, ratios, and each criterion with its limit and margin."""
    budget = budgets.by_illumination[scenario.illumination]
    seconds = chain.solve_exposure(scenario, budget, scenario.exposure_s)
    values = at_exposure(scenario, budgets, seconds, pair)
    verdicts = closure.judge(scenario.requirement, {name: values[key] for name, key in JUDGED.items()})
    failing = [v for v in verdicts if not v.passed]
    worst = min(verdicts, key=lambda v: v.margin)
    said = "Closes here" if not failing else f"Fails here: {', '.join(NAMES[v.name] for v in failing)}"
    return {
        "exposure_s": seconds,
        "exposure_text": seconds_text(seconds),
        "closes": not failing,
        "verdict": f"{said}; least margin ×{number(worst.margin)}, {NAMES[worst.name]}.",
        "values": values,
        "gauges": [_gauge(v) for v in verdicts] + [_snr_gauge(scenario, values["snr"])],
    }


def at_exposure(scenario: Scenario, budgets: Budgets, seconds: float, pair: bool) -> dict[str, float]:
    """`LinkBudget.at`, with px_per_bit; of a pair, SNR and CNR are those of the difference of two frames.

    In the difference the Sun's light cancels and both frames' noise stays: its signal S is the LEDs', and its variance
    (S_on + D + σ²) + (S_off + D + σ²).
    """
    whole, led = budgets.by_illumination[scenario.illumination], budgets.by_illumination["eclipse"]
    values = {**whole.at(seconds), "px_per_bit": whole.px_per_bit}
    if pair:
        floor = 2 * (values["dark"] + scenario.sensor.total_noise_electrons**2)
        signal, background = led.signal_rate * seconds, led.background_rate * seconds
        bright = (2 * whole.signal_rate - led.signal_rate) * seconds + floor
        dark = (2 * whole.background_rate - led.background_rate) * seconds + floor
        values |= {"signal": signal, "background": background}
        values |= {"snr": signal / np.sqrt(bright), "cnr": (signal - background) / np.sqrt(bright + dark)}
    return {name: float(value) for name, value in values.items()}


def _gauge(verdict: closure.Verdict) -> dict[str, Any]:
    at_least = closure.CRITERIA[verdict.name][1]
    unit = {"sampling": " px", "smear": " px"}.get(verdict.name, "")
    show = percent if verdict.name == "saturation" else number
    return {
        "name": verdict.name,
        "label": NAMES[verdict.name],
        "value": verdict.value,
        "text": show(verdict.value) + unit,
        "limit": verdict.limit,
        "limit_text": f"{'at least' if at_least else 'at most'} {show(verdict.limit)}{unit}",
        "passed": verdict.passed,
        "margin": verdict.margin,
        "at_least": at_least,
        "low": ENDS[verdict.name][0],
        "high": ENDS[verdict.name][1],
    }


def _snr_gauge(scenario: Scenario, snr: float) -> dict[str, Any]:
    """SNR has no requirement of its own; what bounds it is a full pixel."""
    full = float(link.snr(chain.usable_well_electrons(scenario.sensor), 0.0, scenario.sensor.total_noise_electrons))
    return {
        "name": "snr",
        "label": "SNR",
        "value": snr,
        "text": number(snr),
        "limit": full,
        "at_least": False,
        "limit_text": f"a full pixel has {number(full)}",
        "passed": None,
        "margin": None,
        "low": ENDS["snr"][0],
        "high": ENDS["snr"][1],
    }


def curve(scenario: Scenario, points: Iterable[tuple[float, Budgets]], pair: bool) -> dict[str, Any]:
    """Margin of every criterion over range by the closed form, at the state's exposure; None where no bit is seen."""
    ranges, margins = [], {name: list[float | None]() for name in JUDGED}
    for range_m, budgets in points:
        ranges.append(range_m)
        here = scenario.model_copy(update={"range_m": range_m})
        budget = budgets.by_illumination[scenario.illumination]
        if np.isnan(budget.signal_rate):
            for found in margins.values():
                found.append(None)
            continue
        values = at_exposure(here, budgets, chain.solve_exposure(here, budget, scenario.exposure_s), pair)
        for verdict in closure.judge(scenario.requirement, {name: values[key] for name, key in JUDGED.items()}):
            margins[verdict.name].append(min(max(verdict.margin, 1e-9), 1e9))
    return {"range_m": ranges, "margins": margins, "names": NAMES}
