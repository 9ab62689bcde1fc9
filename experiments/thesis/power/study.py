"""Frame rate, duty and tumble of the illuminated camera over range: the thesis's equation 6.10 and what follows from the budget.

The thesis takes its exposure from a link budget that is a million times too dark; its frame rate is that exposure's. Here the
exposure of every range is the one that puts the bright bits at half the full well, from this project's own budget.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from experiments import chain
from experiments.reporting.claims import Statement, StudyPage
from experiments.scenario import Scenario
from experiments.thesis.power.emitters import Emitter, emitters
from radiometry import link
from radiometry.power import PowerPlan, swing_px, turn_rate_deviation

#: Exposures named in section 6.2 and in figure 6.4.
THESIS_EXPOSURES_S = (1 / 30, 1 / 50, 1 / 100, 1 / 150, 1 / 200)
#: LEDs that are on. The thesis has 100 and would switch some off at short range.
LED_COUNTS = (1, 10, 100)
RANGES_M = tuple(float(r) for r in range(1, 21))
QUICK_RANGES_M = (1.0, 5.0, 10.0, 20.0)
#: Over this time a steady tumble is averaged to a rate [s]; assumption: a twentieth of a turn at 5 deg/s.
WATCH_S = 4.0
#: Deviation of one attitude [rad]: mean of the Monte Carlo's wide layout at 20 m, 0.08 deg (docs/montecarlo.md).
ATTITUDE_RAD = np.radians(0.08)


def run(scenario: Scenario, plan: PowerPlan, quick: bool = False) -> xr.Dataset:
    """Exposure, energy and frame rates over light, number of LEDs and range.

    Variables, by light ('eclipse', 'sun'), leds and range_m: exposure_s; energy_j of one frame; rate_light, frames a second of
    the illumination alone under the limit (equation 6.10); rate_power with driver and camera; rate, bounded by readout and
    processor; duty; power_w drawn at that rate; turn_deg and swing_px from frame to frame; smear_px; signal of full well.
    """
    ranges = QUICK_RANGES_M if quick else RANGES_M
    illuminations = tuple(chain.SOURCES)
    shape = (len(illuminations), len(LED_COUNTS), len(ranges))
    exposure, smear, filled = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for i, j, k in np.ndindex(shape):
        leds = scenario.leds.model_copy(update={"count": LED_COUNTS[j]})
        here = scenario.at(range_m=ranges[k], leds=leds.model_dump())
        budget = chain.link_budget(here, illuminations[i])
        exposure[i, j, k] = chain.solve_exposure(here, budget, "auto")
        charge = budget.at(float(exposure[i, j, k]))
        smear[i, j, k], filled[i, j, k] = charge["smear_px"], charge["full_well_fraction"]
    counts = np.array(LED_COUNTS)[None, :, None]
    energy = scenario.leds.energy_per_frame_j(exposure) / scenario.leds.count * counts
    by_illumination = link.frames_per_second(plan.limit_w, energy, exposure, scenario.leds.duty_max)
    by_power, rate = np.zeros(shape), np.zeros(shape)
    for j, count in enumerate(LED_COUNTS):
        leds = scenario.leds.model_copy(update={"count": count})
        by_power[:, j] = plan.frame_rate_by_power(leds, exposure[:, j])
        rate[:, j] = plan.frame_rate(leds, exposure[:, j])
    turn = scenario.target.tumble_deg_s / rate
    focal = max(scenario.camera.focal_px)
    swing = swing_px(focal, scenario.target.tumble_lever_m, np.array(ranges), np.radians(turn))
    dims = ("illumination", "leds", "range_m")
    values = {
        "exposure_s": (exposure, "s", "exposure and LED pulse"),
        "full_well_fraction": (filled, "1", "bright bits over full well"),
        "energy_j": (energy, "J", "electrical energy of one frame's pulse"),
        "rate_light": (
            by_illumination,
            "s-1",
            "frames a second of the illumination alone under the limit, equation 6.10",
        ),
        "rate_power": (by_power, "s-1", "frames a second under the limit, with driver and camera"),
        "rate": (rate, "s-1", "frames a second, bounded by readout and processor"),
        "duty": (rate * exposure, "1", "share of time the LEDs are on"),
        "power_w": (plan.camera_w + rate * energy / plan.driver_efficiency, "W", "power drawn at that rate"),
        "turn_deg": (turn, "deg", "turn of the target from frame to frame"),
        "swing_px": (swing, "pixel", "largest motion of the marker from frame to frame"),
        "smear_px": (smear, "pixel", "motion during the exposure"),
    }
    data = {k: (dims, v, {"units": unit, "long_name": name}) for k, (v, unit, name) in values.items()}
    coordinates = {
        "illumination": list(illuminations),
        "leds": list(LED_COUNTS),
        "range_m": ("range_m", list(ranges), {"units": "m"}),
    }
    return xr.Dataset(data, coordinates, {**chain.provenance(scenario), "plan": plan.model_dump_json()})


def thesis_rows(scenario: Scenario, plan: PowerPlan) -> list[tuple[str, ...]]:
    """Heading, then equation 6.10 at each of the thesis's exposures: energy, rates, tumble and smear at 1 and 20 m."""
    exposure = np.array(THESIS_EXPOSURES_S)
    energy = scenario.leds.energy_per_frame_j(exposure)
    alone = link.frames_per_second(plan.limit_w, energy)
    whole = plan.frame_rate(scenario.leds, exposure)
    speed = scenario.target.tumble_speed_m_s
    smear = [link.smear_px(scenario.camera, r, speed, exposure) for r in (1.0, 20.0)]
    rows: list[tuple[str, ...]] = [
        ("exposure [s]", "energy [J]", "frames/s, LEDs alone", "frames/s, with driver and camera",
         "turn between frames [deg]", "smear at 1 m [px]", "smear at 20 m [px]"),
    ]  # fmt: skip
    for k, seconds in enumerate(THESIS_EXPOSURES_S):
        turn = scenario.target.tumble_deg_s / alone[k]
        numbers = (energy[k], alone[k], whole[k], turn, smear[0][k], smear[1][k])
        rows.append((f"1/{1 / seconds:.0f}", *(f"{v:.3g}" for v in numbers)))
    return rows


def range_rows(dataset: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a light, number of LEDs and range."""
    rows: list[tuple[str, ...]] = [
        ("illumination", "LEDs", "range [m]", "exposure [µs]", "energy [mJ]", "frames/s, LEDs alone", "frames/s",
         "power [W]", "duty [ppm]", "turn [deg]", "swing [px]", "smear [px]"),
    ]  # fmt: skip
    for illumination in dataset.illumination.values:
        for count in dataset.leds.values:
            for range_m in dataset.range_m.values:
                at = dataset.sel(illumination=illumination, leds=count, range_m=range_m)
                values = (1e6 * at.exposure_s, 1e3 * at.energy_j, at.rate_light, at.rate, at.power_w, 1e6 * at.duty)
                motion = (at.turn_deg, at.swing_px, at.smear_px)
                cells = tuple(f"{float(v):.3g}" for v in (*values, *motion))
                rows.append((str(illumination), str(count), f"{range_m:g}", *cells))
    return rows


def emitter_rows(found: tuple[Emitter, ...]) -> list[tuple[str, ...]]:
    """Heading, then what each LED stands: always on, the thesis's pulses, a pulse of 20 µs."""
    rows: list[tuple[str, ...]] = [
        ("LED", "electrical [W]", "continuous limit [W]", "current [A]", "continuous limit [A]", "junction, always on [°C]",
         "rise, 1/30 s at 0.71/s [K]", "rise, 20 µs at 7.18/s [K]", "thermal room at 20 µs", "surge limit"),
    ]  # fmt: skip
    for e in found:
        long, short = (float(e.rise_k(np.array(p), np.array(1 / f))) for p, f in ((1 / 30, 0.714), (20e-6, 7.18)))
        surge = f"{e.surge_a:g} A to {1e6 * e.surge_pulse_s:.0f} µs"
        numbers = (e.electrical_w, e.power_max_w, e.current_a, e.current_max_a)
        rows.append(
            (e.name, *(f"{v:g}" for v in numbers), f"{e.steady_c:.0f}", f"{long:.1f}", f"{short:.2g}",
             f"×{e.overdrive(20e-6):.0f}", surge)
        )  # fmt: skip
    return rows


def statements(dataset: xr.Dataset, scenario: Scenario, plan: PowerPlan) -> list[Statement]:
    """What section 6.2 says of power, printed, reproduced and right."""
    pulse = 1 / 50
    energy = float(scenario.leds.energy_per_frame_j(pulse))
    alone = plan.limit_w / energy
    far = dataset.sel(illumination="eclipse", leds=100).isel(range_m=-1)
    listed_w = float(scenario.leds.energy_per_frame_j(1e-3)) * 30
    tumble = scenario.target.tumble_deg_s
    rate_error = [float(np.degrees(turn_rate_deviation(ATTITUDE_RAD, r, WATCH_S))) for r in (alone, float(far.rate))]
    range_m = float(far.range_m)
    return [
        Statement("eq. 6.10", "frames a second under 5 W, 100 LEDs, 1/50 s, LEDs alone", "1/s", "1.2", alone, alone,
                  "arithmetic is right; 1.2 itself would draw 5.04 W"),
        Statement("eq. 6.10", f"the same with the exposure that {range_m:g} m needs, LEDs alone", "1/s", "1.2", alone,
                  float(far.rate_light), "the thesis's exposure saturates the detector at every range"),
        Statement("eq. 6.10", f"the same with driver, camera, readout and processor, {range_m:g} m", "1/s", "", np.nan,
                  float(far.rate), "the camera's readout binds, not the power"),
        Statement("eq. 6.10", "energy of one frame, 1/50 s and as needed", "J", "", energy, float(far.energy_j),
                  "so the illumination costs milliwatts"),
        Statement("listing A.5, l. 28", "power of 100 LEDs at 30 frames a second and 1 ms", "W", "", listed_w,
                  30 * float(far.energy_j), "the listing's own setting draws more than 5 W"),
        Statement("SYS-REQ-5", f"turn between frames at {tumble:g} deg/s", "deg", "", tumble / alone, float(far.turn_deg),
                  "not given; the text only says that the rate can be lowered"),
        Statement("SYS-REQ-5", f"deviation of a steady turn rate from {WATCH_S:g} s of frames, 0.08 deg each", "deg/s", "",
                  rate_error[0], rate_error[1], "slope of the attitudes; not given"),
        Statement("section 6.2", "power of one LED against its sibling's continuous limit", "W", "2.1", 2.1,
                  emitters()[0].power_max_w, "more than its sibling stands always on; as a pulse it is allowed"),
    ]  # fmt: skip


def answers(dataset: xr.Dataset, scenario: Scenario, plan: PowerPlan) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    worst = dataset.sel(leds=100)
    slow = float(worst.rate_light.min())
    largest = float(dataset.duty.max())
    hottest = max(float(e.rise_k(np.array(float(dataset.exposure_s.max())), np.array(1 / plan.frame_rate_max)))
                  for e in emitters())  # fmt: skip
    limit = min(plan.frame_rate_max, 1 / plan.latency_s if plan.latency_s else np.inf)
    tumble = scenario.target.tumble_deg_s
    return (
        f"Power: under {plan.limit_w:g} W the LEDs alone could flash {slow:,.0f} times a second at the worst range and light, "
        f"100 of them at full power. The camera reads out {limit:.3g} frames a second, and that binds.",
        f"Tumble: at that rate a target at {tumble:g} deg/s turns {float(dataset.turn_deg.max()):.2f} deg from frame to frame; "
        f"the thesis's 1.2 frames a second leave {tumble / 1.19:.1f} deg.",
        f"Sensor: all in all it draws {float(dataset.power_w.max()):.2f} W at most, {plan.camera_w:g} W of it the camera "
        "(assumption).",
        f"LEDs: they are on for at most {100 * largest:.2g} % of the time, and a pulse heats a junction by {hottest:.1g} K at "
        "most; no thermal limit binds.",
    )


def page(dataset: xr.Dataset, scenario: Scenario, plan: PowerPlan, command: str) -> StudyPage:
    """Everything that is written."""
    from experiments.thesis.power import figures

    found = emitters()
    said = answers(dataset, scenario, plan)
    return StudyPage(
        name="power",
        title="Power, frame rate and tumble",
        headline=f"Power does not bind: {float(dataset.rate.min()):.3g} frames a second at every range, within "
        f"{float(dataset.power_w.max()):.2g} W of {plan.limit_w:g} W.",
        passed=bool((dataset.power_w <= plan.limit_w).all()),
        answers=said,
        statements=statements(dataset, scenario, plan),
        tables={
            "thesis": thesis_rows(scenario, plan),
            "ranges": range_rows(dataset),
            "leds": emitter_rows(found),
        },
        table_captions={
            "thesis": "Equation 6.10 at the thesis's exposures, 100 LEDs",
            "ranges": "As needed: half the full well at every range",
            "leds": "What the LEDs stand",
        },
        plots={
            "rate": figures.rate_over_exposure(dataset, scenario, plan),
            "range": figures.over_range(dataset, scenario, plan),
            "pulse": figures.junction(dataset, found),
        },
        captions=figures.CAPTIONS,
        about=ABOUT,
        short=("thesis", "leds"),
        limits=LIMITS,
        command=command,
        scenario=scenario,
    )


ABOUT = (
    "Equation 6.10 of the thesis gives the illuminator's power, P = P_LED · n · t · fps. This page recomputes the "
    "frame rate under 5 W, "
    "adds what the equation leaves out (driver, camera, readout, duty, junction temperature), and repeats it with "
    "the exposures that "
    "the link budget really needs.",
)
LIMITS = (
    "Driver efficiency 0.85, camera 2.5 W, processor 50 ms and board temperature 60 °C are assumptions; readout is "
    "that of table 7.1.",
    "The junction is one thermal node with the heat capacity of the chip alone, 0.15 mm thick: too hot rather than "
    "too cold for "
    "pulses of milliseconds. Data sheets' own curves of permissible pulses were not at hand.",
    "The thesis's LED has no data sheet that could be found; its limits are its sibling's.",
    "No number in the thesis says how far a target may turn between frames; the deviation of the turn rate is shown "
    "instead.",
)


def study(scenario: Scenario, plan: PowerPlan, out: Path, command: str, quick: bool = False) -> StudyPage:
    """Run and write power.nc, report.html, data/power*.csv and figures/power-*.svg into a folder."""
    dataset = run(scenario, plan, quick)
    result = page(dataset, scenario, plan, command)
    result.write(out, dataset)
    return result
