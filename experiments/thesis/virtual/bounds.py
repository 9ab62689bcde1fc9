"""Cramér–Rao bounds of pitch and range for the virtual experiment's frames, from the image model and not from a detector."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr

from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.features.accuracy import bounds_of
from experiments.studies.shared.frames import Case
from experiments.thesis.virtual.targets import Run, cropped, design, exposure_s
from scenes.marker import MarkerDesign

PITCHES_DEG = (-40.0, -20.0, 0.0, 20.0, 40.0)
RANGES_M = (1.3, 2.3, 3.3)


def bounds(
    scenario: Scenario,
    target: str = "improved",
    ranges_m: Iterable[float] = RANGES_M,
    pitches_deg: Iterable[float] = PITCHES_DEG,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Smallest standard deviations of pitch [deg] and range [m] over range_m and pitch_deg, at the experiment's exposures."""
    ranges, pitches = list(ranges_m), list(pitches_deg)
    values = np.zeros((2, len(ranges), len(pitches)))
    marker = design(scenario, target)
    assert isinstance(marker, MarkerDesign)
    for i, j in np.ndindex(values.shape[1:]):
        run = Run(0, target, ranges[i], "pitch", (pitches[j],))
        if progress is not None:
            progress(i * len(pitches) + j, len(ranges) * len(pitches), f"bound at {ranges[i]:g} m")
        tilted = {**scenario.target.model_dump(), "pitch_deg": pitches[j], "yaw_deg": 0.0}
        here = scenario.at(
            range_m=ranges[i],
            marker=marker.model_dump(),
            target=tilted,
            exposure_s=exposure_s(scenario, run),
            camera=cropped(scenario, run).camera.model_dump(),
        )
        pose = bounds_of(Case.of(here), "eclipse")["pose"]
        # The marker's x axis is the camera's while there is no yaw; range along the line of sight.
        values[:, i, j] = np.degrees(pose[0]), pose[5]
    dims = ("range_m", "pitch_deg")
    data = {
        "pitch_bound_deg": (dims, values[0], {"units": "degree", "long_name": "Cramér–Rao bound of the pitch"}),
        "range_bound_m": (dims, values[1], {"units": "m", "long_name": "Cramér–Rao bound of the range"}),
    }
    coordinates = {
        "range_m": ("range_m", ranges, {"units": "m"}),
        "pitch_deg": ("pitch_deg", pitches, {"units": "degree"}),
    }
    return xr.Dataset(data, coordinates, {"target": target})
