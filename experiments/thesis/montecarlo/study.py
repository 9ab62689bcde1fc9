"""Monte Carlo study of pose accuracy, precision and outliers over range (thesis 3.7 and 8.4, listing A.4).

Three recipes say what is simulated and what is counted:

'listing'  as coded: its angle order, two misplaced central markers, the image's rows and columns exchanged, its outliers.
'order'    as meant, but for the angle order.
'right'    as meant: every scene shows the face; an outlier is an attitude off by more than 10° or a range by more than 5 %.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from detector.pnp import pnp
from detector.pnp.dls import dls
from detector.pnp.epnp import BoolArray, Poses, epnp, epnp_as_used
from detector.pnp.posit import posit, softposit
from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario, load_scenario
from experiments.thesis.montecarlo.errors import QUANTITIES, Criterion, Errors, summary
from experiments.thesis.montecarlo.plan import FULL, Plan
from experiments.thesis.montecarlo.scenes import (
    FEWEST_POINTS,
    AngleOrder,
    Layout,
    NoiseLaw,
    Scenes,
    make_scenes,
    marker_layout,
    noise_constant,
    noise_listing,
    noise_text,
    random_layout,
    single_marker,
)
from radiometry.geometry import FRONTAL, FloatArray
from radiometry.optics import Camera

LAYOUTS = ("random", "wide", "narrow", "flat")


def _thesis_epnp(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    """The thesis's routine in the thesis's frame, z into the face: its result depends on it."""
    rotation, translation = epnp_as_used(points_m @ FRONTAL, pixels, visible, camera)
    return rotation @ FRONTAL, translation


def _thesis_epnp_closed(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
    rotation, translation = epnp_as_used(points_m @ FRONTAL, pixels, visible, camera, gauss_newton=False)
    return rotation @ FRONTAL, translation


#: 'thesis EPnP' is `epnp_as_used`, 'closed' the same without Gauss-Newton, 'EPnP' the paper's with Gauss-Newton.
SOLVERS: Mapping[str, pnp.Solver] = {
    "thesis EPnP": _thesis_epnp,
    "closed": _thesis_epnp_closed,
    "EPnP": epnp,
    "SQPnP": pnp.sqpnp,
    "IPPE + LM": pnp.ippe_refined,
    "two-start": pnp.two_start,
}
#: Solvers for coplanar points alone.
_PLANAR_ONLY = ("IPPE + LM",)


@dataclass(frozen=True)
class Recipe:
    """What a run simulates and counts."""

    order: AngleOrder
    as_listed: bool
    criterion: Criterion

    def layout(self, name: str) -> Layout:
        """The named layout of `LAYOUTS`."""
        if name == "random":
            return random_layout()
        if name not in LAYOUTS:
            raise ValueError(f"layout: {name!r} is unknown; expected one of {', '.join(LAYOUTS)}")
        return marker_layout("narrow" if name == "narrow" else "wide", flat=name == "flat", as_listed=self.as_listed)


RECIPES: Mapping[str, Recipe] = {
    "listing": Recipe("listing", True, "listing"),
    "order": Recipe("listing", False, "geodesic"),
    "right": Recipe("intended", False, "geodesic"),
}


def _solve(solver: pnp.Solver, scenes: Scenes, camera: Camera) -> Poses:
    """Poses of the scenes with enough points in view; NaN for the others."""
    enough = scenes.visible.sum(axis=1) >= FEWEST_POINTS
    rotation, translation = np.full_like(scenes.rotation, np.nan), np.full_like(scenes.translation_m, np.nan)
    if enough.any():
        chosen = scenes.points_m[enough], scenes.pixels[enough], scenes.visible[enough]
        rotation[enough], translation[enough] = solver(*chosen, camera)
    return rotation, translation


_COUNTS = {
    "scenes": "scenes simulated",
    "scenes_back": "scenes that show the back of the face",
    "outliers": "outliers by the recipe's criterion",
    "outliers_back": "outliers among the scenes that show the back",
    "wrong": "attitude off by more than 10 deg or range by more than 5 %",
    "wrong_back": "the same among the scenes that show the back",
    "unsolved": "scenes without a pose, counted among the outliers",
}


def performance(
    camera: Camera,
    ranges_m: Iterable[float],
    per_range: int,
    rng: np.random.Generator,
    recipes: Iterable[str] = tuple(RECIPES),
    layouts: Iterable[str] = LAYOUTS,
    solvers: Iterable[str] = tuple(SOLVERS),
    noise: NoiseLaw = noise_listing,
) -> xr.Dataset:
    """Accuracy, precision and outliers: every solver on the same scenes; dimensions recipe, layout, solver, range_m.

    Combinations that make no sense are NaN: IPPE but for the flat layout, the recipe 'order' but for the flat layout.
    """
    names, places, methods, steps = list(recipes), list(layouts), list(solvers), np.array(list(ranges_m), float)
    shape = (len(names), len(places), len(methods), len(steps))
    table: dict[str, FloatArray] = {}

    def store(index: tuple[int, ...], row: Mapping[str, float]) -> None:
        for key, value in row.items():
            table.setdefault(key, np.full(shape, np.nan))[index] = value

    for r, p, s in np.ndindex(len(names), len(places), len(steps)):
        recipe, place = RECIPES[names[r]], places[p]
        if names[r] == "order" and place != "flat":
            continue
        scenes = make_scenes(
            recipe.layout(place),
            np.full(per_range, steps[s]),
            camera,
            rng,
            noise,
            recipe.order,
            swapped_field=recipe.as_listed,
        )
        for m, method in enumerate(methods):
            if method in _PLANAR_ONLY and place != "flat":
                continue
            start = time.perf_counter()
            poses = _solve(SOLVERS[method], scenes, camera)
            elapsed = time.perf_counter() - start
            back = scenes.shows_back
            row = summary(Errors.of(scenes, poses), back, recipe.criterion)
            store((r, p, m, s), row | {"scenes": per_range, "scenes_back": back.sum(), "seconds": elapsed})
    dims = ("recipe", "layout", "solver", "range_m")
    units = {f"{kind}_{q}": unit for kind in ("mean", "std") for q, unit in QUANTITIES.items()}
    units |= {"median_attitude_deg": "deg", "seconds": "s"}
    return xr.Dataset(
        {k: (dims, v, {"units": units.get(k, "1"), "long_name": _COUNTS.get(k, k)}) for k, v in table.items()},
        coords={"recipe": names, "layout": places, "solver": methods, "range_m": ("range_m", steps, {"units": "m"})},
    )


def convergence(
    camera: Camera, rng: np.random.Generator, scenes_count: int = 2500, range_m: float = 20.0
) -> xr.Dataset:
    """Errors scene by scene at one range, random points (figures 3.9 to 3.11a); dimensions case, scene.

    Running means, standard deviations and outlier counts follow by cumulation; `statistical_error` is the closed form of
    the mean's standard error after all scenes.
    """
    cases = {"listing": "thesis EPnP", "right": "two-start"}
    absolute = np.full((len(cases), len(QUANTITIES), scenes_count), np.nan)
    outlier = np.zeros((len(cases), scenes_count), bool)
    for i, (name, method) in enumerate(cases.items()):
        recipe = RECIPES[name]
        scenes = make_scenes(
            recipe.layout("random"),
            np.full(scenes_count, range_m),
            camera,
            rng,
            order=recipe.order,
            swapped_field=recipe.as_listed,
        )
        errors = Errors.of(scenes, _solve(SOLVERS[method], scenes, camera))
        outlier[i] = errors.outliers(recipe.criterion)
        errors = errors.folded() if recipe.criterion == "listing" else errors
        absolute[i] = np.where(outlier[i], np.nan, np.stack(list(errors.absolute.values())))
    data: dict[str, tuple[tuple[str, ...], FloatArray, dict[str, str]]] = {
        f"error_{q}": (
            ("case", "scene"),
            absolute[:, k],
            {"units": unit, "long_name": f"absolute {q} error; outliers NaN"},
        )
        for k, (q, unit) in enumerate(QUANTITIES.items())
    }
    kept = np.sum(~outlier, axis=1)
    for k, (q, unit) in enumerate(QUANTITIES.items()):
        spread = np.nanstd(absolute[:, k], axis=1, ddof=1) / np.sqrt(kept)
        data[f"statistical_error_{q}"] = (("case",), spread, {"units": unit, "long_name": "standard error of the mean"})
    dataset = xr.Dataset(
        data, coords={"case": [f"{n}: {m}" for n, m in cases.items()], "scene": np.arange(1, scenes_count + 1)}
    )
    dataset["outlier"] = (("case", "scene"), outlier, {"units": "1", "long_name": "counted as an outlier"})
    return dataset.assign_attrs(range_m=range_m, layout="random")


def tried(camera: Camera, rng: np.random.Generator, count: int = 200) -> xr.Dataset:
    """Every solver that was tried, on the same scenes as meant; dimensions solver, layout, range_m.

    SoftPOSIT is told no correspondences, but a pose to start from: turned by 10° standard deviation about each axis, 5 % too
    far. It is run only where every point is in view.
    """

    def soft(points_m: FloatArray, pixels: FloatArray, visible: BoolArray, camera: Camera) -> Poses:
        turn = Rotation.from_rotvec(rng.normal(0, np.deg2rad(10.0), (len(points_m), 3))).as_matrix()
        start = turn @ scenes.rotation, scenes.translation_m * 1.05
        return softposit(points_m, pixels, visible, camera, start)[:2]

    every: dict[str, pnp.Solver] = {
        **SOLVERS,
        "EPnP + LM": pnp.epnp_refined,
        "OpenCV EPnP": pnp.opencv_epnp,
        "OpenCV iterative": pnp.iterative,
        "POSIT": posit,
        "DLS": dls,
        "SoftPOSIT": soft,
    }
    ranges = np.array([5.0, 20.0])
    shape = (len(every), len(LAYOUTS), len(ranges))
    wrong, median, spent = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    for p, s in np.ndindex(len(LAYOUTS), len(ranges)):
        layout = RECIPES["right"].layout(LAYOUTS[p])
        scenes = make_scenes(layout, np.full(count, ranges[s]), camera, rng, fewest_points=len(layout.virtual))
        for m, (name, solver) in enumerate(every.items()):
            if (name in _PLANAR_ONLY and LAYOUTS[p] != "flat") or (name == "SoftPOSIT" and not scenes.visible.all()):
                continue
            start = time.perf_counter()
            errors = Errors.of(scenes, _solve(solver, scenes, camera))
            spent[m, p, s] = (time.perf_counter() - start) / count
            wrong[m, p, s] = errors.outliers("geodesic").sum()
            median[m, p, s] = np.rad2deg(np.nanmedian(errors.attitude_rad))
    dims = ("solver", "layout", "range_m")
    return xr.Dataset(
        {
            "wrong": (dims, wrong, {"units": "1", "long_name": _COUNTS["wrong"]}),
            "median_attitude_deg": (dims, median, {"units": "deg", "long_name": "median geodesic attitude error"}),
            "seconds_per_scene": (dims, spent, {"units": "s", "long_name": "time of one solve, batching included"}),
        },
        coords={"solver": list(every), "layout": list(LAYOUTS), "range_m": ("range_m", ranges, {"units": "m"})},
        attrs={"scenes": count},
    )


def single(camera: Camera, rng: np.random.Generator, count: int = 1000, size_m: float = 0.1) -> xr.Dataset:
    """Attitude from one marker with 0, 1 or 4 virtual points; dimensions virtual_points, sigma_px, range_m."""
    points, sigmas, ranges = (0, 1, 4), (0.1, 0.3), np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0])
    shape = (len(points), len(sigmas), len(ranges))
    wrong, median = np.zeros(shape), np.zeros(shape)
    for p, g, s in np.ndindex(shape):
        layout = single_marker(size_m, points[p])
        scenes = make_scenes(layout, np.full(count, ranges[s]), camera, rng, noise_constant(sigmas[g]), fewest_points=4)
        rotation, _ = pnp.two_start(scenes.points_m, scenes.pixels, scenes.visible, camera)
        off = np.rad2deg(pnp.geodesic_angles(scenes.rotation, rotation))
        wrong[p, g, s], median[p, g, s] = np.sum(~(off <= 10)), np.nanmedian(off)
    dims = ("virtual_points", "sigma_px", "range_m")
    return xr.Dataset(
        {
            "wrong": (dims, wrong, {"units": "1", "long_name": "attitude off by more than 10 deg"}),
            "median_attitude_deg": (dims, median, {"units": "deg", "long_name": "median geodesic attitude error"}),
        },
        coords={
            "virtual_points": list(points),
            "sigma_px": ("sigma_px", list(sigmas), {"units": "px"}),
            "range_m": ("range_m", ranges, {"units": "m"}),
        },
        attrs={"scenes": count, "size_m": size_m},
    )


def far(camera: Camera, rng: np.random.Generator, per_range: int) -> xr.Dataset:
    """Random points out to 100 m (figure 3.11b), as `performance`; the point set is the thesis's."""
    ranges = [1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90, 100]
    return performance(
        camera,
        ranges,
        per_range,
        rng,
        recipes=("listing", "right"),
        layouts=("random",),
        solvers=("thesis EPnP", "two-start"),
    )


def noise_laws(camera: Camera, rng: np.random.Generator, per_range: int, ranges_m: Iterable[float]) -> xr.Dataset:
    """Outliers with equation 3.1 as printed beside the listing's law; dimension noise and those of `performance`."""
    laws = {"listing": noise_listing, "text": noise_text}
    steps = list(ranges_m)
    parts = []
    for name, law in laws.items():
        part = performance(
            camera,
            steps,
            per_range,
            rng,
            recipes=("listing", "right"),
            layouts=("random", "wide"),
            solvers=("thesis EPnP", "two-start"),
            noise=law,
        )
        part["sigma_px"] = ("range_m", law(np.array(steps, float), np.zeros(1, bool))[:, 0], {"units": "px"})
        parts.append(part.expand_dims(noise=[name]))
    return xr.concat(parts, dim="noise")


def load(overrides: tuple[str, ...] = (), seed: int | None = None) -> Scenario:
    """The default scenario, whose camera is the thesis's; only its camera and its seed are used."""
    return load_scenario(None, overrides if seed is None else (*overrides, f"seed={seed}"))


def run(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> xr.DataTree:
    """The whole study, one group a part: performance, convergence, far, noise, tried, single.

    Args:
        scenario: its camera and its seed are used; the same seed gives the same scenes.
        plan: how many scenes, at which ranges.
        progress: told after each part.

    Returns:
        Tree of datasets; see the functions of the parts for their dimensions.
    """
    camera, ranges = scenario.camera, plan.ranges_m
    parts: dict[str, Callable[[np.random.Generator], xr.Dataset]] = {
        "performance": lambda rng: performance(camera, ranges, plan.per_range, rng),
        "convergence": lambda rng: convergence(camera, rng, plan.convergence),
        "far": lambda rng: far(camera, rng, plan.per_range),
        "noise": lambda rng: noise_laws(camera, rng, plan.per_range, ranges),
        "tried": lambda rng: tried(camera, rng, plan.tried),
        "single": lambda rng: single(camera, rng, plan.single),
    }
    streams = np.random.default_rng(scenario.seed).spawn(len(parts))
    done: dict[str, xr.Dataset] = {}
    for (name, part), stream in zip(parts.items(), streams, strict=True):
        if progress is not None:
            progress(len(done), len(parts), name)
        done[name] = part(stream)
    tree = xr.DataTree.from_dict(done)
    tree.attrs |= {"title": "Monte Carlo of pose from points", **chain.provenance(scenario)}
    return tree
