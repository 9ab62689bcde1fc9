"""Prints how much slower `scalar_spectral` renders than `llvm_ad_spectral`.

First the project's own work, a transport basis of the default geometry; then what it is made of: a plain plate and one of
retroreflective tape that fill the image, with a point source and Mitsuba's `direct` integrator. Each variant runs in a
process of its own. Run it on an idle machine: python benchmarks/variants.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

from scenes.llvm import LLVM_VARIANT, SCALAR_VARIANT, VARIANTS, activate_variant

WIDTH_PX = 128
MATERIALS = {"plain": "diffuse_reference", "tape": "tape_type_ix"}
SAMPLES = {LLVM_VARIANT: {"plain": 256, "tape": 256}, SCALAR_VARIANT: {"plain": 64, "tape": 4}}  # about a second each
REPEATS = 3


def measure(variant: str) -> dict[str, float]:
    """Nanoseconds for one sample (camera ray and light sample), by surface; the best of `REPEATS`, kernels compiled."""
    import numpy as np

    if activate_variant(variant) != variant:
        raise RuntimeError(f"{variant} cannot be had here; see `mantis doctor`")
    import mitsuba as mi

    from materials import library, plugins

    plugins.register()
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 5000], target=[0, 0, 0], up=[0, 1, 0])  # mm
    film = {"type": "hdrfilm", "width": WIDTH_PX, "height": WIDTH_PX, "component_format": "float32"}
    result = {}
    for surface, material in MATERIALS.items():
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
        loaded, samples = mi.load_dict(scene), SAMPLES[variant][surface]
        durations_s = []
        for seed in range(REPEATS + 1):  # the first compiles
            start = time.perf_counter()
            np.array(mi.render(loaded, spp=samples, seed=seed))
            durations_s.append(time.perf_counter() - start)
        result[surface] = min(durations_s[1:]) / (WIDTH_PX**2 * samples) * 1e9
    return result


def basis_seconds() -> float:
    """Seconds for a transport basis at 4 m, at the quality of `mantis budget --quick`, kernels compiled."""
    from radiometry.filters import Bandpass
    from radiometry.optics import Camera, wavelength_nodes
    from radiometry.sources import LedRing, Sun
    from scenes.marker import MarkerDesign
    from scenes.target import Target
    from scenes.transport import Quality, View, render_basis

    nodes = wavelength_nodes(Bandpass().spectrum())
    view = View(Camera(), MarkerDesign(), Target(), LedRing(), Sun(), 4.0, nodes)
    for _ in range(2):  # the first compiles
        start = time.perf_counter()
        render_basis(view, Quality(marker_rays=500_000))
    return time.perf_counter() - start


def main() -> None:
    """Measures both variants and prints the ratios."""
    times = {}
    for variant in VARIANTS:
        done = subprocess.run(
            [sys.executable, __file__, variant],
            stdout=subprocess.PIPE, text=True, check=True, env={**os.environ, "MANTIS_VARIANT": variant},
        )  # fmt: skip
        times[variant] = json.loads(done.stdout)
    fast, slow = times[LLVM_VARIANT]["basis"], times[SCALAR_VARIANT]["basis"]
    print(f"basis  {fast:8.2f} s under LLVM, {slow:8.2f} s scalar: {slow / fast:.0f} times slower")
    for surface in MATERIALS:
        fast, slow = times[LLVM_VARIANT][surface], times[SCALAR_VARIANT][surface]
        print(f"{surface:6} {fast:8.0f} ns a sample under LLVM, {slow:8.0f} scalar: {slow / fast:.0f} times slower")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps({**measure(sys.argv[1]), "basis": basis_seconds()}))
    else:
        main()
