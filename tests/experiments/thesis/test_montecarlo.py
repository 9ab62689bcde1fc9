"""The Monte Carlo study: its scenes against geometry, its statistics against closed forms, its findings with intervals."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from detector.pnp import pnp
from experiments.chain.statistics import wilson_interval
from experiments.thesis.montecarlo import scenes as pose_scenes
from experiments.thesis.montecarlo import study as montecarlo
from experiments.thesis.montecarlo.errors import Errors
from experiments.thesis.montecarlo.page import page
from experiments.thesis.montecarlo.plan import QUICK
from experiments.thesis.montecarlo.tables import outlier_rows
from radiometry.geometry import attitude_matrix, faces_camera, rotation_angle
from radiometry.optics import Camera

CAMERA = Camera()


def scenes_of(
    order: pose_scenes.AngleOrder, count: int = 400, range_m: float = 10.0, seed: int = 1
) -> pose_scenes.Scenes:
    layout = pose_scenes.marker_layout("wide")
    return pose_scenes.make_scenes(layout, np.full(count, range_m), CAMERA, np.random.default_rng(seed), order=order)


def test_every_scene_as_meant_shows_the_face() -> None:
    scenes = scenes_of("intended")
    assert not scenes.shows_back.any()
    assert all(faces_camera(r, t) for r, t in zip(scenes.rotation, scenes.translation_m, strict=True))


def test_listing_order_shows_the_back_in_half_the_scenes() -> None:
    scenes = scenes_of("listing", 2000)
    low, high = binom(2000, 0.5).interval(0.999)
    assert low <= scenes.shows_back.sum() <= high


@given(st.floats(-0.78, 0.78), st.floats(-0.78, 0.78), st.floats(-3.1, 3.1))
@settings(deadline=None, derandomize=True, max_examples=50)
def test_angles_invert_rotations_in_both_orders(pitch: float, yaw: float, roll: float) -> None:
    drawn = np.array([[pitch, yaw, roll]])
    for order in ("intended", "listing"):
        assert pose_scenes.angles(pose_scenes.rotations(drawn, order), order) == pytest.approx(drawn, abs=1e-9)
    assert pose_scenes.rotations(drawn, "intended")[0] == pytest.approx(attitude_matrix(pitch, yaw, roll))


def test_pitch_of_the_listing_turns_the_face_in_its_own_plane() -> None:
    turned = pose_scenes.rotations(np.array([[0.4, 0.2, 0.3], [-0.4, 0.2, 0.3]]), "listing")
    assert turned[0][:, 2] == pytest.approx(turned[1][:, 2])
    assert rotation_angle(turned[0], turned[1]) == pytest.approx(0.8)


def test_projection_noise_has_the_law_of_the_scene() -> None:
    quiet = pose_scenes.make_scenes(
        pose_scenes.marker_layout("wide"),
        np.full(200, 15.0),
        CAMERA,
        np.random.default_rng(2),
        pose_scenes.noise_constant(0.0),
    )
    loud = pose_scenes.make_scenes(
        pose_scenes.marker_layout("wide"),
        np.full(200, 15.0),
        CAMERA,
        np.random.default_rng(2),
        pose_scenes.noise_constant(0.3),
    )
    shift = (loud.pixels - quiet.pixels) / 0.3
    low, high = chi2(shift.size).ppf([0.0005, 0.9995])
    assert low < np.sum(shift**2) < high


@pytest.mark.parametrize(
    ("law", "at_20_m"),
    [(pose_scenes.noise_listing, 0.1032), (pose_scenes.noise_text, 32.1), (pose_scenes.noise_constant(0.2), 0.2)],
)
def test_noise_laws(law: pose_scenes.NoiseLaw, at_20_m: float) -> None:
    assert law(np.array([20.0]), np.zeros(3, bool)) == pytest.approx(np.full((1, 3), at_20_m))


def test_noise_law_of_one_s_own_may_tell_virtual_points_apart_and_drop_features() -> None:
    def law(range_m: np.ndarray, virtual: np.ndarray) -> np.ndarray:
        return np.where(virtual, 0.5, np.where(range_m > 5, np.nan, 0.1)[:, None])

    scenes = pose_scenes.make_scenes(
        pose_scenes.marker_layout("wide"), np.array([2.0, 10.0]), CAMERA, np.random.default_rng(3), law
    )
    assert scenes.visible[1].sum() == 12  # the virtual points alone
    table = montecarlo.performance(
        CAMERA,
        [10.0],
        5,
        np.random.default_rng(3),
        recipes=("right",),
        layouts=("wide",),
        solvers=("two-start",),
        noise=law,
    )
    assert float(table.outliers.squeeze()) == 0


def test_layouts_are_the_thesis_s() -> None:
    wide, flat, listed = (pose_scenes.marker_layout("wide", flat=f, as_listed=a) for f, a in ((0, 0), (1, 0), (1, 1)))
    assert len(wide.points_m) == 44
    assert wide.virtual.sum() == 12
    assert np.all(wide.points_m[wide.virtual, 2] < 0)
    assert np.ptp(flat.points_m[:, 2]) == 0
    assert np.abs(wide.points_m[:, :2]).max() == pytest.approx(0.425)
    assert wide.points_m[:, :2].mean(axis=0) == pytest.approx([0, 0], abs=1e-12)
    assert listed.points_m[:, :2].mean(axis=0) == pytest.approx([0.1 * 6 / 44, 0.025 * 6 / 44])


def test_random_points_keep_their_distance_and_enough_of_them_are_seen() -> None:
    layout = pose_scenes.random_layout()
    scenes = pose_scenes.make_scenes(layout, np.full(300, 1.0), CAMERA, np.random.default_rng(4))
    gap = np.linalg.norm(scenes.points_m[:, :, None] - scenes.points_m[:, None], axis=-1) + np.eye(8)
    assert gap.min() >= 0.01
    assert scenes.visible.sum(axis=1).min() >= 6
    assert not scenes.visible.all()


@pytest.mark.parametrize(("count", "total"), [(0, 30), (1, 100), (47, 100), (1500, 1500)])
def test_wilson_interval_solves_its_defining_equation(count: int, total: int) -> None:
    for bound in wilson_interval(count, total):
        if 1e-9 < bound < 1 - 1e-9:
            assert abs(count / total - bound) == pytest.approx(1.959964 * np.sqrt(bound * (1 - bound) / total))


def test_listing_overlooks_a_pose_turned_about_the_normal_and_folds_its_error_away() -> None:
    scenes = scenes_of("listing", 50)
    turned = scenes.rotation @ np.diag([-1.0, -1.0, 1.0])
    errors = Errors.of(scenes, (turned, scenes.translation_m))
    assert errors.outliers("geodesic").all()
    assert not errors.outliers("listing").any()
    assert errors.absolute["pitch"] == pytest.approx(np.full(50, 180.0), abs=1e-6)
    assert errors.folded().absolute["pitch"] == pytest.approx(np.zeros(50), abs=1e-6)


def test_lost_poses_are_outliers() -> None:
    scenes = scenes_of("intended", 5)
    errors = Errors.of(scenes, (np.full((5, 3, 3), np.nan), np.full((5, 3), np.nan)))
    assert errors.unsolved.all()
    assert errors.outliers("listing").all()
    assert errors.outliers("geodesic").all()


@pytest.fixture(scope="module")
def flat() -> xr.Dataset:
    return montecarlo.performance(CAMERA, [5.0, 20.0], 300, np.random.default_rng(5), layouts=("flat",))


def test_as_listed_half_of_the_flat_scenes_are_outliers_and_nearly_all_are_wrong(flat: xr.Dataset) -> None:
    # The thesis prints 47 %. The full run gives 50.3 % [49.7, 50.9]: near, but not within the interval (docs/montecarlo.md).
    at = flat.sel(recipe="listing", solver="thesis EPnP", layout="flat").sum("range_m")
    low, high = wilson_interval(float(at.outliers), float(at.scenes), 0.999)
    assert low < 0.503 < high
    assert wilson_interval(float(at.wrong), float(at.scenes), 0.999)[0] > 0.9


def test_without_gauss_newton_the_side_seen_decides(flat: xr.Dataset) -> None:
    at = flat.sel(recipe="order", solver="closed", layout="flat").sum("range_m")
    front = float(at.scenes - at.scenes_back)
    assert wilson_interval(float(at.wrong - at.wrong_back), front, 0.999)[1] < 0.12
    assert wilson_interval(float(at.wrong_back), float(at.scenes_back), 0.999)[0] > 0.88


@pytest.mark.parametrize("solver", ["SQPnP", "IPPE + LM", "two-start"])
def test_planar_aware_solvers_have_no_outliers_on_the_same_scenes(flat: xr.Dataset, solver: str) -> None:
    assert float(flat.wrong.sel(solver=solver).sum()) == 0


def test_mean_error_of_two_start_is_that_of_its_covariance() -> None:
    scenes = scenes_of("intended", 600, seed=6)
    poses = pnp.two_start(scenes.points_m, scenes.pixels, scenes.visible, CAMERA)
    errors = Errors.of(scenes, poses)
    sigma = np.sqrt(pnp.covariance(scenes.points_m, scenes.sigma_px[:, 0], scenes.visible, CAMERA, poses)[:, 5, 5])
    # Half-normal: mean √(2/π) σ; its own standard deviation √(1 − 2/π) σ gives the interval, at four of them.
    expected, spread = np.sqrt(2 / np.pi) * sigma.mean(), np.sqrt((1 - 2 / np.pi) * np.mean(sigma**2) / len(sigma))
    assert abs(errors.absolute["range"].mean() - expected) < 4 * spread


def test_one_virtual_point_ends_the_ambiguity_of_a_single_marker() -> None:
    table = montecarlo.single(CAMERA, np.random.default_rng(7), 100)
    at = table.sel(sigma_px=0.1, range_m=10.0)
    assert wilson_interval(float(at.wrong.sel(virtual_points=0)), 100, 0.999)[0] > 0.2
    assert float(at.wrong.sel(virtual_points=1)) == 0


def test_unknown_layout_is_refused() -> None:
    with pytest.raises(ValueError, match="'round' is unknown"):
        montecarlo.RECIPES["right"].layout("round")
    with pytest.raises(ValueError, match="expected 0, 1 or 4"):
        pose_scenes.single_marker(0.1, 3)


@pytest.mark.slow
def test_quick_run_writes_everything_and_repeats_itself(tmp_path: Path) -> None:
    tree = montecarlo.run(montecarlo.load(seed=3), QUICK)
    assert set(tree.children) == {"performance", "convergence", "far", "noise", "tried", "single"}
    made = page(tree, "mantis montecarlo --quick --seed 3")
    made.write(tmp_path / "a")
    written = {path.name for path in (tmp_path / "a").rglob("*")}
    assert {"montecarlo.nc", "montecarlo-outliers.csv", "montecarlo-flat.svg", "montecarlo-convergence.svg"} <= written
    assert "Seed 3; the same input and seed give the same figures." in made.html()
    rows = outlier_rows(tree["performance"].to_dataset())
    assert all(len(row) == len(rows[0]) for row in rows)
    again = montecarlo.performance(CAMERA, [1.0, 5.0, 10.0, 20.0], 30, np.random.default_rng(3).spawn(6)[0])
    xr.testing.assert_identical(again.drop_vars("seconds"), tree["performance"].to_dataset().drop_vars("seconds"))
