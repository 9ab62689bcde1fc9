"""Frames of the glare study with each failure mode of thesis section 8.3, for every mode of the study, range and phase angle."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import xarray as xr

from experiments.scenario import Scenario
from experiments.studies.glare.geometry import at_sun
from experiments.studies.glare.plan import Attitude
from experiments.studies.shared import failures
from experiments.studies.shared.judge import WRONG_CORNER
from experiments.studies.shared.truth import Truth
from scenes.marker import ELEMENT_NAMES

HEADINGS = ("mode", "range [m]", "phase [°]", "frames", *failures.HEADINGS)


def failure_rows(dataset: xr.Dataset, scenario: Scenario, attitudes: Sequence[Attitude]) -> list[tuple[str, ...]]:
    """`HEADINGS`, then one row a mode, range and phase; azimuths and attitudes pooled."""
    rows: list[tuple[str, ...]] = [HEADINGS]
    there = {
        float(r): np.array(
            [[name in _blobs(scenario, float(r), attitude) for name in ELEMENT_NAMES] for attitude in attitudes]
        )
        for r in dataset.range_m.values
    }
    for mode, range_m, phase in product(dataset.mode.values, dataset.range_m.values, dataset.phase_deg.values):
        here = dataset.sel(mode=mode, range_m=range_m, phase_deg=phase).transpose("azimuth_deg", "frame", ...)
        found = here.detected.values > 0
        blobs = np.isfinite(here.blob_error_px.values)
        top, right, bottom, left = np.moveaxis(blobs, -1, 0)
        side_px = scenario.marker.aruco_m * max(scenario.camera.focal_px) / float(range_m)
        failed = {
            "loss_of_aruco": ~found,
            "false_positive": here.false_positive.values > 0,
            "loss_of_elements": found & ~((top | bottom) & (right | left)),
            "wrong_corners": found & (here.corner_error_max_px.values > WRONG_CORNER * side_px),
            "no_blob": found & (there[float(range_m)][here.attitude.values] & ~blobs).any(axis=-1),
        }
        told = failures.cells(failed, here.attitude_error_deg.values, here.range_error.values)
        rows.append((str(mode), f"{range_m:g}", f"{phase:g}", str(found.size), *told))
    return rows


def _blobs(scenario: Scenario, range_m: float, attitude: Attitude) -> frozenset[str]:
    """Elements in whose opening the blob stands."""
    here = at_sun(scenario, range_m, 0.0, 0.0, attitude)
    return Truth.of(here).blobs_in_openings
