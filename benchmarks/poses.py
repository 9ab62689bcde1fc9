"""Poses a second: a 64 × 64 px region in both lights with the foil behind, and where the time goes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.noise import variance_over_signal
from benchmarks.rows import Row, best_seconds, read
from benchmarks.scene import poses, scenario

TITLE = "Poses a second"
TEXT = """
A region of 64 × 64 px at 3.3 m, LED ring and Sun apart, at four wavelengths, with the crinkled foil behind the
marker, in random attitudes. The density is chosen so that the renderer's variance is at most 10 % of shot variance on
every pixel of the ArUco and of the elements (averaged over 5 × 5 pixels), in the exposure that brings the bits to
half of the full well of 20 000 e⁻, as 'auto' does, and in the one that fills it. `720 × 480` is a frame of the
virtual experiment. The table says where the time of a pose goes: planning (regions, lattices), tracing (waiting for
the kernel), gathering rays into pixels, checking the noise, and handing over. Each is measured on the main thread,
while the kernel has all cores. *Triangles only* is the same work with Embree in the place of the closed form of the
marker (`scenes/render/marker_rays.py`). *Before* is the renderer of commit 000323a at its default density, one view at a
time with jittered rays, run in a checkout that MANTIS_BEFORE names (`git worktree add ../before 000323a`); without
one the figures are those kept. The limit is what Embree alone manages on this machine: camera rays into the same
scene, nothing else, not even a hit point.
"""
COLUMNS = "milliseconds of a pose"

#: Environment variable that names a checkout of commit 000323a, whose renderer had one view, jitter and triangles.
_BEFORE = "MANTIS_BEFORE"
_NOISE_BEFORE = "variance before over that as it is"
_STAGES = {
    "plan": ("scenes.render.image.ViewImage.__init__", "scenes.render.batch._Job.blocks"),
    "trace": ("scenes.render.tracer.Traced.arrays", "scenes.render.batch.trace"),
    "gather": ("scenes.render.image.ViewImage.add_tiles", "scenes.render.image.ViewImage.add_box"),
    "check": ("scenes.render.image.ViewImage.more",),
    "hand over": ("scenes.render.image.ViewImage.finish",),
}


def run(quick: bool) -> list[Row]:
    """Poses a second, their noise, the profile, and the bare rate of rays."""
    from scenes.llvm import activate_variant
    from scenes.render.transport import Quality

    variant = activate_variant()
    count = 12 if quick else 180
    rows = []
    region = poses(scenario("camera.width_px=64", "camera.height_px=64", "range_m=3.3"), count)
    for name, electrons, target in (("half the full well", 1e4, "≥ 30"), ("the full well", 2e4, "")):
        quality = Quality(electrons=electrons)
        rate, fractions, lanes = _rate(region, quality)
        rows.append(
            Row(f"64 × 64 px, {name}", rate, "poses/s", target, f"{lanes / 1e3:.0f} thousand rays a pose, {variant}")
        )
        rows.append(Row(f"largest variance over shot variance, {name}", max(fractions), "", "≤ 0.1", f"{count} poses"))
    rate, _, _ = _rate(
        poses(scenario("camera.width_px=720", "camera.height_px=480", "range_m=5"), count // 6), Quality()
    )
    rows.append(Row("720 × 480 px at 5 m", rate, "poses/s"))

    for series, triangles in (("as it is", False), ("triangles only", True)):
        total, stages = _profile(region[: count // 6], triangles)
        rows += [Row(stage, 1e3 * seconds, "ms", series=series) for stage, seconds in stages.items()]
        rows.append(Row("all", 1e3 * total, "ms", series=series))

    rows += _before(quick)

    bare = _bare_rays_per_second(region)
    _, _, lanes = _rate(region[:4], Quality())
    traced = next(row.value for row in rows if row.figure == "trace" and row.series == "as it is")
    rows.append(Row("Embree alone, camera rays", bare / 1e6, "million rays/s"))
    # Every lane is a camera ray and a shadow ray to each light.
    rows.append(Row("this renderer, camera and shadow rays while tracing", 3 * lanes / traced / 1e3, "million rays/s"))
    return rows


def _before(quick: bool) -> list[Row]:
    """The same poses by the checkout that MANTIS_BEFORE names, and its noise over ours; else what was kept of it."""
    if not (folder := os.environ.get(_BEFORE)):
        kept = read("poses")
        return (
            [row for row in kept.rows if row.series.startswith("before") or row.figure == _NOISE_BEFORE] if kept else []
        )
    from scenes.projection.regions import frame_box, marker_pixels
    from scenes.render.transport import Quality, render_cases

    count, seeds = (3, 4) if quick else (10, 6)
    base = ("camera.width_px=64", "camera.height_px=64", "range_m=3.3")
    views = poses(scenario(*base), count)
    attitudes = [
        [*base, *(f"target.{k}={getattr(v.target, k)!r}" for k in ("pitch_deg", "yaw_deg", "roll_deg"))] for v in views
    ]
    with tempfile.TemporaryDirectory() as out:
        request = {"overrides": attitudes, "seeds": seeds, "out": f"{out}/images.npz"}
        done = subprocess.run(
            [sys.executable, "-P", str(Path(__file__).with_name("before_job.py"))],
            input=json.dumps(request),
            capture_output=True,
            text=True,
            check=True,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": folder},
        )
        theirs = dict(np.load(f"{out}/images.npz"))
    answer = json.loads(done.stdout.splitlines()[-1])
    rows = [Row(stage, 1e3 * answer[stage], "ms", series="before") for stage in ("trace", "gather", "all")]
    seen = marker_pixels(views[0], frame_box(views[0]))
    ours = list(render_cases((views[0], Quality(seed=seed)) for seed in range(seeds)))
    ratios = [
        variance_over_signal(images.astype(float), seen.aruco | seen.opening)
        / variance_over_signal(np.array([b.layers[light][0] for b in ours], float), seen.aruco | seen.opening)
        for light, images in theirs.items()
    ]
    return [*rows, Row(_NOISE_BEFORE, float(np.mean(ratios)), note="mean of both lights")]


def _rate(views: list[Any], quality: Any) -> tuple[float, list[float], float]:
    """Poses a second, the largest variance fraction of each, and lanes a pose."""
    from scenes.render import batch, density

    lanes = []
    launch = batch._launch

    def counted(jobs: list[Any]) -> Any:
        lanes.append(sum(job.lanes for job in jobs))
        return launch(jobs)

    list(batch.render_bases(views[: 2 * batch._VIEWS], quality))  # two launches, after which memory is at hand
    with patch.object(batch, "_launch", counted):
        start = time.perf_counter()
        bases = list(batch.render_bases(views, quality))
        seconds = time.perf_counter() - start
    fractions = [max(float(b.attributes[f"{part}_variance_fraction"]) for part in density.PARTS) for b in bases]
    return len(views) / seconds, fractions, sum(lanes) / len(views)


def _profile(views: list[Any], triangles: bool) -> tuple[float, dict[str, float]]:
    """Seconds a pose, in all and on the main thread by stage."""
    from scenes.render import tracer
    from scenes.render.batch import render_bases

    spent = dict.fromkeys(_STAGES, 0.0)
    with ExitStack() as stack:
        for stage, names in _STAGES.items():
            for name in names:
                stack.enter_context(_timed(name, stage, spent))
        if triangles:
            stack.enter_context(_triangles())
        list(render_bases(views[:2]))
        spent.update(dict.fromkeys(spent, 0.0))
        start = time.perf_counter()
        list(render_bases(views))
        total = (time.perf_counter() - start) / len(views)
    tracer._scene.cache_clear()
    return total, {stage: seconds / len(views) for stage, seconds in spent.items()}


@contextmanager
def _timed(name: str, stage: str, spent: dict[str, float]) -> Iterator[None]:
    """Adds the time that a function takes to a stage."""
    from importlib import import_module

    parts = name.split(".")
    owner: Any = import_module(".".join(parts[:2]))
    for part in parts[2:-1]:
        owner = getattr(owner, part)
    function: Callable[..., Any] = getattr(owner, parts[-1])

    def wrapped(*args: Any, **kwargs: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*args, **kwargs)
        finally:
            spent[stage] += time.perf_counter() - start

    with patch.object(owner, parts[-1], wrapped):
        yield


@contextmanager
def _triangles() -> Iterator[None]:
    """Scenes without the marker's closed form."""
    from scenes.render import tracer
    from scenes.render.scene import Scene

    tracer._scene.cache_clear()
    build = Scene.__init__

    def plain(self: Any, *args: Any) -> None:
        build(self, *args)
        self.marker = None

    with patch.object(Scene, "__init__", plain):
        yield


def _bare_rays_per_second(views: list[Any]) -> float:
    """Camera rays through random places of a view, in pixel order, into the triangles: intersections a second."""
    import drjit as dr
    import mitsuba as mi

    from scenes.render.tracer import Kind, _scene

    view = views[0]
    scene = _scene(Kind.of(view).marker, Kind.of(view).surface).solids
    width, height, rays = view.camera.width_px, view.camera.height_px, 256
    rng = np.random.default_rng(1)
    row, column, _ = np.indices((height, width, rays)).reshape(3, -1)
    image = np.stack([column, row], axis=-1) + rng.uniform(-0.5, 0.5, (len(row), 2))
    pixel = np.column_stack([image, np.ones(len(image))])
    direction = pixel @ np.linalg.inv(view.camera.matrix).T @ view.rotation
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = view.to_marker(np.zeros(3)) * 1e3
    ray = mi.Ray3f(
        mi.Point3f(*map(float, origin)),
        mi.Vector3f(*(mi.Float(np.ascontiguousarray(d, np.float32)) for d in direction.T)),
    )
    dr.eval(ray)

    def work() -> None:
        dr.eval(scene.ray_intersect_preliminary(ray).t)
        dr.sync_thread()

    return len(row) / best_seconds(work)
