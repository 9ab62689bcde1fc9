"""Time and memory of a sweep as a user runs it."""

from __future__ import annotations

import cProfile
import os
import pstats
import resource
import tempfile
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rows import Row
from experiments.chain.executor import ProcessExecutor
from experiments.chain.trials import VARIABLES
from experiments.studies.sweep import study, work
from experiments.studies.sweep.dataset import OF_CASES, OF_DRAWS
from experiments.studies.sweep.plan import Sweep, load_sweep
from scenes.files.cache import TransportCache, default_folder

WORKERS = 2
TARGET_S, TARGET_GIB = 600.0, 4.0
RANGES_M = tuple(range(1, 21))
EXPOSURES = (1e-7, 2e-7, 5e-7, 1e-6, 2e-6, 5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 1e-3, "auto")
PLAN = """
trials = {draws}
{window}
[grid]
range_m = {ranges}
exposure_s = {exposures}
[list]
illumination = ["eclipse", "eclipse", "sunlit", "sunlit", "sunlit", "sunlit", "sunlit", "sunlit"]
sun.phase_deg = [45, 45, 20, 20, 45, 45, 90, 90]
leds.intensity_w_sr = [1.75, 3.5, 1.75, 3.5, 1.75, 3.5, 1.75, 3.5]
"""

TRANSPORT = "render or read transport"
#: Functions whose cumulative time is a part of the work, by what they do; none runs within another.
PARTS = {
    TRANSPORT: "bases",
    "electron rates": "electron_rate",
    "closed form": "link_budget_beside",
    "variance of the renderer": "renderer_variance_fraction",
    "closed form, thesis, expectation": "known_values",
    "expose": "take_frame",
    "find the marker": "find_features",
    "solve the pose": "solve_pose",
}

#: What is estimated. The price is that of a virtual core on demand, 4.08 USD an hour for the 96 of a c5.24xlarge: example in the
#: Amazon EC2 Auto Scaling user guide, "Spot price per unit hour"; spot instances, which the journal bears, cost less than half.
CASES, CORES, USD_PER_CORE_HOUR = 10_000_000, 1000, 0.0425
DRAWS = 16

TITLE = "A sweep of 30 720 frames"
COLUMNS = "figure"
TEXT = f"""
20 ranges × 12 exposures × 8 illuminations × 16 noise draws of 752 × 580 px, each exposed, searched and its pose solved, on
two spawned workers with an empty cache: on whole frames, and in a window of three marker extents (`window = 3`). The eight
illuminations are eclipse at two LED powers, and three directions of the Sun at two LED powers: 60 geometries are rendered,
one for each range and direction, and serve every power and exposure. `--quick` takes every fourth range and exposure.

From the processor time follows what ten million cases of 16 draws take and cost: where geometries serve as many cases as
here, and where each case has its own, at {USD_PER_CORE_HOUR} USD for an hour of a virtual core.
"""


@dataclass(frozen=True)
class Measured:
    """One run.

    Attributes:
        frames, geometries: exposed, and rendered.
        seconds: on the clock, start of the workers and compilation of kernels included.
        core_s: processor time of all processes, which other work on the machine hardly lengthens.
        peak_gib: memory of all processes together.
    """

    frames: int
    geometries: int
    seconds: float
    core_s: float
    peak_gib: float


@dataclass(frozen=True)
class Profile:
    """Where a worker's time goes: share by part, seconds of a frame, and seconds of a geometry's rendering."""

    shares: dict[str, float]
    frame_s: float
    geometry_s: float


class PeakMemory:
    """Largest memory of this process and its children while it is open, from /proc (proportional set size) [GiB]."""

    def __enter__(self) -> PeakMemory:
        self.gib, self._stop = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            self.gib = max(self.gib, sum(map(_memory_kib, _family(os.getpid()))) / 2**20)


def _family(pid: int) -> list[int]:
    """A process and all that descend from it."""
    parents: dict[int, list[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = status.read_text()
        except OSError:  # it has ended
            continue
        parents.setdefault(int(text.rpartition(")")[2].split()[1]), []).append(int(status.parent.name))
    found = [pid]
    for process in found:
        found += parents.get(process, [])
    return found


def _memory_kib(pid: int) -> int:
    try:
        rows = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return sum(int(row.split()[1]) for row in rows if row.startswith("Pss:"))


def sweep_plan(folder: Path, window: float | None, every: int) -> Sweep:
    """The sweep of 30 720 frames, or of every so manieth of its ranges and exposures."""
    path = folder / "sweep.toml"
    path.write_text(
        PLAN.format(
            window="" if window is None else f"window = {window}",
            draws=DRAWS,
            ranges=list(RANGES_M[every - 1 :: every]),
            exposures=str(list(EXPOSURES[every - 1 :: every])).replace("'", '"'),
        )
    )
    return load_sweep(path)


def measure(window: float | None, every: int) -> Measured:
    """Run the sweep on two workers, with a cache of its own, empty at first."""
    with tempfile.TemporaryDirectory() as name, PeakMemory() as memory:
        folder = Path(name)
        os.environ["MANTIS_CACHE"] = str(folder / "cache")
        start, before = time.perf_counter(), _processor_s()
        sweep = sweep_plan(folder, window, every)
        outcome = study.run_sweep(sweep, folder / "out.nc", executor=partial(ProcessExecutor, WORKERS))
        seconds, core_s = time.perf_counter() - start, _processor_s() - before
    if outcome.failed:
        raise RuntimeError(f"{outcome.failed} cases could not be computed")
    return Measured(outcome.dataset.detected.size, outcome.rendered, seconds, core_s, memory.gib)


def _processor_s() -> float:
    """Processor time of this process and of the children that have ended."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in usage)


def profile(window: float | None) -> Profile:
    """Profile this process at every sixth range and exposure, with kernels compiled before."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["MANTIS_CACHE"] = str(folder / "cache")
        scenarios = sweep_plan(folder, window, 6).scenarios
        list(work.compute([(0, scenarios[0])]))
        TransportCache(default_folder()).clear()
        profiler = cProfile.Profile(time.process_time)
        profiler.enable()
        done = list(work.compute(list(enumerate(scenarios))))
        profiler.disable()
    stats = pstats.Stats(profiler)
    known: dict[str, float] = {}
    for (_, _, function), (_, _, _, cumulative, _) in stats.stats.items():  # type: ignore[attr-defined]
        known[function] = known.get(function, 0.0) + cumulative
    total = stats.total_tt  # type: ignore[attr-defined]
    seconds = {part: known[function] for part, function in PARTS.items()}
    seconds["the rest"] = total - sum(seconds.values())
    geometries = sum(rendered for *_, rendered in done)
    frame_s = (total - seconds[TRANSPORT]) / (len(scenarios) * DRAWS)
    return Profile({part: s / total for part, s in seconds.items()}, frame_s, seconds[TRANSPORT] / geometries)


class NoWork:
    """Workers that give made-up records at once, so that only the handing out remains."""

    losses: tuple[type[BaseException], ...] = ()

    def __enter__(self) -> NoWork:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def width(self) -> int:
        return 100

    def recover(self) -> None:
        pass

    def submit(self, function: object, *arguments: object) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result([(index, _made_up(index), 0) for index, _ in arguments[0]])  # type: ignore[attr-defined]
        return future


def _made_up(index: int) -> work.Record:
    rng = np.random.default_rng(index)
    values = {name: float(rng.random()) for name in (*VARIABLES, *OF_CASES)}
    drawn = {name: rng.random(DRAWS).tolist() for name in OF_DRAWS}
    return {"values": values, **drawn, "pose_covariance": rng.random((6, 6)).tolist(), "reason": ""}


def handing_out(cases: int = 4096) -> tuple[float, float]:
    """Cases a second that one process reads, hands out, journals and writes, and bytes of a result."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "sweep.toml"
        path.write_text(f"trials = {DRAWS}\n[sample]\ncount = {cases}\nranges.range_m = [1, 20]\n")
        start = time.perf_counter()
        study.run_sweep(load_sweep(path), path.with_suffix(".nc"), executor=NoWork)
        return cases / (time.perf_counter() - start), path.with_suffix(".nc").stat().st_size / cases


def run(quick: bool) -> list[Row]:
    """Time, memory and profile, on whole frames and in a window, and what follows for ten million cases."""
    every = 4 if quick else 1
    rows = []
    for series, window in (("whole frames", None), ("window = 3", 3.0)):
        seen = profile(window)  # first, so that what is compiled once for a machine is not counted
        rows += _rows(series, measure(window, every), seen, every)
    rate, size = handing_out()
    return [
        *rows,
        Row("cases that one process hands out", rate, "1/s", "", f"{CASES:,} of them in {CASES / rate / 3600:.1f} h"),
        Row(f"results of {CASES:,} cases", CASES * size / 2**30, "GiB"),
    ]


def _rows(series: str, seen: Measured, profiled: Profile, every: int) -> list[Row]:
    cases, parts = seen.frames / DRAWS, every**2
    scaled = f"{parts} × that of a part" if parts > 1 else ""
    limit = f"≤ {TARGET_S:.0f}" if series == "whole frames" else ""
    rows = [
        Row("30 720 frames exposed, searched and posed", seen.seconds * parts, "s", limit, scaled, series),
        Row("the same, processor time", seen.core_s * parts, "s", "", scaled, series),
        Row("geometries rendered for them", seen.geometries * every, "", "", "", series),
        Row("frames", seen.frames / seen.seconds, "1/s", "", "", series),
        Row("peak memory of all processes", seen.peak_gib, "GiB", f"≤ {TARGET_GIB:g}", "", series),
        Row("one worker: a frame", 1e3 * profiled.frame_s, "ms", "", "without rendering", series),
        Row("one worker: rendering a geometry", 1e3 * profiled.geometry_s, "ms", "", "", series),
    ]
    by_share = sorted(profiled.shares.items(), key=lambda item: -item[1])
    rows += [Row(f"one worker's time: {part}", 100 * share, "%", "", "", series) for part, share in by_share]
    for sharing, said in ((cases / seen.geometries, "sharing geometries as here"), (1.0, "a geometry each")):
        extra_s = (1 / sharing - seen.geometries / cases) * profiled.geometry_s
        core_h = CASES * (DRAWS * seen.core_s / seen.frames + extra_s) / 3600
        rows += [
            Row(f"{CASES:,} cases, {said}", core_h, "core-hours", "", "", series),
            Row(f"{CASES:,} cases, {said}: on {CORES:,} cores", core_h / CORES, "h", "", "", series),
            Row(f"{CASES:,} cases, {said}: price", core_h * USD_PER_CORE_HOUR, "USD", "", "", series),
        ]
    return rows
