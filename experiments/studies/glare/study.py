"""Sun glare: detection and pose over phase angle, azimuth and range, for each counter-measure of `modes`.

Frames are crops about the marker, drawn from the rendered rates of `geometry`. Markers that are not there are also looked for,
on whole frames, by asking for other identities.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import product

import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.glare import conditions, dimmed
from experiments.studies.glare.frames import VARIABLES, draw, frames, labelled
from experiments.studies.glare.gallery import Worst, worst_frames
from experiments.studies.glare.geometry import at_sun, cropped, render
from experiments.studies.glare.modes import MODES, detect
from experiments.studies.glare.plan import Plan
from experiments.studies.glare.tables import summarise
from experiments.studies.shared.truth import Truth
from scenes.marker import ELEMENT_NAMES

#: Identities looked for on whole frames that do not hold them.
ABSENT_IDENTITIES = (7, 23)
#: Modes whose whole frames are searched; the other single frames differ from these by less than the frames among themselves.
WHOLE_MODES = ("single", "long", "pair", "thesis")
DIMS = ("mode", "range_m", "phase_deg", "azimuth_deg", "frame")
#: Geometries drawn or waiting at a time, so that few rendered frames are held.
_IN_FLIGHT = 8


@dataclass(frozen=True)
class GlareResult:
    """One run.

    Attributes:
        dataset: `frames.VARIABLES` and blob errors of every frame.
        summary: rates and percentiles over mode, range and phase, see `tables.summarise`.
        whole: searches of whole frames for markers that are not there.
        dimmed: poses and blobs over the intensity of dimmed LEDs.
        conditions: frames with one thing changed at a time.
        worst: the worst frame of each mode.
    """

    scenario: Scenario
    plan: Plan
    dataset: xr.Dataset
    summary: xr.Dataset
    whole: xr.Dataset
    dimmed: xr.Dataset
    conditions: xr.Dataset
    worst: list[Worst]


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None) -> GlareResult:
    """Every part of the study; `workers` processes draw the frames that this one renders."""
    dataset = over_suns(scenario, plan, progress, workers)
    whole = false_positives(scenario, plan, tuple(name for name in plan.modes if name in WHOLE_MODES))
    return GlareResult(
        scenario=scenario,
        plan=plan,
        dataset=dataset,
        summary=summarise(dataset, scenario),
        whole=whole,
        dimmed=dimmed.run(scenario, plan, progress),
        conditions=conditions.run(scenario, plan, progress),
        worst=worst_frames(dataset, scenario, plan),
    )


def over_suns(
    scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None
) -> xr.Dataset:
    """`VARIABLES` and blob errors of every mode, range, Sun and frame; arguments as `run`."""
    count = len(plan.attitudes) * plan.draws
    shape = (len(plan.modes), len(plan.ranges_m), len(plan.phases_deg), len(plan.azimuths_deg), count)
    values = np.full((len(VARIABLES), *shape), np.nan, np.float32)
    blobs = np.full((*shape, len(ELEMENT_NAMES)), np.nan, np.float32)
    waiting: deque[tuple[tuple[int, int, int, int], Future]] = deque()

    def collect() -> None:
        (s, r, p, a), future = waiting.popleft()
        part = slice(s * plan.draws, (s + 1) * plan.draws)
        values[:, :, r, p, a, part], blobs[:, r, p, a, part] = future.result()

    suns = list(plan.suns())
    with pool(draw, workers) as submit:
        for done, (s, r, p, a) in enumerate(suns):
            here = at_sun(scenario, plan.ranges_m[r], plan.phases_deg[p], plan.azimuths_deg[a], plan.attitudes[s])
            geometry = render(cropped(here), plan.modes, plan.pair_interval_s, plan.rays)
            waiting.append(((s, r, p, a), submit(geometry, plan.modes, plan.draws, (s, r, p, a))))
            while len(waiting) > _IN_FLIGHT:
                collect()
            if progress:
                progress(done + 1, len(suns), f"{plan.ranges_m[r]:g} m, phase {plan.phases_deg[p]:g}°")
        while waiting:
            collect()
    blob_attributes = {"units": "pixel", "long_name": "error of a blob along its element"}
    return xr.Dataset(
        {**labelled(values, DIMS), "blob_error_px": ((*DIMS, "element"), blobs, blob_attributes)},
        {
            "mode": list(plan.modes),
            "range_m": list(plan.ranges_m),
            "phase_deg": list(plan.phases_deg),
            "azimuth_deg": list(plan.azimuths_deg),
            "attitude": ("frame", np.arange(count) // plan.draws),
            "element": list(ELEMENT_NAMES),
            "px_per_bit": ("range_m", [_px_per_bit(scenario, plan, r) for r in plan.ranges_m]),
        },
        {
            "title": "Sun glare",
            "pair_interval_s": plan.pair_interval_s,
            **chain.provenance(scenario),
            "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis glare",
        },
    )


def _px_per_bit(scenario: Scenario, plan: Plan, range_m: float) -> float:
    """Pixels along a bit's shorter side, the least of all attitudes."""
    return min(Truth.of(at_sun(scenario, range_m, 0, 0, attitude)).px_per_bit for attitude in plan.attitudes)


def false_positives(scenario: Scenario, plan: Plan, modes: tuple[str, ...]) -> xr.Dataset:
    """Markers found on whole frames that do not hold them: (mode, phase_deg) counts and the searches made.

    Every frame is searched for each of `ABSENT_IDENTITIES`: `found` counts those found with corners, `remarked` those searches
    that give another identity than the marker's own as a reason, without corners.
    """
    found, remarked = np.zeros((2, len(modes), len(plan.phases_deg)), int)
    for (p, phase), (a, azimuth) in product(enumerate(plan.phases_deg), enumerate(plan.whole_azimuths_deg)):
        attitude = plan.attitudes[(p + a) % len(plan.attitudes)]
        here = at_sun(scenario, plan.whole_range_m, phase, azimuth, attitude)
        geometry = render(here, modes, plan.pair_interval_s, 4 * here.camera.width_px * here.camera.height_px)
        truth = Truth.of(here)
        absent = [
            here.model_copy(update={"marker": here.marker.model_copy(update={"identity": k})})
            for k in ABSENT_IDENTITIES
        ]
        for m, name in enumerate(modes):
            for frame in frames(geometry, truth, name, 1, (99, p, a)):
                for other in absent:
                    features = detect(other, MODES[name], frame.image).features
                    found[m, p] += features.detected
                    remarked[m, p] += not features.detected and features.identity not in (None, here.marker.identity)
    searches = len(plan.whole_azimuths_deg) * len(ABSENT_IDENTITIES)
    return xr.Dataset(
        {
            "found": (("mode", "phase_deg"), found),
            "remarked": (("mode", "phase_deg"), remarked),
            "searches": (("mode", "phase_deg"), np.full(found.shape, searches)),
        },
        {"mode": list(modes), "phase_deg": list(plan.phases_deg)},
    )
