"""The functions of ``import mantis``: the command line's verbs for notebooks and scripts, by the same names.

Nothing heavy is imported before a function needs it. `load`, `explain`, `closed_form`, `detect`, `marker` and `schema` need no
renderer; `shoot`, `render`, `budget`, `sweep`, `validate` and `glare` render. The stages behind them are those of
`experiments.chain`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from numpy.typing import NDArray

    from detector.sensor.sensor import Frame
    from experiments.chain import DetectedImage
    from experiments.chain.progress import Progress
    from experiments.chain.shoot import Exposure
    from experiments.scenario import KeyValue, Scenario
    from experiments.studies.budget.study import BudgetResult
    from experiments.studies.close.study import ClosureResult
    from experiments.studies.glare.study import GlareResult
    from experiments.studies.materials.study import MaterialRow
    from experiments.studies.sweep.study import Outcome
    from scenes.render.transport import TransportBasis

    Image: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64]

__all__ = [
    "budget",
    "close",
    "closed_form",
    "detect",
    "explain",
    "expose",
    "glare",
    "load",
    "marker",
    "materials",
    "render",
    "schema",
    "shoot",
    "sweep",
    "validate",
]


def load(source: str | Path | None = None, *overrides: str) -> Scenario:
    """Read a scenario from a TOML file or a shipped one by name, with changes as `--set` takes them.

    Args:
        source: path of the file, or name of a shipped scenario; None is the default scenario.
        overrides: ``key=value``, say ``leds.count=20``; values are TOML, bare words are text.

    Raises:
        ScenarioError: a ValueError of one line that names the key, the value, and what was expected.

    Example:
        >>> scenario = load("default", "leds.count=20", "illumination=sunlit")
        >>> scenario.leds.count, scenario.range_m
        (20, 4.0)
        >>> scenario.changed("range_m=6").range_m
        6.0
    """
    from experiments.scenario import load_scenario

    return load_scenario(source, overrides)


def explain(key: str, scenario: Scenario | None = None) -> str:
    """Say in one line what a scenario key means and takes, its default, and its value in a scenario.

    Args:
        key: dotted, say ``leds.half_angle_deg``.
        scenario: whose value is told; None is the default scenario.

    Raises:
        ValueError: when there is no such key, naming the nearest.

    Example:
        >>> explain("range_m")
        'range_m = 4.0 m: camera to marker along the optical axis (number, 0.05 to 1000; default 4.0 m)'
    """
    from experiments.scenario.keys import explained

    return explained(key, load() if scenario is None else scenario)


def closed_form(scenario: Scenario, axes: Mapping[str, Iterable[KeyValue]] | None = None) -> xr.Dataset:
    """Compute the closed-form budget over all combinations of some scenario keys, without rendering.

    Args:
        scenario: gives every key that the axes do not name.
        axes: values by dotted key; None is the ranges and illuminations of the scenario's budget.

    Returns:
        One dimension a key. Signal, background and dark charge [electrons], SNR, CNR, share of the full well, pixels per bit,
        smear [px], the smallest margin over the closure criteria, and `binds`, the criterion that has it. NaN where no bit is
        in the frame.

    Raises:
        ScenarioError: when a key or a value is not one of a scenario.

    Example:
        >>> table = closed_form(load(), {"range_m": [2, 5, 10], "leds.count": [20, 100]})
        >>> dict(table.sizes)
        {'range_m': 3, 'leds.count': 2}
        >>> bool((table.cnr.sel({"leds.count": 100}) >= table.cnr.sel({"leds.count": 20})).all())
        True
    """
    from experiments.chain import closed_form as chain

    return chain.closed_form(scenario, axes)


def shoot(scenario: Scenario, trial: int = 0) -> Exposure:
    """Take one frame of a scenario: render, expose and detect. Rendered transport is kept in the cache.

    Args:
        scenario: its range, illumination, exposure and seed say which frame.
        trial: which noise draw of the seed.

    Returns:
        The frame (height, width) [DN], its exposure [s], the detection, and the errors of its pose.

    Example:
        >>> small = load(None, "camera.width_px=160", "camera.height_px=160", "render.marker_rays=100_000", "range_m=3")
        >>> taken = shoot(small)
        >>> taken.frame.shape, taken.detection.detected, taken.range_error < 0.01
        ((160, 160), True, True)
    """
    from experiments.chain import shoot as chain

    return chain.shoot(scenario, trial)


def render(scenario: Scenario) -> TransportBasis:
    """Render the transport basis of a scenario's geometry: one image per light and wavelength at unit source strength.

    Example:
        >>> small = load(None, "camera.width_px=160", "camera.height_px=160", "render.marker_rays=100_000", "range_m=3")
        >>> basis = render(small)
        >>> sorted(basis.layers), basis.layers["led"].shape
        (['led', 'sun'], (4, 160, 160))
    """
    from experiments import chain

    return chain.transport(scenario)


def expose(scenario: Scenario, basis: TransportBasis, trial: int = 0) -> Frame:
    """Expose a scenario's sensor to a transport basis: electrons and digital numbers of one frame.

    Args:
        scenario: says illumination, exposure, LEDs, filter, lens and sensor; its geometry must be the basis's.
        basis: as `render` gives it.
        trial: which noise draw of the scenario's seed.

    Raises:
        ValueError: when the basis is of another geometry or band.

    Example:
        >>> small = load(None, "camera.width_px=160", "camera.height_px=160", "render.marker_rays=100_000", "range_m=3")
        >>> frame = expose(small, render(small))
        >>> frame.dn.dtype, frame.electrons.shape
        (dtype('uint16'), (160, 160))
    """
    from experiments import chain

    chain.check_geometry(scenario, basis, "basis")
    rate = chain.electron_rate(scenario, basis, scenario.illumination)
    budget = chain.link_budget_beside(scenario, scenario.illumination, rate)
    seconds = chain.solve_exposure(scenario, budget, scenario.exposure_s)
    return chain.expose(scenario, rate, scenario.illumination, seconds, trial)


def detect(image: Image | str | Path, scenario: Scenario, off: Image | str | Path | None = None) -> DetectedImage:
    """Find the marker in an image from anywhere and solve its pose; a notebook shows the result as a picture.

    Args:
        image: (height, width) array of any bit depth, or a file: PNG, TIFF, PGM, JPEG or EXR.
        scenario: says which camera and which marker.
        off: a frame without the LEDs, taken as the image was; it is subtracted.

    Returns:
        Features [px], each with its covariance, and the pose (marker to camera, [m]); the pose is None without a detection.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when an image cannot be read or is not of the camera's size, or the two are not of one kind.

    Example:
        >>> import numpy as np
        >>> empty = np.full((160, 160), 64, np.uint16)
        >>> detect(empty, load(None, "camera.width_px=160", "camera.height_px=160")).detected
        False
    """
    from experiments import chain
    from experiments.reporting.files import read_image

    seen = read_image(image) if isinstance(image, (str, Path)) else image
    found = chain.detect(chain.Belief.of(scenario), seen, read_image(off) if isinstance(off, (str, Path)) else off)
    return chain.DetectedImage(found.features, found.pose, seen, scenario)


def budget(scenario: Scenario, *, quick: bool = False, progress: Progress | None = None) -> BudgetResult:
    """Judge a scenario over its ranges, illuminations and exposures, rendered beside closed form: `mantis budget`.

    Args:
        scenario: what to judge.
        quick: fewer ranges, noise draws and rays: within a minute.
        progress: called after every range and illumination.

    Returns:
        `dataset` holds every figure, with dimensions range_m, illumination and exposure.
    """
    from experiments.studies.budget import plan, study

    return study.run(scenario, plan.QUICK if quick else plan.FULL, progress)


def sweep(
    plan: str | Path,
    out: str | Path,
    *overrides: str,
    resume: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Outcome:
    r"""Run a sweep file over any scenario keys into one labelled dataset: `mantis sweep`.

    Args:
        plan: the sweep file.
        out: where the dataset is written, NetCDF, or Zarr where it ends in .zarr; finished cases are kept beside it.
        overrides: ``key=value`` changes to the base scenario.
        resume: go on with an interrupted sweep.
        workers: processes; None computes in this one. The dataset is the same.
        progress: called with the finished cases.

    Raises:
        ScenarioError: when the file or a case of it is wrong.
        ValueError: when there is an unfinished sweep at `out` and `resume` is not set.

    Example:
        >>> folder = getfixture("tmp_path")
        >>> _ = (folder / "sweep.toml").write_text('trials = 2\n[grid]\nexposure_s = [1e-6, "auto"]\n')
        >>> small = ("camera.width_px=160", "camera.height_px=160", "render.marker_rays=100_000", "range_m=3")
        >>> outcome = sweep(folder / "sweep.toml", folder / "results.nc", *small)
        >>> dict(outcome.dataset.cnr_analytic.sizes), outcome.failed
        ({'exposure_s': 2}, 0)
    """
    from functools import partial

    from experiments.chain.executor import ProcessExecutor
    from experiments.studies.sweep import study

    cases = study.load_sweep(Path(plan), overrides)
    executor = None if workers is None else partial(ProcessExecutor, workers)
    return study.run_sweep(cases, Path(out), resume=resume, executor=executor, progress=progress)


def validate(scenario: Scenario, *, quick: bool = False, progress: Progress | None = None) -> xr.Dataset:
    """Hold the closed form against rendering over range, marker size, tilt, light and sensor: `mantis validate`.

    Args:
        scenario: gives camera, LEDs and materials.
        quick: 16 geometries instead of 180: within a minute.
        progress: called after every geometry.
    """
    from experiments.studies.validate import plan, study

    return study.compare(scenario, plan.QUICK if quick else plan.FULL, progress)


def glare(
    scenario: Scenario, *, quick: bool = False, workers: int | None = None, progress: Progress | None = None
) -> GlareResult:
    """Detect the marker wherever the Sun stands, with each counter-measure: `mantis glare`.

    Args:
        scenario: camera, LEDs, marker and materials.
        quick: one range and four phase angles: within a minute.
        workers: processes beside the renderer's; 0 is none, None is one a core.
        progress: called after every geometry.
    """
    from experiments.studies.glare import plan, study

    return study.run(scenario, plan.QUICK if quick else plan.FULL, progress, workers)


def close(
    constraints: str | Path | None = None,
    *overrides: str,
    quick: bool = False,
    render: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
) -> ClosureResult:
    """Find the parameter sets that close the whole range, and confirm them by rendering: `mantis close`.

    Args:
        constraints: TOML file of what may be changed and how far; None is the shipped one.
        overrides: ``key=value`` changes to the scenario; keys that begin with ``close.`` change the constraints.
        quick: fewer draws for the probability that a set closes, and two sets confirmed at three ranges.
        render: whether sets are confirmed by rendering; the closed form alone takes seconds.
        workers: processes for the noise draws; None is one a core.
        progress: called after every case that is confirmed.

    Returns:
        `recommended` is the recommended set; None where no set closes.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    from dataclasses import replace

    from experiments.studies.close import plan, study
    from experiments.studies.close.constraints import load_problem

    problem = load_problem(None if constraints is None else Path(constraints), overrides, None)
    return study.run(problem, replace(plan.QUICK if quick else plan.FULL, render=render), progress, workers)


def materials(*names: str) -> list[MaterialRow]:
    """List the materials with their main figures and sources: those named, or all of the library.

    Args:
        names: of the library, or paths of material files.

    Raises:
        ValueError: when there is no such material, naming those that there are.

    Example:
        >>> [row.name for row in materials("tape_type_xi")]
        ['tape_type_xi']
    """
    from experiments.studies.materials import plan, study

    return list(study.run(plan.Plan(names)).rows)


def marker(scenario: Scenario, folder: str | Path) -> list[Path]:
    """Write a scenario's marker for workshop and detector: `mantis marker`.

    Args:
        scenario: its marker is written.
        folder: where marker.stl [mm], marker.obj and marker.mtl [m], tape.svg (true to scale) and marker.json go.

    Example:
        >>> [path.name for path in marker(load(), getfixture("tmp_path"))]
        ['marker.stl', 'marker.obj', 'marker.mtl', 'tape.svg', 'marker.json']
    """
    from scenes.files.marker_files import write_marker_files

    return write_marker_files(scenario.marker, Path(folder))


def schema() -> dict[str, object]:
    """Give the JSON schema of scenario files, with which an editor completes and checks them.

    Example:
        >>> "range_m" in schema()["properties"]
        True
    """
    from experiments.scenario import json_schema

    return json_schema()
