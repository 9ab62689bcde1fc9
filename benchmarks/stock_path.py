"""Equal noise beside Mitsuba's own path tracer, full frames."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.noise import compare
from benchmarks.rows import Row
from benchmarks.scene import poses, scenario

TITLE = "Beside stock `path`, full frames at equal noise"
TEXT = """
The default camera's whole frame at 3.3 m and 30 deg, both lights. Stock Mitsuba renders the same scene file (`mantis
render --export`) with `path`, direct light only, one light at a time, at one wavelength, with a Gaussian
reconstruction filter as wide as this camera's pixel and point spread; this renderer renders four wavelengths. Noise
is the variance over seeds on the pixels of ArUco and elements over their signal, as shot noise counts it, averaged
over them. Stock is measured at two numbers of samples and carried on, by the power that its noise falls with, to the
noise that this renderer reaches by itself; the ratio is of the times. Loading and compiling are left out on both
sides.
"""


def run(quick: bool) -> list[Row]:
    """Time and noise of both, and the ratio at equal noise."""
    from scenes.llvm import activate_variant

    activate_variant()
    square = "camera.pixel_pitch_y_m=8.6e-6"  # stock's cameras have square pixels
    base = scenario("range_m=3.3", square, *(("camera.width_px=200", "camera.height_px=200") if quick else ()))
    view, seeds = poses(base, 3)[2], 4 if quick else 5
    rows, ratio = compare(
        view, lambda light, samples: _stock(view, light, seeds, samples), "stock `path`", seeds, (4, 16)
    )
    return [*rows, Row("times as fast as stock `path` at equal noise", ratio, "", "≥ 100")]


def _stock(view: Any, light: str, seeds: int, samples: int) -> tuple[float, Any]:
    """Shortest seconds of a frame, and frames at the first wavelength."""
    import mitsuba as mi

    from scenes.render.stock import stock_scene
    from scenes.view import MM_PER_M

    camera, node = view.camera, view.nodes_nm[0]
    sigma = float(np.sqrt(camera.psf_sigma_px**2 + 1 / 12))
    film = {
        "type": "specfilm",
        "width": camera.width_px,
        "height": camera.height_px,
        "component_format": "float32",
        "rfilter": {"type": "gaussian", "stddev": sigma},
        "band": {"type": "regular", "wavelength_min": node - 1.0, "wavelength_max": node + 1.0, "values": "0.5,0.5"},
    }
    strength = {"led": MM_PER_M**2, "sun": 1.0}[light]
    with tempfile.TemporaryDirectory() as folder:
        scene = mi.load_dict(stock_scene(view, {light: strength}, Path(folder), film))
    images, times = [], []
    for seed in range(seeds + 1):
        start = time.perf_counter()
        image = np.array(mi.render(scene, spp=samples, seed=seed), float)
        times.append(time.perf_counter() - start)
        images.append(image.reshape(camera.height_px, camera.width_px))
    return min(times[1:]), np.array(images[1:])
