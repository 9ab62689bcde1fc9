"""Tables and claims of the power study."""

from __future__ import annotations

import numpy as np
import xarray as xr

from experiments.thesis.claims import Claim
from experiments.thesis.power.emitters import Emitter
from experiments.thesis.power.study import PowerResult
from radiometry import link
from radiometry.power import turn_rate_deviation

#: Exposures named in section 6.2 and in figure 6.4.
THESIS_EXPOSURES_S = (1 / 30, 1 / 50, 1 / 100, 1 / 150, 1 / 200)
#: Over this time a steady tumble is averaged to a rate [s]; assumption: a twentieth of a turn at 5 deg/s.
WATCH_S = 4.0
#: Deviation of one attitude [rad]: mean of the Monte Carlo's wide layout at 20 m, 0.08 deg (docs/montecarlo.md).
ATTITUDE_RAD = np.radians(0.08)

Rows = list[tuple[str, ...]]


def thesis_rows(result: PowerResult) -> Rows:
    """Heading, then equation 6.10 at each of the thesis's exposures: energy, rates, tumble and smear at 1 and 20 m."""
    scenario, power = result.scenario, result.power
    exposure = np.array(THESIS_EXPOSURES_S)
    energy = scenario.leds.energy_per_frame_j(exposure)
    alone = link.frames_per_second(power.limit_w, energy)
    whole = power.frame_rate(scenario.leds, exposure)
    speed = scenario.target.tumble_speed_m_s
    smear = [link.smear_px(scenario.camera, r, speed, exposure) for r in (1.0, 20.0)]
    heading = (
        "exposure [s]",
        "energy [J]",
        "frames/s, LEDs alone",
        "frames/s, with driver and camera",
        "turn between frames [deg]",
        "smear at 1 m [px]",
        "smear at 20 m [px]",
    )
    rows: Rows = [heading]
    for k, seconds in enumerate(THESIS_EXPOSURES_S):
        turn = scenario.target.tumble_deg_s / alone[k]
        numbers = (energy[k], alone[k], whole[k], turn, smear[0][k], smear[1][k])
        rows.append((f"1/{1 / seconds:.0f}", *(f"{v:.3g}" for v in numbers)))
    return rows


def range_rows(dataset: xr.Dataset) -> Rows:
    """Heading, then one row an illumination, number of LEDs and range."""
    heading = (
        "illumination",
        "LEDs",
        "range [m]",
        "exposure [µs]",
        "energy [mJ]",
        "frames/s, LEDs alone",
        "frames/s",
        "power [W]",
        "duty [ppm]",
        "turn [deg]",
        "swing [px]",
        "smear [px]",
    )
    rows: Rows = [heading]
    for illumination in dataset.illumination.values:
        for count in dataset.leds.values:
            for range_m in dataset.range_m.values:
                at = dataset.sel(illumination=illumination, leds=count, range_m=range_m)
                values = (1e6 * at.exposure_s, 1e3 * at.energy_j, at.rate_light, at.rate, at.power_w, 1e6 * at.duty)
                motion = (at.turn_deg, at.swing_px, at.smear_px)
                cells = tuple(f"{float(v):.3g}" for v in (*values, *motion))
                rows.append((str(illumination), str(count), f"{range_m:g}", *cells))
    return rows


def emitter_rows(found: tuple[Emitter, ...]) -> Rows:
    """Heading, then what each LED stands: always on, the thesis's pulses, a pulse of 20 µs."""
    heading = (
        "LED",
        "electrical [W]",
        "continuous limit [W]",
        "current [A]",
        "continuous limit [A]",
        "junction, always on [°C]",
        "rise, 1/30 s at 0.71/s [K]",
        "rise, 20 µs at 7.18/s [K]",
        "thermal room at 20 µs",
        "surge limit",
    )
    rows: Rows = [heading]
    for e in found:
        long, short = (float(e.rise_k(np.array(p), np.array(1 / f))) for p, f in ((1 / 30, 0.714), (20e-6, 7.18)))
        numbers = (e.electrical_w, e.power_max_w, e.current_a, e.current_max_a)
        thermal = (f"{e.steady_c:.0f}", f"{long:.1f}", f"{short:.2g}", f"×{e.overdrive(20e-6):.0f}")
        surge = f"{e.surge_a:g} A to {1e6 * e.surge_pulse_s:.0f} µs"
        rows.append((e.name, *(f"{v:g}" for v in numbers), *thermal, surge))
    return rows


def claims(result: PowerResult) -> list[Claim]:
    """What section 6.2 says of power, printed, reproduced and right."""
    scenario, power = result.scenario, result.power
    energy = float(scenario.leds.energy_per_frame_j(1 / 50))
    alone = power.limit_w / energy
    far = result.dataset.sel(illumination="eclipse", leds=100).isel(range_m=-1)
    listed_w = float(scenario.leds.energy_per_frame_j(1e-3)) * 30
    tumble = scenario.target.tumble_deg_s
    rate_error = [float(np.degrees(turn_rate_deviation(ATTITUDE_RAD, r, WATCH_S))) for r in (alone, float(far.rate))]
    range_m = float(far.range_m)
    return [
        Claim(
            "eq. 6.10",
            "frames a second under 5 W, 100 LEDs, 1/50 s, LEDs alone",
            "1/s",
            printed="1.2",
            reproduced=alone,
            right=alone,
            remark="arithmetic is right; 1.2 itself would draw 5.04 W",
        ),
        Claim(
            "eq. 6.10",
            f"the same with the exposure that {range_m:g} m needs, LEDs alone",
            "1/s",
            printed="1.2",
            reproduced=alone,
            right=float(far.rate_light),
            remark="the thesis's exposure saturates the detector at every range",
        ),
        Claim(
            "eq. 6.10",
            f"the same with driver, camera, readout and processor, {range_m:g} m",
            "1/s",
            printed="",
            reproduced=np.nan,
            right=float(far.rate),
            remark="the camera's readout binds, not the power",
        ),
        Claim(
            "eq. 6.10",
            "energy of one frame, 1/50 s and as needed",
            "J",
            printed="",
            reproduced=energy,
            right=float(far.energy_j),
            remark="so the illumination costs milliwatts",
        ),
        Claim(
            "listing A.5, l. 28",
            "power of 100 LEDs at 30 frames a second and 1 ms",
            "W",
            printed="",
            reproduced=listed_w,
            right=30 * float(far.energy_j),
            remark="the listing's own setting draws more than 5 W",
        ),
        Claim(
            "SYS-REQ-5",
            f"turn between frames at {tumble:g} deg/s",
            "deg",
            printed="",
            reproduced=tumble / alone,
            right=float(far.turn_deg),
            remark="not given; the text only says that the rate can be lowered",
        ),
        Claim(
            "SYS-REQ-5",
            f"deviation of a steady turn rate from {WATCH_S:g} s of frames, 0.08 deg each",
            "deg/s",
            printed="",
            reproduced=rate_error[0],
            right=rate_error[1],
            remark="slope of the attitudes; not given",
        ),
        Claim(
            "section 6.2",
            "power of one LED against its sibling's continuous limit",
            "W",
            printed="2.1",
            reproduced=2.1,
            right=result.emitters[0].power_max_w,
            remark="more than its sibling stands always on; as a pulse it is allowed",
        ),
    ]
