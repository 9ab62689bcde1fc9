"""Closed form against rendering, cell by cell, with an error budget and a check of the drawn noise.

A cell is a range, marker size, tilt, illumination and sensor. Transport is rendered once per geometry and Sun; the eclipse and
every sensor come from the same basis images. Only the detector's pixels about the bits are rendered, at their own places.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from scipy import stats

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.validate import crosscheck
from experiments.studies.validate.cells import (
    EFFECTS,
    QUANTITIES,
    REMAINDERS,
    Bits,
    at_geometry,
    cropped,
    sensor_of,
    why_not,
)
from experiments.studies.validate.crosscheck import Agreement
from experiments.studies.validate.plan import FULL, Plan

#: Largest relative difference that agrees: from so many pixels per bit on, and below.
FINE_PX_PER_BIT, FINE_TOLERANCE, COARSE_TOLERANCE = 3.0, 0.01, 0.03
#: Probability that every noise check of a run passes where drawn and closed-form noise are the same.
CONFIDENCE = 0.999

DIMS = ("range_m", "size_m", "tilt_deg", "illumination", "sensor")
_NOISE = ("noise_variance_ratio", "noise_mean_z", "noise_freedom")


@dataclass(frozen=True)
class ValidationResult:
    """Closed form beside rendering, and beside other people's code.

    Attributes:
        scenario: camera, LEDs and materials.
        dataset: every cell, see `compare`.
        checks: of `crosscheck.run`.
        indirect: gain of each part of the frame by indirect light, see `crosscheck.indirect_light`.
    """

    scenario: Scenario
    dataset: xr.Dataset
    checks: tuple[Agreement, ...]
    indirect: dict[str, float]


def run(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> ValidationResult:
    """Compare every cell of a plan, and the chain with other people's code.

    Args:
        scenario: camera, LEDs and materials; range, marker size, tilt and phase are the plan's.
        plan: the cells.
        progress: called after every geometry.
    """
    dataset = compare(scenario, plan, progress)
    checks, indirect = crosscheck.run(scenario)
    return ValidationResult(scenario, dataset, tuple(checks), indirect)


def compare(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> xr.Dataset:
    """Both sides of every cell with differences, limits and verdicts; NaN and a reason where bits leave the frame."""
    illuminations = ("eclipse", *(f"sun {phase:g} deg" for phase in plan.phases_deg))
    shape = (len(plan.ranges_m), len(plan.sizes_m), len(plan.tilts_deg), len(illuminations))
    names = [f"{q}_{how}" for q in QUANTITIES for how in ("analytic", "rendered")] + ["exposure_s", *_NOISE]
    cells = {name: np.full((*shape, len(plan.sensors)), np.nan) for name in names}
    effects = np.full((*shape, len(EFFECTS)), np.nan)
    remainders = np.full((*shape, len(REMAINDERS), 2), np.nan)
    px_per_bit, reason = np.full(shape[:3], np.nan), np.full(shape[:3], "", dtype=object)

    # Size outermost: the renderer keeps the scenes of a few markers.
    steps = list(product(enumerate(plan.sizes_m), enumerate(plan.tilts_deg), enumerate(plan.ranges_m)))
    for done, ((s, size_m), (t, tilt_deg), (r, range_m)) in enumerate(steps):
        here = at_geometry(scenario, range_m, size_m, tilt_deg)
        index = (r, s, t)
        px_per_bit[index] = here.marker.bit_m * min(chain.bit_scale_px(chain.view(here)))
        reason[index] = why_not(here)
        if not reason[index]:
            bits = Bits(cropped(here), plan)
            for k, illumination in enumerate(bits.illuminations):
                for d, name in enumerate(plan.sensors):
                    sensor = sensor_of(scenario, name)
                    for key, value in bits.cell(illumination, sensor, plan.draws, (*index, k, d)).items():
                        cells[key][*index, k, d] = value
                effects[*index, k] = bits.effects(illumination)
                remainders[*index, k] = bits.remainders(illumination)
        if progress:
            progress(done + 1, len(steps), f"{size_m * 100:g} cm, {tilt_deg:g}°, {range_m:g} m")
    dataset = xr.Dataset(
        {name: (DIMS, values) for name, values in cells.items()}
        | {
            "effect_on_signal": ((*DIMS[:4], "effect"), effects),
            "remainder": ((*DIMS[:4], "source", "quantity"), remainders),
            "px_per_bit": (DIMS[:3], px_per_bit),
            "reason": (DIMS[:3], reason.astype(str)),
        },
        coords={
            "range_m": list(plan.ranges_m),
            "size_m": list(plan.sizes_m),
            "tilt_deg": list(plan.tilts_deg),
            "illumination": list(illuminations),
            "phase_deg": ("illumination", [np.nan, *plan.phases_deg]),
            "sensor": list(plan.sensors),
            "effect": list(EFFECTS),
            "source": list(REMAINDERS),
            "quantity": ["signal", "background"],
        },
        attrs={"title": "Closed form against rendering", "draws": plan.draws, **chain.provenance(scenario)},
    )
    return judged(dataset)


def judged(dataset: xr.Dataset) -> xr.Dataset:
    """A dataset of both sides of every cell with differences, limits and verdicts, made anew."""
    for name in QUANTITIES:
        dataset[f"{name}_difference"] = dataset[f"{name}_rendered"] / dataset[f"{name}_analytic"] - 1
    dataset["tolerance"] = xr.where(dataset.px_per_bit >= FINE_PX_PER_BIT, FINE_TOLERANCE, COARSE_TOLERANCE)
    validated = np.isfinite(dataset.signal_difference)
    # Šidák: each of 2 N checks is held to such a level that all pass together with the confidence.
    tail = (1 - CONFIDENCE ** (1 / max(2 * int(validated.sum()), 1))) / 2
    freedom = dataset.noise_freedom
    for name, level in (("low", tail), ("high", 1 - tail)):
        dataset[f"noise_variance_{name}"] = (DIMS, stats.chi2.ppf(level, freedom) / freedom.values)
    ratio = dataset.noise_variance_ratio
    dataset["noise_agrees"] = (ratio > dataset.noise_variance_low) & (ratio < dataset.noise_variance_high)
    dataset["noise_agrees"] &= np.abs(dataset.noise_mean_z) < stats.norm.isf(tail)
    worst = np.max([np.abs(dataset[f"{name}_difference"].values) for name in QUANTITIES], axis=0)
    dataset["worst_difference"] = (DIMS, worst)
    dataset["agrees"] = ~validated | ((dataset.worst_difference <= dataset.tolerance) & dataset.noise_agrees)
    return dataset
