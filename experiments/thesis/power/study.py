"""Frame rate, duty and tumble of the illuminated camera over range: the thesis's equation 6.10 and what follows from the budget.

The thesis takes its exposure from a link budget that is a million times too dark; its frame rate is that exposure's. Here the
exposure of every range is the one that puts the bright bits at half the full well, from this project's own budget.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.power.emitters import Emitter, emitters
from experiments.thesis.power.plan import FULL, Plan
from radiometry import link
from radiometry.power import PowerPlan, swing_px


@dataclass(frozen=True)
class PowerResult:
    """What the power study gives.

    Attributes:
        scenario: LEDs, camera, sensor and tumble.
        power: what may be drawn.
        dataset: exposure, energy, frame rates and motion by (illumination, leds, range_m); every variable says what it is.
        emitters: LEDs of the thesis's class and what they stand.
    """

    scenario: Scenario
    power: PowerPlan
    dataset: xr.Dataset
    emitters: tuple[Emitter, ...]


def run(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> PowerResult:
    """Exposure, energy, frame rates and motion between frames, over illumination, number of LEDs and range.

    Equation 6.10 of the thesis is `rate_light`: frames a second of the illumination alone under the limit. `rate_power` adds
    driver and camera, `rate` is bounded by readout and processor too.
    """
    power, ranges, counts = plan.power, plan.ranges_m, plan.led_counts
    illuminations = tuple(chain.SOURCES)
    shape = (len(illuminations), len(counts), len(ranges))
    exposure, smear, filled = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for i, j, k in np.ndindex(shape):
        leds = scenario.leds.model_copy(update={"count": counts[j]})
        here = scenario.at(range_m=ranges[k], leds=leds.model_dump())
        budget = chain.link_budget(here, illuminations[i])
        exposure[i, j, k] = chain.solve_exposure(here, budget, "auto")
        charge = budget.at(float(exposure[i, j, k]))
        smear[i, j, k], filled[i, j, k] = charge["smear_px"], charge["full_well_fraction"]
    energy = scenario.leds.energy_per_frame_j(exposure) / scenario.leds.count * np.array(counts)[None, :, None]
    by_illumination = link.frames_per_second(power.limit_w, energy, exposure, scenario.leds.duty_max)
    by_power, rate = np.zeros(shape), np.zeros(shape)
    for j, count in enumerate(counts):
        leds = scenario.leds.model_copy(update={"count": count})
        by_power[:, j] = power.frame_rate_by_power(leds, exposure[:, j])
        rate[:, j] = power.frame_rate(leds, exposure[:, j])
    turn = scenario.target.tumble_deg_s / rate
    focal = max(scenario.camera.focal_px)
    swing = swing_px(focal, scenario.target.tumble_lever_m, np.array(ranges), np.radians(turn))
    drawn = power.camera_w + rate * energy / power.driver_efficiency
    alone = "frames a second of the illumination alone under the limit, equation 6.10"
    values = {
        "exposure_s": (exposure, "s", "exposure and LED pulse"),
        "full_well_fraction": (filled, "1", "bright bits over full well"),
        "energy_j": (energy, "J", "electrical energy of one frame's pulse"),
        "rate_light": (by_illumination, "s-1", alone),
        "rate_power": (by_power, "s-1", "frames a second under the limit, with driver and camera"),
        "rate": (rate, "s-1", "frames a second, bounded by readout and processor"),
        "duty": (rate * exposure, "1", "share of time the LEDs are on"),
        "power_w": (drawn, "W", "power drawn at that rate"),
        "turn_deg": (turn, "deg", "turn of the target from frame to frame"),
        "swing_px": (swing, "pixel", "largest motion of the marker from frame to frame"),
        "smear_px": (smear, "pixel", "motion during the exposure"),
    }
    dims = ("illumination", "leds", "range_m")
    data = {k: (dims, v, {"units": unit, "long_name": name}) for k, (v, unit, name) in values.items()}
    coordinates = {
        "illumination": list(illuminations),
        "leds": list(counts),
        "range_m": ("range_m", list(ranges), {"units": "m"}),
    }
    attributes = {**chain.provenance(scenario), "plan": power.model_dump_json()}
    return PowerResult(scenario, power, xr.Dataset(data, coordinates, attributes), emitters())
