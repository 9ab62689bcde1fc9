"""Time and memory of a sweep as a user runs it: `python -m benchmarks.sweep [--quick]`.

20 ranges × 12 exposures × 8 illuminations × 16 noise draws = 30 720 frames of 752 × 580 px, each exposed, searched and its pose
solved, on two spawned workers with an empty cache: once on whole frames, once in a window of three marker extents (`window = 3`).
The eight illuminations are eclipse at two LED powers, and three directions of the Sun at two LED powers: 60 geometries are
rendered, once for each range and direction, and serve every power and exposure.

Prints time, frames a second, the peak memory of all processes together, where the time of one worker goes, and what ten million
cases would take and cost. `--quick` takes every fourth range and every fourth exposure, a sixteenth of the frames.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import platform
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

from experiments.sweep import study, work
from experiments.sweep.dataset import OF_CASES, OF_DRAWS
from experiments.sweep.plan import Sweep, load_sweep
from experiments.trials import VARIABLES
from experiments.workers import Processes
from scenes.cache import TransportCache, default_folder

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
light = ["eclipse", "eclipse", "sun", "sun", "sun", "sun", "sun", "sun"]
sun.phase_deg = [45, 45, 20, 20, 45, 45, 90, 90]
leds.intensity_w_sr = [1.75, 3.5, 1.75, 3.5, 1.75, 3.5, 1.75, 3.5]
"""

TRANSPORT = "render or read transport"
#: Functions whose cumulative time is a part of the work, by what they do; none runs within another.
PARTS = {
    TRANSPORT: ("cache.py", "bases"),
    "electron rates": ("chain.py", "electron_rate"),
    "closed form": ("chain.py", "link_budget_beside"),
    "variance of the renderer": ("chain.py", "renderer_variance_fraction"),
    "closed form, thesis, expectation": ("trials.py", "known_values"),
    "expose": ("chain.py", "take_frame"),
    "find the marker": ("features.py", "detect_features"),
    "solve the pose": ("pose.py", "solve_pose"),
}

#: What is estimated. The price is that of a virtual core on demand, 4.08 USD an hour for the 96 of a c5.24xlarge: example in the
#: Amazon EC2 Auto Scaling user guide, "Spot price per unit hour"; spot instances, which the journal bears, cost less than half.
CASES, CORES, USD_PER_CORE_HOUR = 10_000_000, 1000, 0.0425
DRAWS = 16


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

    @property
    def frames_per_s(self) -> float:
        return self.frames / self.seconds


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
        outcome = study.run_sweep(sweep, folder / "out.nc", crew=partial(Processes, WORKERS))
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
    known: dict[tuple[str, str], float] = {}
    for (file, _, function), (_, _, _, cumulative, _) in stats.stats.items():  # type: ignore[attr-defined]
        known[Path(file).name, function] = known.get((Path(file).name, function), 0.0) + cumulative
    total = stats.total_tt  # type: ignore[attr-defined]
    seconds = {part: known.get(place, 0.0) for part, place in PARTS.items()}
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
        study.run_sweep(load_sweep(path), path.with_suffix(".nc"), crew=NoWork)
        return cases / (time.perf_counter() - start), path.with_suffix(".nc").stat().st_size / cases


def estimate(run: Measured, seen: Profile) -> list[str]:
    """Ten million cases of 16 draws, from a run and its profile: where geometries serve as many cases as here, and but one."""
    cases = run.frames / DRAWS
    lines = []
    for sharing in (cases / run.geometries, 1.0):
        core_h = (
            CASES * (DRAWS * run.core_s / run.frames + (1 / sharing - run.geometries / cases) * seen.geometry_s) / 3600
        )
        lines.append(
            f"{CASES:,} cases, {sharing:.0f} to a geometry: {core_h:,.0f} core-hours, {core_h / CORES:,.1f} h on {CORES:,}, "
            f"{core_h * USD_PER_CORE_HOUR:,.0f} USD at {USD_PER_CORE_HOUR:.4f} USD a core-hour"
        )
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Measure, profile and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--quick", action="store_true", help="a sixteenth of the frames")
    every = 4 if parser.parse_args(arguments).quick else 1
    part = "" if every == 1 else f", 1/{every**2} of them here"
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {WORKERS} workers; 30 720 frames{part}"
    )
    for title, window in (("whole frames", None), ("window of 3 extents", 3.0)):
        run, seen = measure(window, every), profile(window)
        whole_s = run.seconds * every**2
        so = f", so {whole_s:.0f} s for all" if every > 1 else ""
        print(
            f"\n{title}: {run.frames} frames, {run.geometries} geometries, {run.seconds:.0f} s{so} (limit {TARGET_S:.0f}); "
            f"{run.frames_per_s:.0f} frames/s; {run.core_s:.0f} s of processor time, "
            f"{100 * run.core_s / run.seconds / WORKERS:.0f} % of two cores; peak {run.peak_gib:.2f} GiB (limit {TARGET_GIB:g})"
        )
        print(f"one worker alone: {1e3 * seen.frame_s:.1f} ms a frame, {1e3 * seen.geometry_s:.0f} ms a geometry")
        for name, share in sorted(seen.shares.items(), key=lambda item: -item[1]):
            print(f"  {share:6.1%}  {name}")
        print(*estimate(run, seen), sep="\n")
    rate, size = handing_out()
    print(
        f"\none process hands out {rate:,.0f} cases a second: {CASES:,} in {CASES / rate / 3600:.1f} h; "
        f"results take {CASES * size / 2**30:,.0f} GiB"
    )


if __name__ == "__main__":
    main()
