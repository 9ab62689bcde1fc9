"""Where no LLVM can be had, the scalar variant gives the same picture, only slower."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.stats import t as student

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.files.exr import read_basis
from scenes.llvm import FORCED_VARIANT, SCALAR_VARIANT
from scenes.marker import MarkerDesign
from scenes.render import stock
from scenes.render.stock import render_subpixels
from scenes.render.transport import LIGHTS, Region, View
from scenes.target import Target

ROOT = Path(__file__).parents[3]
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
NODES = (807, 833, 867, 893)
#: 30° off the axis at the corners, square pixels, no point spread.
WIDE = Camera(
    width_px=320,
    height_px=240,
    focal_length_m=3e-3,
    pixel_pitch_y_m=8.6e-6,
    psf_sigma_px=0.0,
    k1=-0.2,
    k2=0.05,
    p1=1e-3,
    p2=-2e-3,
    k3=-0.004,
)


def view(
    camera: Camera, target: Target, earth: Earth | None = None, range_m: float = 2.0, marker: MarkerDesign | None = None
) -> View:
    sun = Sun(phase_deg=30.0, azimuth_deg=90.0)
    return View(
        camera=camera,
        marker=marker or MarkerDesign(),
        target=target,
        leds=LedRing(count=6),
        sun=sun,
        range_m=range_m,
        nodes_nm=NODES,
        earth=earth,
    )


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


def test_stock_mitsuba_refuses_a_distorted_lens(mi: ModuleType) -> None:
    with pytest.raises(ValueError, match="Mitsuba's own camera has no distortion"):
        render_subpixels(view(WIDE, Target()), Region(0, 0, 8, 8, 1), 0, 833, "sun", 1)
