"""How much slower `scalar_spectral` renders than `llvm_ad_spectral`.

Each variant runs in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

import numpy as np

from benchmarks.rows import Row
from scenes.llvm import FORCED_VARIANT, LLVM_VARIANT, SCALAR_VARIANT, VARIANTS, activate_variant

TITLE = "Without a libLLVM"
TEXT = """
Where no libLLVM can be had, Mitsuba's scalar variant renders with its own path tracer. First the project's own work,
a transport basis at 4 m with 500 000 rays on the marker; then what it is made of: a plain plate and one of
retroreflective tape that fill the image, with a point source and Mitsuba's `direct` integrator.
"""
COLUMNS = "work"

_WIDTH_PX = 128
_MATERIALS = {"plain": "diffuse_reference", "tape": "tape_type_ix"}
_SAMPLES = {LLVM_VARIANT: {"plain": 256, "tape": 256}, SCALAR_VARIANT: {"plain": 64, "tape": 4}}  # about a second each
_REPEATS = 3


def run(quick: bool) -> list[Row]:
    """Times of both variants and their ratios."""
    times: dict[str, dict[str, float]] = {}
    for variant in VARIANTS:
        code = f"from benchmarks.variants import job; job({variant!r}, {quick!r})"
        environment = {**os.environ, FORCED_VARIANT: variant}
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True, env=environment
        )
        times[variant] = json.loads(done.stdout.splitlines()[-1])
    rows = []
    for work, fast in times[LLVM_VARIANT].items():
        ratio = times[SCALAR_VARIANT].get(work, np.nan) / fast
        rows.append(Row(f"scalar over LLVM, {work}", ratio, "", note=f"{fast:.3g} s under LLVM"))
    return rows


def job(variant: str, quick: bool) -> None:
    """Print a variant's times as JSON."""
    if activate_variant(variant) != variant:
        raise RuntimeError(f"{variant} cannot be had here; see `mantis doctor`")
    times = _surfaces(variant)
    if not quick:
        times["transport basis"] = _basis_seconds()
    print(json.dumps(times))


def _surfaces(variant: str) -> dict[str, float]:
    """Seconds of a million samples (camera ray and light sample), by surface; the best of some, kernels compiled."""
    import mitsuba as mi

    from materials import library, plugins

    plugins.register()
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 5000], target=[0, 0, 0], up=[0, 1, 0])  # mm
    film = {"type": "hdrfilm", "width": _WIDTH_PX, "height": _WIDTH_PX, "component_format": "float32"}
    result = {}
    for surface, material in _MATERIALS.items():
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "direct"},
            "plate": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale(1000),
                "bsdf": plugins.bsdf_dict(library.load(material)),
            },
            "source": {"type": "point", "position": [40, 0, 5000], "intensity": {"type": "uniform", "value": 1e6}},
            "sensor": {"type": "perspective", "fov": 5, "to_world": view, "film": film},
        }
        loaded, samples = mi.load_dict(scene), _SAMPLES[variant][surface]
        durations_s = []
        for seed in range(_REPEATS + 1):  # the first compiles
            start = time.perf_counter()
            np.array(mi.render(loaded, spp=samples, seed=seed))
            durations_s.append(time.perf_counter() - start)
        result[f"a million samples of {surface} surface"] = min(durations_s[1:]) / (_WIDTH_PX**2 * samples) * 1e6
    return result


def _basis_seconds() -> float:
    """Seconds for a transport basis at 4 m, kernels compiled."""
    from experiments import chain
    from experiments.scenario import load_scenario
    from scenes.render.transport import Quality, render_basis

    view = chain.view(load_scenario(overrides=("range_m=4",)))
    seconds = 0.0
    for _ in range(2):  # the first compiles
        start = time.perf_counter()
        render_basis(view, Quality(marker_rays=500_000))
        seconds = time.perf_counter() - start
    return seconds
