"""Every study that detects, with a camera whose lens distorts: errors are those of a camera without distortion.

A study that gives a distorted image to a function below `detector.detect` is off by far more than noise, without a word.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from experiments.scenario import load_scenario

#: Barrel distortion that moves the corners of a marker at 1 m by half a pixel, its range by half a percent.
STRONG_DISTORTION = "camera.k1=-2"


def test_glare() -> None:
    """Single frames, pairs and the thesis's pipeline on 8 bits, cropped about the axis, which is the lens's own.

    Rationale for the bounds: a pose that ignores the distortion is off by 0.26 % of the range.
    """
    from experiments.studies.glare.plan import QUICK
    from experiments.studies.glare.study import over_suns

    plan = replace(
        QUICK,
        ranges_m=(1.0,),
        phases_deg=(45.0,),
        azimuths_deg=(60.0,),
        draws=2,
        modes=("single", "pair", "thesis"),
        rays=400_000,
    )
    for overrides in ((), (STRONG_DISTORTION,)):
        frames = over_suns(load_scenario(overrides=overrides), plan, workers=0)
        assert frames.detected.values.all()
        ours, thesis = frames.sel(mode=["single", "pair"]), frames.sel(mode="thesis")
        assert ours.attitude_error_deg.max() < 0.1
        assert ours.range_error.max() < 4e-4
        assert ours.corner_error_max_px.max() < 0.04  # two draws of two modes, the blur measured and not told
        assert thesis.range_error.max() < 1.3e-3


def test_features() -> None:
    """Errors of corners, blobs and pose about the truth that the distorted lens shows.

    Rationale for the bounds: without rectification a corner is off by 0.04 px, the range by 2.7 mm.
    """
    from experiments.studies.features.accuracy import ShiftedFrames, measure
    from experiments.studies.shared.frames import Case

    tilted = ("range_m=1", "target.pitch_deg=20", "target.yaw_deg=3")
    shifts = np.array([[0.1, -0.3], [-0.4, 0.2]])
    for overrides in (tilted, (*tilted, STRONG_DISTORTION)):
        case = Case.of(load_scenario(overrides=overrides))
        errors = measure(ShiftedFrames.of(case, shifts), 3, seed=5)
        assert np.isfinite(errors.corners).all()
        assert np.abs(errors.corners.mean(axis=(0, 1))).max() < 0.02
        assert np.nanmax(np.abs(np.nanmean(errors.blobs, axis=(0, 1)))) < 0.05
        assert np.degrees(np.linalg.norm(errors.pose[..., :3].mean(axis=(0, 1)))) < 0.03
        assert abs(errors.pose[..., 5].mean()) < 2e-4


def test_detection_counts() -> None:
    """A marker is found at its place in the distorted image."""
    from experiments.studies.features.detection import Series, count_found, settings_of

    at_rest, no_shift = np.zeros((1, 3)), np.zeros((1, 1, 2))
    for overrides in ((), (STRONG_DISTORTION,)):
        scenario = load_scenario(overrides=overrides)
        [setting] = settings_of(scenario, Series("ArUco 4×4", 20.0, None), at_rest, no_shift, draws=2, seed=1)
        assert count_found(setting)["Mantis"].tolist() == [2]


def test_close() -> None:
    """Confirmation of a proposed set."""
    from experiments.studies.close.confirm import confirm
    from experiments.studies.close.constraints import ConfirmView, load_problem
    from experiments.studies.close.search import Point

    for overrides in ((), (STRONG_DISTORTION,)):
        problem = load_problem(overrides=overrides)
        base = problem.base
        point = Point(
            tape=base.target.tape_material,
            size_m=0.1,
            focal_length_m=0.0425,
            f_number=5.0,
            led_count=50,
            fewest_leds=50,
            margins={},
            binding=("", 0.0),
            energy_j=0.0,
            power_w=0.0,
            peak_power_w=0.0,
        )
        view = ConfirmView(ranges_m=(2.0,))
        confirmation = problem.constraints.confirm.model_copy(update={"views": (view,), "trials": 2})
        constraints = problem.constraints.model_copy(update={"confirm": confirmation})
        for record in confirm(((point, base),), constraints, workers=0):
            assert record["detected_fraction"] == 1.0
            assert record["attitude_error_p95_deg"] < 0.05
            assert (
                record["range_error_p95"] < 1.2e-3
            )  # the disc of the defocus is fitted as a Gaussian; without rectification it is 2.6e-3
