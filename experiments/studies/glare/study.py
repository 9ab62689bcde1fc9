"""Sun glare: detection and pose over phase angle, azimuth and range, for each counter-measure of `experiments.studies.glare.modes`.

Frames are crops about the marker, drawn from the rendered rates of `experiments.studies.glare.geometry`; false positives are also looked
for on whole frames, by asking for identities that are not there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr

from detector.features import Features
from detector.pose.pose import solve_pose
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.glare.geometry import Geometry, Stand, at_sun, cropped, render
from experiments.studies.glare.modes import MODES, Exposed, Mode, features_of, pulse_s, rung_exposures_s, take
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES

#: A quadrilateral further than this from the marker's, rms over corners and in bits, is another thing.
MISPLACED_BITS = 1.0
#: Identities looked for on whole frames that do not hold them.
ABSENT_IDENTITIES = (7, 23)
#: Geometries drawn or waiting at a time, so that few rendered frames are held.
_IN_FLIGHT = 8


@dataclass(frozen=True)
class Plan:
    """What is walked through.

    Attributes:
        stands: attitudes of the target and crinkles of its foil.
        draws: frames of one stand, Sun and mode.
        pair_interval_s: from the frame with LEDs to the one without; default the thesis's frame time.
        rays: of one rendering of a crop.
        whole_range_m, whole_azimuths_deg: of the whole frames.
    """

    ranges_m: tuple[float, ...] = (2.0, 5.0, 9.0)
    phases_deg: tuple[float, ...] = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 150.0)
    azimuths_deg: tuple[float, ...] = (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
    stands: tuple[Stand, ...] = (Stand(-4, 7, 10, 1), Stand(14, -18, -30, 2))
    draws: int = 8
    modes: tuple[str, ...] = tuple(MODES)
    pair_interval_s: float = 1 / 30
    rays: int = 200_000
    whole_range_m: float = 5.0
    whole_azimuths_deg: tuple[float, ...] = (60.0, 240.0)

    def suns(self) -> Iterator[tuple[int, int, int, int]]:
        """Indices of stand, range, phase and azimuth; stands outermost, as the renderer keeps the scenes of a few crinkles."""
        yield from product(*map(range, map(len, (self.stands, self.ranges_m, self.phases_deg, self.azimuths_deg))))


FULL = Plan()
QUICK = Plan(
    ranges_m=(5.0,), phases_deg=(0.0, 2.0, 20.0, 75.0), azimuths_deg=(0.0, 120.0, 240.0), stands=FULL.stands[:1], draws=3,
    whole_azimuths_deg=(60.0,),
)  # fmt: skip

#: What is kept of every frame: unit and long name.
VARIABLES = {
    "detected": ("1", "marker found at its place"),
    "false_positive": ("1", "a marker found elsewhere, or another identity remarked"),
    "attitude_error_deg": ("degree", "attitude error"),
    "range_error": ("1", "range error over range"),
    "corner_error_x_px": ("pixel", "mean error of the corners along x"),
    "corner_error_y_px": ("pixel", "mean error of the corners along y"),
    "corner_error_max_px": ("pixel", "largest distance of a corner from its place"),
    "saturated_fraction": ("1", "share of bright-bit pixels that saturate in the frame with LEDs"),
    "cnr": ("1", "expected contrast-to-noise ratio of a bit; missing where bits saturate"),
    "pulse_s": ("s", "LED pulse"),
}
DIMS = ("mode", "range_m", "phase_deg", "azimuth_deg", "frame")


class Truth:
    """What a geometry holds: corners, blobs and the pixels of the bits."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, marker = scenario, scenario.marker
        self.view = chain.view(scenario)
        self.corners_px = self.view.to_image(marker.corners_m)
        self.bit_px = marker.bit_m * min(chain.bit_scale_px(self.view))
        camera_m = self.view.to_marker(np.zeros(3))
        on_line = [
            e.centre_m + np.array([[u], [u + 1e-4]]) * e.along
            for e in marker.elements
            for u in [e.blob_offset_m(camera_m)]
        ]
        ends = self.view.to_image(np.array(on_line))
        self.blobs_px, slope = ends[:, 0], ends[:, 1] - ends[:, 0]
        self.along = slope / np.linalg.norm(slope, axis=1, keepdims=True)
        self.white = _joined(chain.bit_pixels(self.view, marker.white_bit_centres_m()))
        self.black = _joined(chain.bit_pixels(self.view, marker.black_bit_centres_m()))

    def bits(self, image: FloatArray) -> tuple[float, float]:
        """Mean of an image over the pixels of the bright bits and of the dark cells beside them."""
        return float(image[self.white].mean()), float(image[self.black].mean())

    def judge(self, features: Features) -> dict[str, float]:
        """Detection, false positive, and errors of corners and pose of one frame; errors are NaN where not detected."""
        marker = self.scenario.marker
        if features.corners_px is None:
            return {"detected": 0.0, "false_positive": float(features.identity not in (None, marker.identity))}
        error = features.corners_px - self.corners_px
        if np.sqrt(np.mean(np.sum(error**2, axis=1))) > MISPLACED_BITS * self.bit_px:
            return {"detected": 0.0, "false_positive": 1.0}
        attitude, distance = chain.pose_errors(self.scenario, solve_pose(features, marker, self.scenario.camera))
        x, y = error.mean(axis=0)
        return {
            "detected": 1.0, "false_positive": 0.0, "attitude_error_deg": float(np.degrees(attitude)), "range_error": distance,
            "corner_error_x_px": float(x), "corner_error_y_px": float(y),
            "corner_error_max_px": float(np.linalg.norm(error, axis=1).max()),
        }  # fmt: skip

    def blob_errors(self, features: Features) -> FloatArray:
        """Error of each blob along its element, (4,) [px]; NaN where not found."""
        found = [features.blobs_px.get(name) for name in ELEMENT_NAMES]
        at = np.array([np.full(2, np.nan) if p is None else p for p in found])
        return np.sum((at - self.blobs_px) * self.along, axis=1)


def _joined(pixels: list) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([p[0] for p in pixels]), np.concatenate([p[1] for p in pixels])


def expected_cnr(
    scenario: Scenario, mode: Mode, led: tuple[float, float], sun: tuple[float, float], pulse: float, off_scale: float
) -> float:
    """CNR of a bit from mean rates of bright and dark pixels [e⁻/s]; NaN where the bright one would fill the well.

    A difference has the LEDs' contrast alone, and as noise the Sun's and the reading of both frames, the second times
    `off_scale`. A ladder is read from its longest exposure that the bright bit does not fill.
    """
    shutter, well = pulse if mode.shutter_s is None else mode.shutter_s, chain.usable_well_electrons(scenario.sensor)
    rungs = [s / pulse for s in rung_exposures_s(scenario, mode, pulse)] if len(mode.rungs) > 1 else [1.0]
    fitting = [rung for rung in rungs if rung * (led[0] * pulse + sun[0] * shutter) <= well]
    if not fitting:
        return np.nan
    bright, dark = ((fitting[0] * a * pulse, fitting[0] * b * shutter) for a, b in zip(led, sun, strict=True))
    subtracts = bool(mode.pair or mode.off_filter)
    second = off_scale if subtracts else 0.0
    contrast = bright[0] - dark[0] + (0 if subtracts else bright[1] - dark[1])
    # The second frame holds the Sun over its scale, and counts by the scale's square.
    noise2 = bright[0] + dark[0] + (1 + second) * (bright[1] + dark[1])
    noise2 += (1 + second**2) * 2 * scenario.sensor.total_noise_electrons**2
    return float(contrast / np.sqrt(noise2))


def frames(
    geometry: Geometry, truth: Truth, name: str, draws: int, key: tuple[int, ...]
) -> Iterator[tuple[Exposed, Features, dict[str, float]]]:
    """Images of one mode with their features and `VARIABLES`; `key` seeds their noise, alike for all modes."""
    mode, scenario, lit = MODES[name], geometry.scenario, geometry.lit(MODES[name])
    led, sun = truth.bits(lit.led), truth.bits(lit.sun)
    seconds = pulse_s(scenario, mode, led[0], sun[0])
    sensor, contrast = scenario.sensor, expected_cnr(scenario, mode, led, sun, seconds, lit.off_scale)
    ceiling = sensor.saturation_dn - 4 * sensor.total_noise_electrons / sensor.gain_electrons_per_dn
    for k in range(draws):
        rng = np.random.default_rng((scenario.seed, *key, k))
        shown = take(scenario, mode, lit, seconds, geometry.motion_px, rng)
        features = features_of(scenario, mode, shown)
        saturated = float(np.mean(shown.lit_dn[truth.white] >= ceiling))
        yield (
            shown,
            features,
            truth.judge(features) | {"saturated_fraction": saturated, "cnr": contrast, "pulse_s": seconds},
        )


def draw(geometry: Geometry, modes: tuple[str, ...], draws: int, key: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """All modes of a geometry: `VARIABLES` (variables, modes, draws) and blob errors (modes, draws, elements) [px]."""
    truth = Truth(geometry.scenario)
    values = np.full((len(VARIABLES), len(modes), draws), np.nan)
    blobs = np.full((len(modes), draws, len(ELEMENT_NAMES)), np.nan)
    for m, name in enumerate(modes):
        if name == "shadowed" and "single" in modes[:m] and geometry.free[MODES[name].chaser_radius_m].min() == 1:
            # No shadow falls: the very same frames.
            values[:, m], blobs[m] = values[:, modes.index("single")], blobs[modes.index("single")]
            continue
        for k, (_, features, frame) in enumerate(frames(geometry, truth, name, draws, key)):
            values[:, m, k] = [frame.get(variable, np.nan) for variable in VARIABLES]
            if frame["detected"]:
                blobs[m, k] = truth.blob_errors(features)
    return values, blobs


def run(scenario: Scenario, plan: Plan, progress: Progress | None = None, workers: int | None = None) -> xr.Dataset:
    """The labelled result of a plan; `workers` processes draw the frames that this one renders."""
    count = len(plan.stands) * plan.draws
    shape = (len(plan.modes), len(plan.ranges_m), len(plan.phases_deg), len(plan.azimuths_deg), count)
    values = np.full((len(VARIABLES), *shape), np.nan, np.float32)
    blobs = np.full((*shape, len(ELEMENT_NAMES)), np.nan, np.float32)
    waiting: deque[tuple[tuple[int, int, int, int], Future]] = deque()

    def collect() -> None:
        (s, r, p, a), future = waiting.popleft()
        part = slice(s * plan.draws, (s + 1) * plan.draws)
        values[:, :, r, p, a, part], blobs[:, r, p, a, part] = future.result()

    suns = list(plan.suns())
    with pool(draw, workers) as submit:
        for done, (s, r, p, a) in enumerate(suns):
            here = at_sun(scenario, plan.ranges_m[r], plan.phases_deg[p], plan.azimuths_deg[a], plan.stands[s])
            geometry = render(cropped(here), plan.modes, plan.pair_interval_s, plan.rays)
            waiting.append(((s, r, p, a), submit(geometry, plan.modes, plan.draws, (s, r, p, a))))
            while len(waiting) > _IN_FLIGHT:
                collect()
            if progress:
                progress(done + 1, len(suns), f"{plan.ranges_m[r]:g} m, phase {plan.phases_deg[p]:g}°")
        while waiting:
            collect()
    data: dict[str, tuple] = {
        name: (DIMS, v, dict(zip(("units", "long_name"), VARIABLES[name], strict=True)))
        for name, v in zip(VARIABLES, values, strict=True)
    }
    data["blob_error_px"] = (
        (*DIMS, "element"),
        blobs,
        {"units": "pixel", "long_name": "error of a blob along its element"},
    )
    coordinates = {
        "mode": list(plan.modes), "range_m": list(plan.ranges_m), "phase_deg": list(plan.phases_deg),
        "azimuth_deg": list(plan.azimuths_deg), "stand": ("frame", np.arange(count) // plan.draws),
        "element": list(ELEMENT_NAMES), "px_per_bit": ("range_m", [_px_per_bit(scenario, plan, r) for r in plan.ranges_m]),
    }  # fmt: skip
    attributes = {"title": "Sun glare", "pair_interval_s": plan.pair_interval_s, **chain.provenance(scenario)}
    return xr.Dataset(data, coordinates, attributes)


def _px_per_bit(scenario: Scenario, plan: Plan, range_m: float) -> float:
    """Pixels along a bit's shorter side, the least of all stands."""
    return min(Truth(at_sun(scenario, range_m, 0, 0, stand)).bit_px for stand in plan.stands)


def false_positives(scenario: Scenario, plan: Plan, modes: tuple[str, ...]) -> xr.Dataset:
    """Markers found on whole frames that do not hold them: (mode, phase_deg) counts and the searches made.

    Every frame is searched for each of `ABSENT_IDENTITIES`: `found` counts those found with corners, `remarked` those searches
    that give another identity than the marker's own as a reason, without corners.
    """
    found, remarked = np.zeros((2, len(modes), len(plan.phases_deg)), int)
    for (p, phase), (a, azimuth) in product(enumerate(plan.phases_deg), enumerate(plan.whole_azimuths_deg)):
        stand = plan.stands[(p + a) % len(plan.stands)]
        here = at_sun(scenario, plan.whole_range_m, phase, azimuth, stand)
        geometry = render(here, modes, plan.pair_interval_s, 4 * here.camera.width_px * here.camera.height_px)
        truth = Truth(here)
        absent = [
            here.model_copy(update={"marker": here.marker.model_copy(update={"identity": k})})
            for k in ABSENT_IDENTITIES
        ]
        for m, name in enumerate(modes):
            for shown, _, _ in frames(geometry, truth, name, 1, (99, p, a)):
                for other in absent:
                    features = features_of(other, MODES[name], shown)
                    found[m, p] += features.detected
                    remarked[m, p] += not features.detected and features.identity not in (None, here.marker.identity)
    searches = len(plan.whole_azimuths_deg) * len(ABSENT_IDENTITIES)
    return xr.Dataset(
        {
            "found": (("mode", "phase_deg"), found),
            "remarked": (("mode", "phase_deg"), remarked),
            "searches": (("mode", "phase_deg"), np.full(found.shape, searches)),
        },
        {"mode": list(modes), "phase_deg": list(plan.phases_deg)},
    )
