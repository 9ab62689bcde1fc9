"""A distorted lens costs no study its accuracy: whoever detects, undistorts.

Each study runs small, once with an ideal lens and once with a strong barrel; the marker fills the frame of a short lens, where
uncorrected distortion would move its corners by half a pixel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.scenario import Scenario, load_scenario

DISTORTED = ("camera.k1=-0.2",)
#: A 10 cm marker at 0.25 m is 140 px wide.
WIDE = (
    "range_m=0.25",
    "camera.focal_length_m=0.003",
    "camera.width_px=180",
    "camera.height_px=180",
    "render.marker_rays=200_000",
    "budget.ranges_m=[0.25]",
    "budget.trials=4",
    'budget.exposures_s=["auto"]',
    'budget.illuminations=["eclipse"]',
)


@pytest.fixture(params=[(), DISTORTED], ids=["ideal", "distorted"])
def lens(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """Changes to the scenario's camera."""
    return tuple(request.param)


def wide(lens: tuple[str, ...]) -> Scenario:
    return load_scenario(None, (*WIDE, *lens))


def test_distortion_would_be_seen() -> None:
    camera = wide(DISTORTED).camera
    corner = np.array([[0.04, 0.04, 0.25]])
    moved = camera.project(corner) - camera.without_distortion.project(corner)
    assert np.linalg.norm(moved) > 0.5


# Budget


def test_budget_measures_the_pose_through_a_distorted_lens(lens: tuple[str, ...]) -> None:
    from experiments.studies.budget import study

    dataset = study.run(wide(lens), workers=1).dataset
    assert (dataset.detected_fraction == 1).all()
    assert float(dataset.attitude_error_p95_deg.max()) < 0.1
    assert float(dataset.range_error_p95.max()) < 1e-3


# Sweep


@pytest.mark.parametrize("window", ["", "window = 1.5"], ids=["whole frame", "window"])
def test_sweep_measures_the_pose_through_a_distorted_lens(lens: tuple[str, ...], window: str, tmp_path: Path) -> None:
    from experiments.studies.sweep import study

    path = tmp_path / "sweep.toml"
    path.write_text(f'trials = 4\n{window}\n[grid]\nillumination = ["eclipse", "sunlit"]\n')
    sweep = study.load_sweep(
        path, (*(change for change in WIDE if "budget" not in change), "camera.width_px=240", *lens)
    )
    dataset = study.run_sweep(sweep, tmp_path / "out.nc").dataset
    assert (dataset.detected_fraction == 1).all()
    assert float(dataset.attitude_error_p95_deg.max()) < 0.1
    assert float(dataset.range_error_p95.max()) < 1e-3
