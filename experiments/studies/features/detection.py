"""How often a marker is found, against its size in pixels and against contrast: our detector beside others on the same frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import brentq

from detector.detect import detect
from detector.sensor.sensor import expose
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.features.plan import Plan
from experiments.studies.shared.baseline import to_eight_bits
from experiments.studies.shared.frames import around_marker, fine_frames
from experiments.studies.shared.truth import Truth
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign, aruco_dictionary

#: The tags under test: name and OpenCV's dictionary.
FAMILIES: Mapping[str, str] = {
    "ArUco 4×4": "4X4_50",
    "Mantis 3×3": "MANTIS_3X3_4",
    "AprilTag 36h11": "APRILTAG_36h11",
}
#: Where the target stands; the size that most frames are spent on.
AT_PX_PER_BIT = 2.0
#: Pixels of a bit where contrast is varied, and the contrast where size is: that of 'auto' exposure.
PX_PER_BIT_OF_CNR = 4.0
#: Tilts are drawn within this about both axes, the roll all around [deg].
TILT_DEG = 10.0
#: Pixels of the scene kept around the marker, for the windows of local thresholds.
SURROUNDINGS_PX = 20

#: A detector: the centre (x, y) of the marker of the right identity [px], or None.
Finder = Callable[[NDArray[np.uint16], Scenario, Camera], FloatArray | None]


def ours(frame: NDArray[np.uint16], scenario: Scenario, camera: Camera) -> FloatArray | None:
    """The detector of this project."""
    ring_m = scenario.leds.ring_radius_m
    corners = detect(
        frame, scenario.marker, camera, sensor=scenario.sensor, led_ring_radius_m=ring_m
    ).features.corners_px
    return None if corners is None else corners.mean(axis=0)


def opencv(frame: NDArray[np.uint16], scenario: Scenario, camera: Camera) -> FloatArray | None:
    """`cv2.aruco` as it comes, on the frame stretched to 8 bits."""
    corners, identities, _ = _aruco(scenario.marker.dictionary).detectMarkers(_stretched(frame))
    for outline, identity in zip(corners, [] if identities is None else np.ravel(identities), strict=True):
        if identity == scenario.marker.identity:
            return np.reshape(outline, (4, 2)).mean(axis=0).astype(float)
    return None


def pupil(frame: NDArray[np.uint16], scenario: Scenario, camera: Camera) -> FloatArray | None:
    """AprilTag 3 by pupil-apriltags at full resolution, on the frame stretched to 8 bits."""
    for tag in _apriltags().detect(_stretched(frame)):
        if tag.tag_id == scenario.marker.identity:
            return np.asarray(tag.corners, float).mean(axis=0) - 0.5  # its pixel centres lie at halves
    return None


def finders(family: str) -> dict[str, Finder]:
    """Detectors of a family of tags by name: ours, and OpenCV's or, where it is installed, AprilTag's own.

    OpenCV's reads AprilTags, too, but takes a third of a second to try all 587 identities on each patch of noise.
    """
    if not FAMILIES[family].startswith("APRILTAG"):
        return {"Mantis": ours, "OpenCV ArUco": opencv}
    return {"Mantis": ours, "pupil-apriltags": pupil} if has_apriltags() else {"Mantis": ours}


def has_apriltags() -> bool:
    """True where the development extra pupil-apriltags is installed."""
    from importlib.util import find_spec

    return find_spec("pupil_apriltags") is not None


def _stretched(frame: NDArray[np.uint16]) -> NDArray[np.uint8]:
    low, high = np.percentile(frame, (0.5, 99.5))
    return to_eight_bits(frame, float(low), max(float(high), float(low) + 1.0))


@lru_cache(maxsize=4)
def _aruco(dictionary: str) -> cv2.aruco.ArucoDetector:
    return cv2.aruco.ArucoDetector(aruco_dictionary(dictionary))


@lru_cache(maxsize=1)
def _apriltags() -> Any:
    from pupil_apriltags import Detector

    return Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)


@dataclass(frozen=True)
class Setting:
    """One rendered geometry and the exposures of its frames.

    Attributes:
        images: electron rates (shifts, height, width) at some sub-pixel positions [e⁻/s].
        shifts: these positions (shifts, 2) [px].
    """

    family: str
    scenario: Scenario
    truth: Truth
    images: FloatArray
    shifts: FloatArray
    seconds: tuple[float, ...]
    draws: int
    seed: int


def count_found(setting: Setting) -> dict[str, NDArray[np.int64]]:
    """Frames in which each detector finds the marker where it is, by exposure."""
    methods = finders(setting.family)
    counts = {name: np.zeros(len(setting.seconds), np.int64) for name in methods}
    camera, rng = setting.scenario.camera, np.random.default_rng(setting.seed)
    centre = setting.truth.view.to_image(np.zeros(3))
    tolerance = setting.scenario.marker.bit_m * max(chain.bit_scale_px(setting.truth.view))
    for k, seconds in enumerate(setting.seconds):
        for image, shift in zip(setting.images, setting.shifts, strict=True):
            for _ in range(setting.draws):
                frame = expose(setting.scenario.sensor, image, seconds, rng).dn
                for name, find in methods.items():
                    place = find(frame, setting.scenario, camera)
                    # Found means found there: within a bit.
                    counts[name][k] += place is not None and bool(np.linalg.norm(place - centre - shift) < tolerance)
    return counts


@dataclass(frozen=True)
class Series:
    """A family's marker at one size.

    Attributes:
        cnr: contrasts, by the exposure; None is 'auto' exposure alone.
    """

    family: str
    px_per_bit: float
    cnr: tuple[float, ...] | None


def settings_of(
    scenario: Scenario, series: Series, attitudes_deg: FloatArray, shifts: FloatArray, draws: int, seed: int
) -> list[Setting]:
    """A series at attitudes (n, 3) of pitch, yaw, roll [deg], rendered together.

    Args:
        scenario: camera, lights, marker and target.
        series: the family's marker at one size.
        attitudes_deg: pitch, yaw and roll of each setting [deg].
        draws: noise draws of each position.
        seed: of the noise.
        shifts: sub-pixel positions of each attitude (n, m, 2) [px].
    """
    marker = MarkerDesign.model_validate(
        {**scenario.marker.model_dump(), "dictionary": FAMILIES[series.family], "identity": 0}
    )
    range_m = min(scenario.camera.focal_px) * marker.bit_m / series.px_per_bit
    at = scenario.at(range_m=range_m, marker=marker.model_dump(), illumination="eclipse")
    turned = []
    for attitude in attitudes_deg:
        angles = dict(zip(("pitch_deg", "yaw_deg", "roll_deg"), map(float, attitude), strict=True))
        turned.append(around_marker(at.at(target={**at.target.model_dump(), **angles}), SURROUNDINGS_PX))
    settings = []
    for k, (near, fine) in enumerate(zip(turned, fine_frames(turned, "eclipse"), strict=True)):
        budget = chain.link_budget(near, "eclipse")
        seconds: tuple[float, ...] = (chain.solve_exposure(near, budget, "auto"),)
        if series.cnr:
            seconds = tuple(exposure_for(budget, cnr) for cnr in series.cnr)
        settings.append(
            Setting(
                family=series.family,
                scenario=near,
                truth=Truth.of(near),
                images=np.array([fine.image(tuple(s)) for s in shifts[k]]),
                shifts=shifts[k],
                seconds=seconds,
                draws=draws,
                seed=seed + k,
            )
        )
    return settings


def exposure_for(budget: chain.LinkBudget, cnr: float) -> float:
    """Exposure [s] at which the closed form gives a contrast-to-noise ratio.

    Raises:
        ValueError: when no exposure up to 100 s does.
    """

    def short(log_seconds: float) -> float:
        return budget.at(float(np.exp(log_seconds)))["cnr"] - cnr

    low, high = np.log(1e-12), np.log(100.0)
    if not short(high) > 0:
        raise ValueError(f"cnr: {cnr:g} is not reached by any exposure up to 100 s")
    return float(np.exp(brentq(short, low, high)))


def run(scenario: Scenario, plan: Plan, workers: int | None = None, progress: Progress | None = None) -> xr.Dataset:
    """Counts of frames with the marker found, over family, detector and pixels per bit, and over contrast.

    Every detector of a family sees the same frames.
    """
    rng = np.random.default_rng(scenario.seed)
    most = max(plan.attitudes, plan.attitudes_at_target)
    angles = rng.uniform(-1, 1, (most, 3)) * (TILT_DEG, TILT_DEG, 180.0)
    places = rng.uniform(-0.5, 0.5, (most, plan.attitude_shifts, 2))
    cases = [Series(family, px, None) for family in FAMILIES for px in plan.px_per_bit]
    cases += [Series(family, PX_PER_BIT_OF_CNR, plan.cnr) for family in FAMILIES]
    names = list(dict.fromkeys(name for family in FAMILIES for name in finders(family)))
    by_size = np.full((len(FAMILIES), len(names), len(plan.px_per_bit)), np.nan)
    by_cnr = np.full((len(FAMILIES), len(names), len(plan.cnr)), np.nan)
    with pool(count_found, workers) as submit:
        waiting = []
        for k, series in enumerate(cases):
            if progress is not None:
                progress(k, len(cases), f"{series.family}, {series.px_per_bit:g} px/bit")
            used = plan.attitudes if series.cnr or series.px_per_bit != AT_PX_PER_BIT else most
            seed = scenario.seed + 1000 * k
            for setting in settings_of(scenario, series, angles[:used], places[:used], plan.attitude_draws, seed):
                waiting.append((series, submit(setting)))
        for series, job in waiting:
            row = list(FAMILIES).index(series.family)
            for name, count in job.result().items():
                cell = (row, names.index(name))
                if series.cnr:
                    by_cnr[cell] = np.nan_to_num(by_cnr[cell]) + count
                else:
                    at = (*cell, plan.px_per_bit.index(series.px_per_bit))
                    by_size[at] = np.nan_to_num(by_size[at]) + count[0]
    by_attitude = plan.attitude_shifts * plan.attitude_draws
    frames = [by_attitude * (most if px == AT_PX_PER_BIT else plan.attitudes) for px in plan.px_per_bit]
    found = {"units": "1", "long_name": "frames with the marker found"}
    shown = {"units": "1", "long_name": "frames shown to each detector"}
    return xr.Dataset(
        {
            "found_by_size": (("family", "detector", "px_per_bit"), by_size, found),
            "found_by_cnr": (("family", "detector", "cnr"), by_cnr, found),
            "frames_by_size": ("px_per_bit", frames, shown),
            "frames_by_cnr": ("cnr", [by_attitude * plan.attitudes] * len(plan.cnr), shown),
        },
        {
            "family": list(FAMILIES),
            "detector": names,
            "px_per_bit": (
                "px_per_bit",
                list(plan.px_per_bit),
                {"units": "pixel", "long_name": "pixels per bit, frontal"},
            ),
            "cnr": (
                "cnr",
                list(plan.cnr),
                {"units": "1", "long_name": "contrast-to-noise ratio of a bit, closed form"},
            ),
        },
        {"px_per_bit_of_cnr": PX_PER_BIT_OF_CNR},
    )
