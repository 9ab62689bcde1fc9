"""The batched renderer against Mitsuba's own path tracer, pixel by pixel."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.files.exr import write_channels
from scenes.marker import MarkerDesign
from scenes.render import stock
from scenes.render.stock import render_subpixels
from scenes.render.transport import LIGHTS, Quality, Region, View, render_basis
from scenes.target import Target

NODE_NM = 807
CAMERA = Camera(width_px=48, height_px=40, pixel_pitch_y_m=8.6e-6)
#: A marker tilted on crinkled foil under a Sun at the default 60 deg, and one turned and nearer, edges and slits across the
#: pixels at other angles, under a low Sun that throws shadows into the elements.
VIEWS = {
    "tilted": View(
        camera=CAMERA,
        marker=MarkerDesign(size_m=0.05),
        target=Target(pitch_deg=12, yaw_deg=-15),
        leds=LedRing(count=6),
        sun=Sun(),
        range_m=3.0,
        nodes_nm=(NODE_NM,) * 4,
    ),
    "turned": View(
        camera=CAMERA,
        marker=MarkerDesign(size_m=0.05),
        target=Target(pitch_deg=-20, yaw_deg=8, roll_deg=33),
        leds=LedRing(count=5),
        sun=Sun(phase_deg=65, azimuth_deg=100),
        range_m=2.2,
        nodes_nm=(NODE_NM,) * 4,
    ),
}
#: Renderings by each; sub-pixels of stock's along a pixel's side.
SEEDS, SAMPLES = 12, 12
#: Of one pixel in this many tests a false alarm is accepted.
ALARM = 0.001


def ours(view: View, seeds: int = SEEDS) -> dict[str, FloatArray]:
    """Images (seeds, height, width) by light at one wavelength."""
    runs = [render_basis(view, Quality(4, 60_000, seed)).layers for seed in range(seeds)]
    return {light: np.array([run[light][0] for run in runs], float) for light in LIGHTS}


@pytest.fixture(scope="module")
def batched(mi: ModuleType) -> dict[str, dict[str, FloatArray]]:
    return {name: ours(view) for name, view in VIEWS.items()}


def path(view: View, light: str) -> FloatArray:
    """Images (seeds, height, width) by stock `path`: direct light in small sub-pixels, gathered with the same kernel."""
    camera = view.camera
    region = Region(0, 0, camera.width_px, camera.height_px, SAMPLES)
    pad = int(np.ceil(4 * camera.psf_sigma_px + 0.5))
    return np.array(
        [
            stock.reduced(render_subpixels(view, region, pad, NODE_NM, light, seed), view, region, pad)
            for seed in range(SEEDS)
        ],
        float,
    )


def z_test(one: FloatArray, other: FloatArray, relative: float, absolute: float) -> tuple[float, FloatArray]:
    """Largest |Z| over its limit, and all |Z| (height, width), of the difference of two sets of renderings.

    Every pixel's mean difference over its standard error, in the normal deviates of Welch's t; the limit is Šidák's for as many
    pixels, as in Mitsuba's own tests of its integrators.

    Args:
        one, other: (seeds, height, width).
        relative, absolute: difference that is known and allowed for: of the pixel's value, and as such.
    """
    parts = [images.var(axis=0, ddof=1) / len(images) for images in (one, other)]
    variance = np.maximum(parts[0] + parts[1], 1e-100)  # pixels that are black in both have none
    shares = [(part / variance) ** 2 / (len(images) - 1) for part, images in zip(parts, (one, other), strict=True)]
    freedom = 1 / np.maximum(sum(shares), 1e-3)  # Welch–Satterthwaite
    mean = one.mean(axis=0)
    difference = np.maximum(np.abs(mean - other.mean(axis=0)) - relative * mean - absolute, 0.0)
    score = norm.isf(np.maximum(student.sf(difference / np.sqrt(variance), freedom), 1e-300))
    limit = norm.isf((1 - (1 - ALARM) ** (1 / score.size)) / 2)
    return float(score.max() / limit), score


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("name", VIEWS)
def test_every_pixel_agrees_with_stock_path(
    batched: dict[str, dict[str, FloatArray]], name: str, light: str, tmp_path: Path
) -> None:
    """Known and allowed for: stock's LED pattern is a texture, whose linear interpolation over cells of h = 2 tan 60° / 512
    lowers cosⁿ by n h²/12 = 1.2e-4 on average near the axis, per direction; its Sun stands at 1 km, 3e-5 rad of parallax, 6e-5
    of a cosine at 63 deg of incidence. An edge within a sub-pixel of width h, whose light all counts alike, may move a pixel by
    h²/8 K' = h²/8 · 0.7 of the contrast (point spread 0.5 px), two edges by twice that.
    """
    mine, theirs = batched[name][light], path(VIEWS[name], light)
    edges = 2 * 0.7 / 8 / SAMPLES**2 * mine.mean(axis=0).max()
    relative = {"led": 2.5e-4, "sun": 6e-5}[light]
    worst, score = z_test(mine, theirs, relative, edges)
    if worst > 1:
        images = {"ours": mine.mean(axis=0), "theirs": theirs.mean(axis=0), "score": score}
        write_channels({key: np.float32(image) for key, image in images.items()}, {}, tmp_path / f"{name}-{light}.exr")
        pytest.fail(f"worst pixel: {worst:.2f} of the limit; images in {tmp_path}")
    # The interval says something: a thousandth of the brightest pixel, in the middle one.
    error = np.sqrt((mine.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / SEEDS)
    assert np.median(error) < 1e-3 * mine.mean(axis=0).max()
    # All pixels together: the total flux, a far tighter interval.
    totals = mine.mean(axis=(1, 2)), theirs.mean(axis=(1, 2))
    spread = np.sqrt(sum(total.var(ddof=1) / SEEDS for total in totals))
    missed = abs(totals[0].mean() - totals[1].mean())
    assert missed < student.isf(ALARM / 2, SEEDS - 1) * spread + relative * totals[0].mean()


def test_the_comparison_would_notice_a_shift_of_a_fiftieth_of_a_pixel(
    batched: dict[str, dict[str, FloatArray]],
) -> None:
    """The power of the test above, shown on the batched renderer alone: 0.03 mm at 3 m."""
    view = VIEWS["tilted"]
    shifted = View(**{name: getattr(view, name) for name in View.__dataclass_fields__})
    object.__setattr__(shifted, "translation_m", np.array([0.02 * 3.0 / CAMERA.focal_px[0], 0.0, 3.0]))
    mine = batched["tilted"]["led"]
    worst, _ = z_test(mine, ours(shifted)["led"], 2.5e-4, 2 * 0.7 / 8 / SAMPLES**2 * mine.mean(axis=0).max())
    assert worst > 1


@pytest.mark.parametrize(("light", "stated", "spp"), [("led", 0.0002, 8), ("sun", 0.007, 48)])
def test_indirect_light_is_as_faint_as_stated(mi: ModuleType, light: str, stated: float, spp: int) -> None:
    """Stock path of up to four segments against two, same seeds: the first two draw the same numbers, so the pairs' spread is
    that of the indirect light alone. Upper end of the 99.9 % interval of the mean.
    """
    scene_view, region = VIEWS["tilted"], Region(0, 0, CAMERA.width_px, CAMERA.height_px, 2)
    seeds = 8
    flux = {
        depth: np.array(
            [
                render_subpixels(scene_view, region, 0, 850, light, seed=seed, spp=spp, depth=depth).mean(dtype=float)
                for seed in range(seeds)
            ]
        )
        for depth in (2, 4)
    }
    extra = (flux[4] - flux[2]) / flux[2].mean()
    assert extra.mean() > 0
    assert extra.mean() + student.isf(0.001, seeds - 1) * extra.std(ddof=1) / np.sqrt(seeds) < stated
