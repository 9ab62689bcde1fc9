"""Where no LLVM can be had, the scalar variant gives the same picture, only slower."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy.stats import t as student

from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.files.exr import read_basis
from scenes.llvm import FORCED_VARIANT, SCALAR_VARIANT
from scenes.marker import MarkerDesign
from scenes.render import stock
from scenes.render.transport import LIGHTS, Region, View
from scenes.target import Target

ROOT = Path(__file__).parents[2]
VIEW = View(
    camera=Camera(width_px=48, height_px=40),
    marker=MarkerDesign(size_m=0.05),
    target=Target(pitch_deg=12, yaw_deg=-15),
    leds=LedRing(count=4),
    sun=Sun(),
    range_m=3.0,
    nodes_nm=(807, 833, 867, 893),
)
SEEDS = 20
RENDER = """
import pickle, sys
from scenes.files.exr import write_basis
from scenes.render.transport import Quality, render_basis
import mitsuba as mi
basis = render_basis(pickle.load(open(sys.argv[1], "rb")), Quality(frame_samples=2, marker_rays=1, seed=1))
basis.attributes["variant"] = mi.variant()
write_basis(basis, sys.argv[2])
"""


def test_the_scalar_variant_renders_the_same_scene(mi: ModuleType, tmp_path: Path) -> None:
    """One scalar rendering within the prediction interval of twenty by the same path tracer under LLVM.

    Blocks of 8 × 8 px of both lights and each light's total, Student's t at 99.9 % over all of them (Šidák).
    """
    (tmp_path / "view.pickle").write_bytes(pickle.dumps(VIEW))
    environment = os.environ | {FORCED_VARIANT: SCALAR_VARIANT}
    command = [sys.executable, "-c", RENDER, str(tmp_path / "view.pickle"), str(tmp_path / "scalar.exr")]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    scalar = read_basis(tmp_path / "scalar.exr")
    assert scalar.attributes["variant"] == SCALAR_VARIANT
    assert scalar.nodes_nm == VIEW.nodes_nm

    runs = [stock.render_region(VIEW, Region(0, 0, 48, 40, 2), seed) for seed in range(100, 100 + SEEDS)]
    for light in LIGHTS:
        known, found = (
            image[..., 0, :, :].reshape(*image.shape[:-3], 5, 8, 6, 8).mean(axis=(-3, -1), dtype=float).reshape(-1, 30)
            for image in (np.array([run[light] for run in runs]), scalar.layers[light][None])
        )
        known, found = (np.append(x, x.mean(axis=1, keepdims=True), axis=1) for x in (known, found))
        spread = known.std(axis=0, ddof=1) * np.sqrt(1 + 1 / SEEDS)
        limit = student.isf((1 - 0.999 ** (1 / (2 * 31))) / 2, SEEDS - 1)
        miss = np.abs(found[0] - known.mean(axis=0)) / spread
        assert miss.max() < limit, f"{light}: {miss.max():.1f} of {limit:.1f} standard deviations"
        # The interval of the total is a few per cent, so it says something.
        assert limit * spread[-1] < 0.05 * known.mean()
