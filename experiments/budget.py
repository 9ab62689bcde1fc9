"""The main job: SNR, CNR, saturation, detection and pose over range, in eclipse and sunlight, and whether the budget closes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from detector.features import Features
from experiments import chain
from experiments.scenario import Scenario
from radiometry import closure
from radiometry.geometry import FloatArray
from radiometry.thesis import PrintedModel
from scenes import exr

if TYPE_CHECKING:
    from experiments.verdict import Summary

#: Reports progress: cases done, cases in all, what is being worked on.
Progress = Callable[[int, int, str], None]

#: Variables over range, light and exposure: unit and long name.
VARIABLES: dict[str, tuple[str, str]] = {
    "exposure_s": ("s", "exposure"),
    "signal_analytic": ("electron", "signal of a bright bit, closed form"),
    "background_analytic": ("electron", "signal of a neighbouring dark cell, closed form"),
    "snr_analytic": ("1", "signal-to-noise ratio of a bright bit, closed form"),
    "cnr_analytic": ("1", "contrast-to-noise ratio of a bit, closed form"),
    "signal_expected": ("electron", "signal of a bright bit, rendered, before noise and clipping"),
    "background_expected": ("electron", "signal of a neighbouring dark cell, rendered, before noise and clipping"),
    "signal_rendered": ("electron", "signal of a bright bit, mean over the noise draws of the rendered frames"),
    "background_rendered": ("electron", "signal of a neighbouring dark cell, mean over the noise draws"),
    "snr_rendered": ("1", "signal-to-noise ratio over the noise draws; missing where bits saturate"),
    "snr_rendered_ci95": ("1", "half width of the 95 % interval of snr_rendered"),
    "cnr_rendered": ("1", "contrast-to-noise ratio over the noise draws; missing where bits saturate"),
    "cnr_rendered_ci95": ("1", "half width of the 95 % interval of cnr_rendered"),
    "snr_thesis": ("1", "signal-to-noise ratio by the thesis's formula as printed, its own 5 mm bit"),
    "full_well_fraction": ("1", "expected signal of a bright bit over the usable well"),
    "saturated_fraction": ("1", "share of bright-bit pixels that saturate"),
    "smear_px": ("pixel", "motion of the target during the exposure"),
    "detected_fraction": ("1", "share of frames in which the marker is found"),
    "attitude_error_p95_deg": ("degree", "95th percentile of the attitude error"),
    "range_error_p95": ("1", "95th percentile of the range error over range"),
}


@dataclass(frozen=True)
class _Case:
    """Results of the noise draws of one range, illumination and exposure."""

    values: dict[str, float]
    detected: NDArray[np.bool_]
    attitude_error_deg: FloatArray
    range_error: FloatArray
    frame: NDArray[np.uint16]
    features: Features


@dataclass(frozen=True)
class Snapshot:
    """What the camera saw at one range in one illumination, first noise draw of the shown exposure."""

    range_m: float
    light: str
    exposure_s: float
    frame: NDArray[np.uint16]
    features: Features


@dataclass(frozen=True)
class BudgetResult:
    """The labelled dataset of a budget and the frames that its report shows."""

    scenario: Scenario
    dataset: xr.Dataset
    snapshots: list[Snapshot]


def quick(scenario: Scenario) -> Scenario:
    """A coarser plan of the same scenario: seven of its ranges, eight noise draws, a quarter of the rays."""
    ranges = scenario.budget.ranges_m
    picked = tuple(ranges[i] for i in sorted({round(x) for x in np.linspace(0, np.sqrt(len(ranges) - 1), 7) ** 2}))
    plan = scenario.budget.model_copy(update={"ranges_m": picked, "trials": min(8, scenario.budget.trials)})
    render = scenario.render.model_copy(update={"marker_rays": max(10_000, scenario.render.marker_rays // 4)})
    return scenario.at(budget=plan.model_dump(), render=render.model_dump())


def run_budget(
    scenario: Scenario, out_dir: Path | None = None, progress: Progress | None = None, workers: int | None = None
) -> BudgetResult:
    """Render, expose, detect and judge every range, illumination and exposure of the scenario's plan.

    Args:
        scenario: what to judge.
        out_dir: where EXR transport bases, 16-bit PNG frames and ``results.nc`` are written; None writes nothing.
        progress: called after every range and illumination.
        workers: processes for the noise draws; default one a core. The result does not depend on it.

    Raises:
        OSError: when a file cannot be written.
    """
    plan = scenario.budget
    steps = [(r, light) for r in plan.ranges_m for light in plan.lights]
    pending: list[tuple[Future[list[_Case]], dict[str, list[float]]]] = []
    with _pool(workers) as submit:
        for range_m in plan.ranges_m:
            here = scenario.at(range_m=range_m)
            basis = chain.transport(here)
            if out_dir is not None:
                exr.write_basis(basis, out_dir / "transport" / f"range_{range_m:06.2f}m.exr")
            for light in plan.lights:
                budget = chain.link_budget(here, light)
                seconds = [chain.exposure_s(here, budget, e) for e in plan.exposures_s]
                rate = chain.electron_rate(here, basis, light)
                known = _known_values(here, light, budget, rate, seconds)
                pending.append((submit(here, rate, light, seconds), known))
                if progress:
                    progress(sum(f.done() for f, _ in pending), len(steps), f"rendered {range_m:g} m")
        cases = []
        for done, ((range_m, _), (future, _)) in enumerate(zip(steps, pending, strict=True), 1):
            cases.append(future.result())
            if progress:
                progress(done, len(steps), f"detected {range_m:g} m")
    dataset = _dataset(scenario, cases, [known for _, known in pending])
    shown = shown_exposure(scenario)
    snapshots = [
        Snapshot(range_m, light, float(known["exposure_s"][shown]), case[shown].frame, case[shown].features)
        for (range_m, light), case, (_, known) in zip(steps, cases, pending, strict=True)
    ]
    if out_dir is not None:
        from experiments.files import write_netcdf, write_png

        for s in snapshots:
            write_png(s.frame, out_dir / "frames" / f"range_{s.range_m:06.2f}m_{s.light}.png")
        write_netcdf(dataset, out_dir / "results.nc")
    return BudgetResult(scenario, dataset, snapshots)


def as_json(result: BudgetResult, summary: Summary) -> dict[str, object]:
    """The whole dataset and the verdict as plain data."""
    return {"verdict": asdict(summary), "results": result.dataset.to_dict(data="list")}


def shown_exposure(scenario: Scenario) -> int:
    """Index of the exposure that pictures and the range-by-range table show: the automatic one, else the last."""
    exposures = list(scenario.budget.exposures_s)
    return exposures.index("auto") if "auto" in exposures else len(exposures) - 1


def exposure_label(exposure: float | str) -> str:
    """How an exposure of the plan is called in tables: 'auto', '1/30 s', '1 ms'."""
    if isinstance(exposure, str):
        return exposure
    if exposure >= 0.01 and abs(1 / exposure - round(1 / exposure)) < 1e-6:
        return f"1/{round(1 / exposure)} s"
    scale, unit = next(((s, u) for s, u in ((1, "s"), (1e-3, "ms"), (1e-6, "µs")) if exposure >= s), (1e-9, "ns"))
    return f"{exposure / scale:.3g} {unit}"


@contextmanager
def _pool(workers: int | None) -> Iterator[Callable[..., Future[list[_Case]]]]:
    """A function that runs `_draw` elsewhere: in spawned processes (the renderer must not be forked), or here with one core."""
    count = workers if workers is not None else (os.cpu_count() or 1)
    if count <= 1:

        def run_here(*arguments: object) -> Future[list[_Case]]:
            future: Future[list[_Case]] = Future()
            future.set_result(_draw(*arguments))  # type: ignore[arg-type]
            return future

        yield run_here
        return
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_one_thread)
    try:
        yield lambda *arguments: pool.submit(_draw, *arguments)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def _known_values(
    scenario: Scenario, light: str, budget: chain.LinkBudget, rate: FloatArray, seconds: list[float]
) -> dict[str, list[float]]:
    """Per exposure, what needs no noise: closed form, thesis, and the rendered expectation."""
    scene_view, marker, printed = chain.view(scenario), scenario.marker, PrintedModel()
    signal_rate = _mean_over_bits(rate, chain.bit_pixels(scene_view, marker.white_bit_centres_m()))
    background_rate = _mean_over_bits(rate, chain.bit_pixels(scene_view, marker.black_bit_centres_m()))
    values: dict[str, list[float]] = {name: [] for name in VARIABLES}
    for t in seconds:
        analytic = budget.at(t)
        values["exposure_s"].append(t)
        for name in ("signal", "background", "snr", "cnr"):
            values[f"{name}_analytic"].append(analytic[name])
        values["signal_expected"].append(signal_rate * t)
        values["background_expected"].append(background_rate * t)
        values["full_well_fraction"].append((signal_rate * t + analytic["dark"]) / chain.usable_well(scenario.sensor))
        values["smear_px"].append(analytic["smear_px"])
        values["snr_thesis"].append(float(printed.snr(scenario.range_m, t, sun=light == "sun")))
    return {name: v for name, v in values.items() if v}


def _mean_over_bits(image: FloatArray, pixels: list[tuple[NDArray[np.intp], NDArray[np.intp]]]) -> float:
    """Mean over bits of the mean over each bit's pixels; NaN where none is in the frame."""
    seen = [image[p].mean() for p in pixels if len(p[0])]
    return float(np.mean(seen)) if seen else np.nan


def _draw(scenario: Scenario, rate: FloatArray, light: str, seconds: list[float]) -> list[_Case]:
    """Noise draws of every exposure: statistics of the bits, detection and pose."""
    scene_view, marker = chain.view(scenario), scenario.marker
    white = chain.bit_pixels(scene_view, marker.white_bit_centres_m())
    black = chain.bit_pixels(scene_view, marker.black_bit_centres_m())
    return [_draw_exposure(scenario, rate, light, t, white, black) for t in seconds]


def _draw_exposure(
    scenario: Scenario,
    rate: FloatArray,
    light: str,
    seconds: float,
    white: list[tuple[NDArray[np.intp], NDArray[np.intp]]],
    black: list[tuple[NDArray[np.intp], NDArray[np.intp]]],
) -> _Case:
    sensor, trials = scenario.sensor, scenario.budget.trials
    bright, dark = _index(white), _index(black)
    levels = {"signal": np.empty((trials, len(bright[0]))), "background": np.empty((trials, len(dark[0])))}
    sightings, first = [], None
    for trial in range(trials):
        frame = chain.take_frame(scenario, rate, light, seconds, trial).dn
        first = frame if first is None else first
        electrons = (frame - np.float32(sensor.offset_dn)) * np.float32(sensor.gain_electrons_per_dn)
        levels["signal"][trial], levels["background"][trial] = electrons[bright], electrons[dark]
        sightings.append(chain.look(scenario, frame))
    assert first is not None
    errors = np.array([chain.pose_errors(scenario, s.pose) for s in sightings])
    found = np.array([s.features.detected for s in sightings])
    ceiling = (sensor.saturation_dn - sensor.offset_dn) * sensor.gain_electrons_per_dn
    saturated = float(np.mean(levels["signal"] >= ceiling - 4 * sensor.total_noise_electrons))
    return _Case(
        {
            **_noise_statistics(levels["signal"], levels["background"], saturated),
            "saturated_fraction": saturated,
            "detected_fraction": float(found.mean()),
            "attitude_error_p95_deg": _percentile95(np.degrees(errors[:, 0])),
            "range_error_p95": _percentile95(errors[:, 1]),
        },
        found, np.degrees(errors[:, 0]), errors[:, 1], first, sightings[0].features,
    )  # fmt: skip


def _index(pixels: list[tuple[NDArray[np.intp], NDArray[np.intp]]]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.concatenate([p[0] for p in pixels]), np.concatenate([p[1] for p in pixels])


def _percentile95(values: FloatArray) -> float:
    """95th percentile of those that are known; NaN when none is."""
    known = values[np.isfinite(values)]
    return float(np.percentile(known, 95)) if len(known) else np.nan


def _noise_statistics(signal: FloatArray, background: FloatArray, saturated: float) -> dict[str, float]:
    """Mean levels, SNR and CNR over noise draws (trials, pixels), with half widths of their 95 % intervals.

    The variance of a pixel is taken over the draws and averaged over pixels: pixels·(trials − 1) degrees of freedom n, so
    its relative standard deviation is √(2/n), and that of a ratio to its root is half of it.
    """
    means = signal.mean() if signal.size else np.nan, background.mean() if background.size else np.nan
    result = {"signal_rendered": float(means[0]), "background_rendered": float(means[1])}
    names = ("snr_rendered", "snr_rendered_ci95", "cnr_rendered", "cnr_rendered_ci95")
    if saturated > 0.01 or not signal.size or not background.size:
        return {**result, **dict.fromkeys(names, np.nan)}
    variance = [levels.var(axis=0, ddof=1).mean() for levels in (signal, background)]
    freedom = [levels.shape[1] * (len(levels) - 1) for levels in (signal, background)]
    snr = means[0] / np.sqrt(variance[0])
    total = variance[0] + variance[1]
    cnr = (means[0] - means[1]) / np.sqrt(total)
    spread = np.sqrt(2 * sum((v / total) ** 2 / n for v, n in zip(variance, freedom, strict=True)))
    return {
        **result,
        **dict(zip(names, (snr, 1.96 * snr * np.sqrt(0.5 / freedom[0]), cnr, 1.96 * cnr * spread / 2), strict=True)),
    }


def _dataset(scenario: Scenario, cases: list[list[_Case]], known: list[dict[str, list[float]]]) -> xr.Dataset:
    plan = scenario.budget
    shape = (len(plan.ranges_m), len(plan.lights), len(plan.exposures_s))
    dims = ("range_m", "light", "exposure")
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name, (unit, long_name) in VARIABLES.items():
        values = [
            k[name][e] if name in k else case[e].values[name]
            for k, case in zip(known, cases, strict=True)
            for e in range(len(plan.exposures_s))
        ]
        data[name] = (dims, np.array(values, float).reshape(shape), {"units": unit, "long_name": long_name})
    for name, unit, long_name in (
        ("detected", "1", "marker found in a frame"),
        ("attitude_error_deg", "degree", "geodesic attitude error of a frame"),
        ("range_error", "1", "range error over range of a frame"),
    ):
        trials = np.array([[getattr(c, name) for c in case] for case in cases]).reshape(*shape, plan.trials)
        data[name] = ((*dims, "trial"), trials, {"units": unit, "long_name": long_name})
    px_per_bit = [chain.link_budget(scenario.at(range_m=r), "eclipse").px_per_bit for r in plan.ranges_m]
    data["px_per_bit"] = (
        ("range_m",),
        np.array(px_per_bit),
        {"units": "pixel", "long_name": "pixels along a bit's shorter side"},
    )
    dataset = xr.Dataset(
        data,
        coords={
            "range_m": ("range_m", np.array(plan.ranges_m), {"units": "m", "long_name": "range"}),
            "light": ("light", list(plan.lights), {"long_name": "illumination"}),
            "exposure": ("exposure", [exposure_label(e) for e in plan.exposures_s], {"long_name": "exposure"}),
            "trial": ("trial", np.arange(plan.trials), {"long_name": "noise draw"}),
        },
        attrs={
            "Conventions": "CF-1.11",
            "title": scenario.title,
            "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis budget",
            **chain.provenance(scenario),
        },
    )
    return _judged(scenario, dataset)


def _judged(scenario: Scenario, dataset: xr.Dataset) -> xr.Dataset:
    """The dataset with the margin of every criterion, and whether all are met."""
    columns = {
        "saturation": "full_well_fraction", "cnr": "cnr_analytic", "sampling": "px_per_bit", "smear": "smear_px",
        "detection": "detected_fraction", "attitude": "attitude_error_p95_deg", "range": "range_error_p95",
    }  # fmt: skip
    full = {
        name: dataset[column].broadcast_like(dataset.exposure_s).transpose(*dataset.exposure_s.dims)
        for name, column in columns.items()
    }
    margins = np.empty((*dataset.exposure_s.shape, len(columns)))
    for index in np.ndindex(dataset.exposure_s.shape):
        values = {name: float(array.values[index]) for name, array in full.items()}
        margins[index] = [verdict.margin for verdict in closure.judge(scenario.requirement, values)]
    dims = (*dataset.exposure_s.dims, "criterion")
    return dataset.assign_coords(criterion=("criterion", list(columns), {"long_name": "closure criterion"})).assign(
        margin=(dims, margins, {"units": "1", "long_name": "factor by which the criterion is met; below 1 it fails"}),
        closes=(dims[:-1], (margins >= 1).all(axis=-1), {"units": "1", "long_name": "all criteria met"}),
    )
