"""The thesis's finding in sunlight (section 8.2), reproduced and resolved: blobs found over the LEDs' share of the light.

Its pipeline lost the blobs in lamplight from 45° and kept them with the lamp behind the camera. How strong its LEDs were against
its lamp is not printed, so the LEDs are dimmed step by step; everything else is as in the mode of that name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr

from experiments.scenario import Scenario
from experiments.studies.glare.geometry import Stand, at_sun, cropped, render
from experiments.studies.glare.modes import MODES, Lit
from experiments.studies.glare.study import VARIABLES, Truth, draw

#: At 3 m the slits blur into one blob, as that pipeline needs; assumption.
RANGE_M = 3.0
#: Nearly behind the camera, where its own return does not yet fill the well in the shortest pulse, and the thesis's angle.
PHASES_DEG = (5.0, 45.0)
#: Intensity of the LEDs over the scenario's.
SCALES = tuple(float(s) for s in 10.0 ** -np.arange(0, 4.01, 0.5))
PIPELINES = ("thesis", "longpass", "single", "pair")


def run(
    scenario: Scenario,
    stands: tuple[Stand, ...],
    draws: int,
    pair_interval_s: float,
    scales: tuple[float, ...] = SCALES,
    progress: Callable | None = None,
) -> xr.Dataset:
    """Usable poses and blobs by pipeline, phase and dimming; `led_over_sun` is of the bright bits through the longpass."""
    shape = (len(PIPELINES), len(PHASES_DEG), len(scales), len(stands) * draws)
    usable, blobs = np.zeros(shape), np.zeros(shape)
    ratio = np.zeros((len(PHASES_DEG), len(scales), len(stands)))
    need, names = scenario.requirement, list(VARIABLES)
    for p, phase in enumerate(PHASES_DEG):
        for s, stand in enumerate(stands):
            here = cropped(at_sun(scenario, RANGE_M, phase, scenario.sun.azimuth_deg, stand))
            full = render(here, PIPELINES, pair_interval_s, 400_000)
            truth, part = Truth(here), slice(s * draws, (s + 1) * draws)
            for k, scale in enumerate(scales):
                rates = {name: Lit(lit.led * scale, lit.sun, lit.moved_sun) for name, lit in full.rates.items()}
                dimmed = replace(full, rates=rates)
                lit = dimmed.lit(MODES["thesis"])
                ratio[p, k, s] = truth.bits(lit.led)[0] / truth.bits(lit.sun)[0]
                values, errors = draw(dimmed, PIPELINES, draws, (77, p, s, k))
                attitude, distance = (values[names.index(v)] for v in ("attitude_error_deg", "range_error"))
                good = (attitude <= need.attitude_error_max_deg) & (distance <= need.range_error_max)
                usable[:, p, k, part] = good
                blobs[:, p, k, part] = np.isfinite(errors).sum(axis=-1)
            if progress:
                progress(p * len(stands) + s + 1, len(PHASES_DEG) * len(stands), f"dimmed LEDs, phase {phase:g}°")
    dims = ("mode", "phase_deg", "led_scale", "frame")
    return xr.Dataset(
        {
            "usable": (dims, usable, {"long_name": "marker found, its pose within the requirement"}),
            "blobs": (dims, blobs, {"long_name": "blobs found, of four"}),
            "led_over_sun": (
                dims[1:3],
                ratio.mean(axis=-1),
                {"long_name": "LEDs' over the Sun's light on bright bits"},
            ),
        },
        {"mode": list(PIPELINES), "phase_deg": list(PHASES_DEG), "led_scale": list(scales)},
    )
