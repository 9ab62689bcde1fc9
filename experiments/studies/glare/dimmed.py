"""The thesis's finding in sunlight (section 8.2), reproduced and explained: blobs found over the LEDs' share of the light.

Its pipeline lost the blobs in lamplight from 45° and kept them with the lamp behind the camera. How strong its LEDs were against
its lamp is not printed, so the LEDs are dimmed step by step; everything else is as in the mode of that name.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.glare.frames import VARIABLES, draw
from experiments.studies.glare.geometry import Geometry, at_sun, cropped, render
from experiments.studies.glare.modes import MODES, Rates
from experiments.studies.glare.plan import Plan
from experiments.studies.shared.truth import Truth

#: At 3 m the slits blur into one blob, as that pipeline needs; assumption.
RANGE_M = 3.0
#: Nearly behind the camera, where its own return does not yet fill the well in the shortest pulse, and the thesis's angle.
PHASES_DEG = (5.0, 45.0)
PIPELINES = ("thesis", "longpass", "single", "pair")
#: Rays of one rendering.
_RAYS = 400_000


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None) -> xr.Dataset:
    """Usable poses and blobs by pipeline, phase and dimming; `led_over_sun` is of the bright bits through the longpass."""
    scales, attitudes, draws = plan.dimmed_scales, plan.attitudes, plan.dimmed_draws
    shape = (len(PIPELINES), len(PHASES_DEG), len(scales), len(attitudes) * draws)
    usable, blobs = np.zeros(shape), np.zeros(shape)
    ratio = np.zeros((len(PHASES_DEG), len(scales), len(attitudes)))
    need, names = scenario.requirement, list(VARIABLES)
    for p, phase in enumerate(PHASES_DEG):
        for s, attitude in enumerate(attitudes):
            here = cropped(at_sun(scenario, RANGE_M, phase, scenario.sun.azimuth_deg, attitude))
            full = render(here, PIPELINES, plan.pair_interval_s, _RAYS)
            truth, part = Truth.of(here), slice(s * draws, (s + 1) * draws)
            for k, scale in enumerate(scales):
                geometry = _dimmed(full, scale)
                rates = geometry.mode_rates(MODES["thesis"])
                ratio[p, k, s] = truth.bits(rates.led)[0] / truth.bits(rates.sun)[0]
                values, errors = draw(geometry, PIPELINES, draws, (77, p, s, k))
                turned, distance = (values[names.index(v)] for v in ("attitude_error_deg", "range_error"))
                good = (turned <= need.attitude_error_max_deg) & (distance <= need.range_error_max)
                usable[:, p, k, part] = good
                blobs[:, p, k, part] = np.isfinite(errors).sum(axis=-1)
            if progress:
                progress(p * len(attitudes) + s + 1, len(PHASES_DEG) * len(attitudes), f"dimmed LEDs, phase {phase:g}°")
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


def _dimmed(geometry: Geometry, scale: float) -> Geometry:
    """The geometry with its LEDs' light scaled."""
    rates = {name: Rates(r.led * scale, r.sun, r.moved_sun) for name, r in geometry.rates.items()}
    return replace(geometry, rates=rates)
