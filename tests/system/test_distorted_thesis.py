"""Every study that detects, with a camera whose lens distorts: errors are those of a camera without distortion.

A study that gives a distorted image to a function below `detector.detect` is off by far more than noise, without a word.
"""

from __future__ import annotations

import numpy as np

from experiments.scenario import Scenario, load_scenario

#: Barrel distortion, strong enough that straight lines of the marker bend by pixels.
DISTORTION = "camera.k1=-0.2"


def scenarios(*overrides: str) -> tuple[Scenario, Scenario]:
    """A scenario without distortion, and the same with it."""
    return load_scenario(overrides=overrides), load_scenario(overrides=(*overrides, DISTORTION))


def test_layout() -> None:
    """Rationale for the bounds: without rectification the errors are 0.12° and 15 mm; with it 0.001° and 0.04 mm."""
    from experiments.thesis.layout.plan import Plan, RenderedCase
    from experiments.thesis.layout.study import rendered

    cases = (RenderedCase("wide", 1.0, (5.0,)),)
    plan = Plan(faces_m=(1.0,), ranges_m=(1.0,), attitudes=2, cases=cases, poses=1, draws=3, rays=60_000)
    straight, distorted = (rendered(s, plan, np.random.default_rng(4)) for s in scenarios())
    assert distorted.found.min() >= straight.found.min()
    for errors in (straight, distorted):
        every = errors.sel(solver="all markers")
        assert every.attitude_deg.median() < 0.004
        assert every.range_error_m.median() < 2e-4
        assert every.lateral_error_m.median() < 2e-5


def test_fov() -> None:
    """Frontal and tilted frames of the cropped detector, whose axis is the lens's own."""
    from experiments.thesis.fov.plan import Plan
    from experiments.thesis.fov.study import map_of

    plan = Plan((2.0,), (-30.0, 0.0), 1, (0.0,), 200_000)
    straight, distorted = (map_of(s, plan) for s in scenarios())
    for found in (straight, distorted):
        assert found.corners.values.all()
        assert found.pose.values.all()
        assert found.attitude_deg.max() < 0.3
    assert (distorted.blob.sum("element") >= straight.blob.sum("element") - 1).all()


def test_virtual() -> None:
    """A lens of 7.4° across needs a larger coefficient to bend as much: a range that ignores it is off by millimetres."""
    from experiments.studies.shared.judge import VARIABLES
    from experiments.thesis.virtual import targets
    from experiments.thesis.virtual.study import judged_frames

    planned = [targets.Run(0, target, 1.3, "pitch", (-20.0, 12.0)) for target in ("improved", "aruco", "svms")]
    for overrides in ((), ("camera.k1=-20",)):
        frames = judged_frames(targets.load(overrides), planned, workers=1)
        assert set(VARIABLES) <= set(frames.data_vars)
        best = frames.isel(series=np.flatnonzero(np.isin(frames.method.values, ["mantis", "aruco", "svms"])))
        assert best.found.values.all()
        assert np.abs(best.pitch_error_deg).max() < 0.2
        assert np.abs(best.range_error_m).max() < 5e-4


def test_physical() -> None:
    """The camera is calibrated with its distortion from rendered chessboards, and frames are rectified by that calibration."""
    from experiments.thesis.physical import arm
    from experiments.thesis.physical.plan import Plan
    from experiments.thesis.physical.study import run

    plan = Plan(passes=1, steps=3, binning=16, boards=4, sharpness_px=(2.0,))
    frames = run(arm.load(("camera.k1=-0.2",)), plan, workers=1).frames
    own = frames.sel(by="mantis", illumination="eclipse")
    assert own.found.values.all()
    # As with the laboratory's own lens, which distorts a quarter as much.
    assert np.abs(own.yaw_error_deg).max() < 0.3
    assert np.abs(own.range_error_m / own.range_m).max() < 0.005


def test_comparison() -> None:
    """Its frames are the virtual experiment's; statistics of a frontal and a tilted marker stay what they are."""
    from experiments.thesis.comparison.plan import Plan
    from experiments.thesis.comparison.study import run
    from experiments.thesis.virtual.targets import load

    plan = Plan(ranges_m=(1.3,), tilts_deg=(0.0, 30.0), frames=2)
    found = run(load(("camera.k1=-20",)), plan, workers=1).data
    assert (found.posed.sel(marker=["mantis", "aruco", "svms"]) == 1).all()
    assert found.median_deg.sel(marker="mantis").max() < 0.2
