"""A small budget made from round figures, without rendering; and a check of the figures of every page that a test writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from drawn import check_figure

from detector.features import Features
from experiments import chain
from experiments.reporting.page import Page
from experiments.scenario import Scenario
from experiments.studies.budget import study as budget
from experiments.studies.budget.study import BudgetResult, Snapshot
from radiometry import link

MakeBudget = Callable[..., BudgetResult]


@pytest.fixture(scope="session", autouse=True)
def _figures_of_every_page_are_drawn() -> Iterator[None]:
    """Every page that a test writes has its figures checked, whichever study it is of."""
    write = Page.write

    def checked(page: Page, out: Path) -> None:
        for plot in page.plots():
            check_figure(plot.figure, f"{page.name}-{plot.key}")
        write(page, out)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Page, "write", checked)
        yield


@pytest.fixture(scope="session")
def make_budget() -> MakeBudget:
    """A function of scenario sections, the share of frames in which the marker is found, and an attitude error."""
    return _make


def _make(*, found: float = 1.0, attitude_deg: float = 0.1, **sections: Any) -> BudgetResult:
    """Bits give 10¹⁰ e⁻/s at 1 m, falling with range squared, dark cells a hundredth; the Sun adds 10⁷ e⁻/s to both."""
    plan = {"ranges_m": (1.0, 2.0, 4.0), "exposures_s": (1e-3, "auto"), "trials": 8, **sections.pop("budget", {})}
    camera = {"width_px": 160, "height_px": 120, "focal_length_m": 6.88e-3, **sections.pop("camera", {})}
    scenario = Scenario.model_validate({"budget": plan, "camera": camera, **sections})
    plan = scenario.budget
    shape = (len(plan.ranges_m), len(plan.illuminations), len(plan.exposures_s))
    values = {name: np.zeros(shape) for name in budget.VARIABLES}
    for i, j, k in np.ndindex(shape):
        range_m, illumination, exposure = plan.ranges_m[i], plan.illuminations[j], plan.exposures_s[k]
        sun = 1e7 if illumination == "sunlit" else 0.0
        rates = chain.LinkBudget(
            sensor=scenario.sensor,
            signal_rate=1e10 / range_m**2 + sun,
            background_rate=1e8 / range_m**2 + sun,
            tape_rate=0.0,
            px_per_bit=0.0,
            smear_px_per_s=50.0,
            fill=1.0,
        )
        seconds = chain.solve_exposure(scenario, rates, exposure)
        charge = rates.at(seconds)
        for name in ("signal", "background", "snr", "cnr"):
            values[f"{name}_analytic"][i, j, k] = charge[name]
            for kind in ("expected", "rendered"):
                if f"{name}_{kind}" in values:
                    values[f"{name}_{kind}"][i, j, k] = charge[name] if charge["full_well_fraction"] < 1 else np.nan
        values["exposure_s"][i, j, k] = seconds
        values["full_well_fraction"][i, j, k] = charge["full_well_fraction"]
        values["smear_px"][i, j, k] = float(link.smear_px(scenario.camera, range_m, 0.05, seconds))
    values["snr_rendered_ci95"] += 2.0
    values["cnr_rendered_ci95"] += 2.0
    values["detected_fraction"] += found
    values["attitude_error_p95_deg"] += attitude_deg if found else np.nan
    values["range_error_p95"] += 0.001 if found else np.nan
    dims = ("range_m", "illumination", "exposure")
    data: dict[str, Any] = {n: (dims, v, {"units": budget.VARIABLES[n][0]}) for n, v in values.items()}
    trials = (*shape, plan.trials)
    data["detected"] = ((*dims, "trial"), np.broadcast_to(np.arange(plan.trials) < found * plan.trials, trials))
    data["attitude_error_deg"] = ((*dims, "trial"), np.full(trials, attitude_deg if found else np.nan))
    data["range_error"] = ((*dims, "trial"), np.full(trials, 0.001 if found else np.nan))
    scale = scenario.camera.focal_length_m / scenario.camera.pixel_pitch_x_m
    data["px_per_bit"] = (("range_m",), scenario.marker.bit_m * scale / np.array(plan.ranges_m), {"units": "pixel"})
    labels = [budget.exposure_label(e) for e in plan.exposures_s]
    coordinates = {"range_m": list(plan.ranges_m), "illumination": list(plan.illuminations), "exposure": labels}
    attributes = {
        "software": "mantis-radiometry 0",
        "versions": "numpy 2",
        "history": "2026-01-01T00:00Z mantis budget",
        "scenario_hash": scenario.digest(),
    }
    # The private function is what puts margins into every real dataset; a copy of it here would test nothing.
    dataset = budget._judged(scenario, xr.Dataset(data, coordinates, attributes))
    snapshots = [
        Snapshot(r, illumination, 1e-6, _frame(), _features(found > 0))
        for r in plan.ranges_m
        for illumination in plan.illuminations
    ]
    return BudgetResult(scenario, dataset, snapshots)


def _frame() -> np.ndarray:
    return np.random.default_rng(1).integers(60, 4000, (120, 160)).astype(np.uint16)


def _features(found: bool) -> Features:
    names = ("top", "right", "bottom", "left")
    if not found:
        return Features(
            identity=None,
            corners_px=None,
            corners_covariance_px2=None,
            blobs_px=dict.fromkeys(names),
            blob_sigma_px={},
            virtual_points_px={},
            reason="no marker found",
        )
    corners = np.array([[70.0, 50.0], [90.0, 50.0], [90.0, 70.0], [70.0, 70.0]])
    blobs = dict(
        zip(names, [np.array([82.0, 45.0]), None, np.array([78.0, 75.0]), np.array([65.0, 62.0])], strict=True)
    )
    virtual = {"top_left": np.array([82.0, 62.0])}
    return Features(
        identity=0,
        corners_px=corners,
        corners_covariance_px2=np.zeros((4, 2, 2)),
        blobs_px=blobs,
        blob_sigma_px={},
        virtual_points_px=virtual,
        reason="right blob: light is no blob",
    )
