"""Frames without the marker, rendered and drawn, and how often the detector sees it in them all the same."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from detector.detect import detect
from detector.sensor.sensor import expose
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.chain.statistics import binomial_interval
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

#: A marker of this side is not seen: a rendered face without a marker.
NO_MARKER_M = 1e-4
#: What a frame shows.
KINDS = ("rendered foil", "polygons", "chessboard", "other identities", "speckle", "text and stripes")
#: Of the detector's columns and rows, this many times fewer, from the middle: all, or a quarter that costs as much less.
WHOLE, QUARTER = 1, 2
#: Share of the frames that is rendered; the drawn kinds share the rest.
RENDERED_SHARE = 0.5
#: Brightness of a frame's median pixel over full well, from nearly dark to nearly all saturated; log-uniform.
LEVELS = (0.01, 1.5)


@dataclass(frozen=True)
class Batch:
    """Frames of one kind to be made and searched.

    Attributes:
        rates: electron rates (height, width) that were rendered [e⁻/s]; None where frames are drawn.
    """

    scenario: Scenario
    kind: str
    rates: FloatArray | None
    count: int
    seed: int


def false_markers(batch: Batch) -> tuple[int, int]:
    """Frames in which the detector reports the marker, and those in which it names another identity."""
    rng = np.random.default_rng(batch.seed)
    camera, sensor, marker = batch.scenario.camera, batch.scenario.sensor, batch.scenario.marker
    own = other = 0
    for _ in range(batch.count):
        rate = _turned(batch.rates, rng) if batch.rates is not None else _drawn(batch.kind, batch.scenario, rng)
        level = np.exp(rng.uniform(*np.log(LEVELS))) * sensor.full_well_electrons
        frame = expose(sensor, rate * (level / max(float(np.median(rate)), 1e-3 * float(rate.max()))), 1.0, rng).dn
        ring_m = batch.scenario.leds.ring_radius_m
        found = detect(frame, marker, camera, sensor=sensor, led_ring_radius_m=ring_m).features
        own += found.detected
        other += not found.detected and found.identity is not None
    return own, other


def run(
    scenario: Scenario,
    frames: int,
    renders: int,
    *,
    cut: int = QUARTER,
    workers: int | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Frames, and false markers among them, by kind and by their size.

    Args:
        scenario: camera, lights, marker and target.
        frames: how many are searched.
        workers: processes beside this one; None is one a core.
        progress: called as the work goes on.
        renders: faces that the rendered share of the frames shows.
        cut: the frames are the middle of the detector, this many times fewer columns and rows.
    """
    scenario = middle_of(scenario, cut)
    rng = np.random.default_rng((scenario.seed, cut))
    rendered, drawn = int(frames * RENDERED_SHARE), frames - int(frames * RENDERED_SHARE)
    counts = dict.fromkeys(KINDS, 0)
    own, other = dict.fromkeys(KINDS, 0), dict.fromkeys(KINDS, 0)
    with pool(false_markers, workers) as submit:
        waiting = []
        for k, kind in enumerate(KINDS[1:]):
            share = drawn // (len(KINDS) - 1) + (k < drawn % (len(KINDS) - 1))
            for part, count in enumerate(_portions(share, 20)):
                waiting.append(
                    (kind, count, submit(Batch(scenario, kind, None, count, _seed(scenario, cut, 1 + k, part))))
                )
        for k, count in enumerate(_portions(rendered, -(-rendered // renders))):
            if progress is not None:
                progress(k, renders, "face without a marker")
            waiting.append(
                (
                    KINDS[0],
                    count,
                    submit(Batch(scenario, KINDS[0], _foil(scenario, rng), count, _seed(scenario, cut, 0, k))),
                )
            )
        for kind, count, job in waiting:
            counts[kind] += count
            seen = job.result()
            own[kind] += seen[0]
            other[kind] += seen[1]
    camera, dims = scenario.camera, ("size_px", "kind")
    names = {
        "frames": (counts, "frames without the marker"),
        "false": (own, "frames with a false marker"),
        "false_other": (other, "frames with another identity named"),
    }
    return xr.Dataset(
        {n: (dims, [[c[k] for k in KINDS]], {"units": "1", "long_name": label}) for n, (c, label) in names.items()},
        {"kind": list(KINDS), "size_px": [f"{camera.width_px} × {camera.height_px}"]},
    )


def middle_of(scenario: Scenario, cut: int = QUARTER) -> Scenario:
    """The scenario with the middle of its detector alone, `cut` times fewer columns and rows."""
    camera = scenario.camera
    size = {"width_px": max(camera.width_px // cut, 64), "height_px": max(camera.height_px // cut, 64)}
    return scenario.at(camera={**camera.model_dump(), **size})


def upper_limit(false: int, frames: int) -> float:
    """95 % upper limit of the rate of false markers, one-sided and exact: 3/n where there is none."""
    return float(binomial_interval(np.array(float(false)), frames, 0.90)[1])


def _seed(scenario: Scenario, *part: int) -> int:
    return int(np.random.SeedSequence((scenario.seed, *part)).generate_state(1)[0])


def _portions(total: int, size: int) -> list[int]:
    return [min(size, total - start) for start in range(0, total, size)] if total else []


def _foil(scenario: Scenario, rng: np.random.Generator) -> FloatArray:
    """Crinkled foil in the Sun, glints and all: another crinkle, range, tilt and Sun each time. [electrons/s]."""
    range_m = float(np.exp(rng.uniform(*np.log((1.0, 12.0)))))
    # Foil from one side of the frame to the other, and somewhat less now and then.
    face_m = float(range_m * rng.uniform(0.25, 0.6))
    target = {
        **scenario.target.model_dump(),
        "face_m": max(face_m, 0.05),
        "facet_m": face_m / int(rng.integers(15, 150)),
        "facet_slope_deg": float(rng.uniform(1, 8)),
        "facet_seed": int(rng.integers(2**31)),
        "pitch_deg": float(rng.uniform(-35, 35)),
        "yaw_deg": float(rng.uniform(-35, 35)),
        "roll_deg": float(rng.uniform(-180, 180)),
        "face_material": ("mli_foil", "mli_bare", "aluminium", "white_paint")[int(rng.integers(4))],
    }
    sun = {"phase_deg": float(rng.uniform(0, 90)), "azimuth_deg": float(rng.uniform(-180, 180))}
    marker = {**MarkerDesign().model_dump(), "size_m": NO_MARKER_M}
    render = {**scenario.render.model_dump(), "marker_rays": 10_000, "frame_samples": 2}
    bare = scenario.at(range_m=range_m, target=target, sun=sun, marker=marker, render=render)
    return chain.electron_rate(bare, chain.transport(bare), "sunlit").astype(np.float32)


def _turned(rate: FloatArray, rng: np.random.Generator) -> FloatArray:
    """One of the four mirror images of a frame, moved around cyclically: the detector sees other pixels each time."""
    rate = rate[:: rng.choice((-1, 1)), :: rng.choice((-1, 1))]
    return np.roll(rate, (int(rng.integers(rate.shape[0])), int(rng.integers(rate.shape[1]))), axis=(0, 1))


def _drawn(kind: str, scenario: Scenario, rng: np.random.Generator) -> FloatArray:
    """A drawn frame (height, width), relative brightness, blurred as by the lens."""
    shape = scenario.camera.height_px, scenario.camera.width_px
    draw = {
        "polygons": _polygons,
        "chessboard": _chessboard,
        "speckle": _speckle,
        "text and stripes": _text,
    }
    image = _other_identities(shape, scenario.marker, rng) if kind == "other identities" else draw[kind](shape, rng)
    sigma = max(scenario.camera.psf_sigma_px, 0.3) * float(rng.uniform(1, 2))
    return np.maximum(cv2.GaussianBlur(image, (0, 0), sigma), 0.0)


def _ground(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Smooth shading about one."""
    coarse = rng.normal(0, 0.4, (4, 5)).astype(np.float32)
    return np.exp(cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC))


def _polygons(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Quadrilaterals within quadrilaterals: dark squares in bright frames at every size and contrast."""
    image = _ground(shape, rng)
    for _ in range(int(rng.integers(40, 150))):
        side = float(np.exp(rng.uniform(np.log(6), np.log(120))))
        outline = _square(rng, side)
        centre = rng.uniform((0, 0), shape[::-1])
        level = float(np.exp(rng.uniform(-3, 1)))
        for scale in (1.0, float(rng.uniform(0.6, 0.9))):
            cv2.fillConvexPoly(image, np.rint(centre + scale * outline).astype(np.int32), level)
            level *= float(np.exp(rng.uniform(-4, 1)))
    return image


def _square(rng: np.random.Generator, side: float) -> FloatArray:
    """A square (4, 2) of a side, turned and skewed, about the origin."""
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side
    return square @ (turn * rng.uniform(0.7, 1.0, 2)) + rng.normal(0, 0.04 * side, (4, 2))


def _chessboard(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """A chessboard of random bits or of regular squares, in perspective."""
    cells = np.indices((24, 32)).sum(axis=0) % 2 if rng.random() < 0.3 else rng.random((24, 32)) < rng.uniform(0.3, 0.7)
    size = int(rng.integers(2, 14))
    flat = np.kron(cells.astype(np.float32), np.ones((size, size), np.float32))
    height, width = flat.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    moved = corners + rng.normal(0, 0.08 * width, (4, 2)).astype(np.float32) + rng.uniform(0, 200, 2).astype(np.float32)
    ground = _ground(shape, rng)
    matrix = cv2.getPerspectiveTransform(corners, moved.astype(np.float32))
    seen = cv2.warpPerspective(flat, matrix, shape[::-1], flags=cv2.INTER_LINEAR, borderValue=0.5)
    return ground * (float(rng.uniform(0.02, 0.3)) + seen)


def _other_identities(shape: tuple[int, int], marker: MarkerDesign, rng: np.random.Generator) -> FloatArray:
    """Flat prints of the dictionary's other identities, ring included, of 6 to 60 pixels."""
    from scenes.marker import aruco_dictionary

    image = _ground(shape, rng)
    dictionary = aruco_dictionary(marker.dictionary)
    count = dictionary.markerSize + 2
    others = [k for k in range(len(dictionary.bytesList)) if k != marker.identity]
    for _ in range(25):
        bits = dictionary.generateImageMarker(int(rng.choice(others)), count, borderBits=1) > 127
        ringed = np.pad(np.kron(bits, np.ones((4, 4))), 4, constant_values=1.0)
        print_ = np.pad(ringed, 4).astype(np.float32) * float(np.exp(rng.uniform(-1, 2))) + 0.02
        n = len(print_)
        centre, side = rng.uniform((0, 0), shape[::-1]), float(np.exp(rng.uniform(np.log(12), np.log(90))))
        corners = (centre + _square(rng, side)).astype(np.float32)
        edge = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32) - 0.5
        matrix = cv2.getPerspectiveTransform(edge, corners)
        cv2.warpPerspective(print_, matrix, shape[::-1], image, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)
    return image


def _speckle(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Log-normal speckle of one to twelve pixels, smooth or in facets."""
    grain = float(np.exp(rng.uniform(0, np.log(12))))
    coarse = rng.normal(0, float(rng.uniform(0.2, 1.5)), [int(n / grain) + 2 for n in shape]).astype(np.float32)
    kind = cv2.INTER_CUBIC if rng.random() < 0.5 else cv2.INTER_NEAREST
    return np.exp(cv2.resize(coarse, shape[::-1], interpolation=kind))


def _text(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Writing and parallel stripes."""
    ink = np.zeros(shape, np.uint8)  # OpenCV 5 writes on 8 bits alone
    for _ in range(30):
        word = "".join(chr(c) for c in rng.integers(33, 126, 6))
        x, y = (int(v) for v in rng.uniform((0, 0), shape[::-1]))
        font, scale, weight = int(rng.integers(0, 8)), float(rng.uniform(0.3, 3)), int(rng.integers(1, 5))
        cv2.putText(ink, word, (x, y), font, scale, color=int(rng.integers(40, 256)), thickness=weight)
    image = _ground(shape, rng) * np.exp(ink.astype(np.float32) / 128 * float(rng.choice((-1, 1))))
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    angle, pitch = rng.uniform(0, np.pi), rng.uniform(3, 30)
    stripes = np.sin((column * np.cos(angle) + row * np.sin(angle)) * 2 * np.pi / pitch) > rng.uniform(-0.5, 0.5)
    part = np.zeros(shape, bool)
    left, top = int(rng.integers(shape[1] // 2)), int(rng.integers(shape[0] // 2))
    part[top : top + shape[0] // 2, left : left + shape[1] // 2] = True
    image[stripes & part] *= np.float32(0.1)
    return image


def examples(scenario: Scenario) -> dict[str, NDArray[np.uint16]]:
    """One frame of each kind, as the detector gets it."""
    rng = np.random.default_rng(scenario.seed)
    frames = {}
    for kind in KINDS:
        rate = _foil(scenario, rng) if kind == KINDS[0] else _drawn(kind, scenario, rng)
        level = 0.2 * scenario.sensor.full_well_electrons / max(float(np.median(rate)), 1e-3 * float(rate.max()))
        frames[kind] = expose(scenario.sensor, rate * level, 1.0, rng).dn
    return frames
