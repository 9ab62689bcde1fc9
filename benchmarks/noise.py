"""Equal noise: how long another renderer takes to be as quiet as this one."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.rows import Row

#: Seconds of a frame and frames (seeds, height, width) per unit strength, of a light at so many samples a pixel.
Peer = Callable[[str, int], tuple[float, Any]]


def variance_over_signal(images: Any, pixels: Any) -> float:
    """Variance over seeds over signal, as shot noise counts it; mean over the pixels that are lit."""
    mean = images.mean(axis=0)
    lit = pixels & (mean > 1e-3 * np.percentile(mean[pixels], 98))
    return float(np.mean(images[:, lit].var(axis=0, ddof=1) / mean[lit]))


def compare(view: Any, peer: Peer, name: str, seeds: int, samples: tuple[int, int]) -> tuple[list[Row], float]:
    """Rows of both renderers' times and noise, and how many times longer the peer takes to this renderer's noise.

    The peer is measured at two numbers of samples. Its time is taken as a constant and a part in proportion to them, its noise as
    a power of them, and both are carried on to this renderer's noise.
    """
    from scenes.projection.regions import frame_box, marker_pixels
    from scenes.render.transport import Quality, render_bases, render_cases

    seen = marker_pixels(view, frame_box(view))
    pixels = seen.aruco | seen.opening
    list(render_bases([view]))
    start = time.perf_counter()
    ours = list(render_cases((view, Quality(seed=seed)) for seed in range(seeds)))
    ours_s = (time.perf_counter() - start) / seeds
    rows = [Row("this renderer, a frame in both lights", ours_s, "s")]
    total = 0.0
    for light in view.lights:
        images = np.array([basis.layers[light][0] for basis in ours], float)
        quiet = variance_over_signal(images, pixels)
        (first_s, _), (last_s, _) = found = [peer(light, n) for n in samples]
        first, last = (variance_over_signal(frames, pixels) for _, frames in found)
        power = float(np.clip(np.log(first / last) / np.log(samples[1] / samples[0]), 1.0, 2.0))
        needed = samples[1] * (last / quiet) ** (1 / power)
        per_sample = max(last_s - first_s, 0.0) / (samples[1] - samples[0])
        total += last_s + per_sample * (needed - samples[1])
        flux = found[1][1][:, pixels].mean() / images[:, pixels].mean()
        rows += [
            Row(f"{name}, {light}, {samples[1]} samples a pixel", last_s, "s", note=f"flux {flux:.4f} of ours"),
            Row(
                f"its variance over ours, {light}",
                last / quiet,
                note=f"falls with its samples to the power {power:.2f}",
            ),
            Row(f"its samples a pixel for our noise, {light}", needed),
        ]
    return rows, total / ours_s
