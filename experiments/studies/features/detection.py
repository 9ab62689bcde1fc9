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

from detector.features import find_features
from detector.sensor.noise import noise_of
from detector.sensor.sensor import expose
from experiments import chain
from experiments.chain.executor import pool
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.studies.shared.baseline import to_eight_bits
from experiments.studies.shared.frames import Truth, around_marker, fine_frames
from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from scenes.marker import MarkerDesign, aruco_dictionary

#: The tags under test: name and OpenCV's dictionary.
FAMILIES: Mapping[str, str] = {
    "ArUco 4×4": "4X4_50",
    "Mantis 3×3": "MANTIS_3X3_4",
    "AprilTag 36h11": "APRILTAG_36h11",
}
PX_PER_BIT = (1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 4.0, 6.0)
CNR = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0)
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
    noise, ring_m = noise_of(scenario.sensor, frame), scenario.leds.ring_radius_m
    found = find_features(frame, scenario.marker, camera, noise, ring_m)
    return None if found.corners_px is None else found.corners_px.mean(axis=0)


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
    """One rendered geometry and the exposures that it is looked at with."""

    family: str
    scenario: Scenario
    truth: Truth
    images: FloatArray  # at some sub-pixel positions, (shifts, height, width) [electrons/s]
    shifts: FloatArray
    seconds: tuple[float, ...]
    draws: int
    seed: int


def look(setting: Setting) -> dict[str, NDArray[np.int64]]:
    """Frames in which each detector finds the marker where it is, by exposure."""
    methods = finders(setting.family)
    counts = {name: np.zeros(len(setting.seconds), np.int64) for name in methods}
    camera, rng = setting.truth.view.camera, np.random.default_rng(setting.seed)
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


def settings_of(
    scenario: Scenario, family: str, px_per_bit: float, cnr: tuple[float, ...] | None, attitudes_deg: FloatArray,
    shifts: FloatArray, draws: int, seed: int,
) -> list[Setting]:  # fmt: skip
    """One family's marker at pixels per bit and attitudes (n, 3) of pitch, yaw, roll [deg], rendered together.

    Args:
        cnr: contrasts, by the exposure; None is 'auto' exposure alone.
        shifts: sub-pixel positions of each attitude (n, m, 2) [px].
    """
    marker = MarkerDesign.model_validate(
        {**scenario.marker.model_dump(), "dictionary": FAMILIES[family], "identity": 0}
    )
    range_m = min(scenario.camera.focal_px) * marker.bit_m / px_per_bit
    at = scenario.at(range_m=range_m, marker=marker.model_dump(), illumination="eclipse")
    turned = []
    for attitude in attitudes_deg:
        angles = dict(zip(("pitch_deg", "yaw_deg", "roll_deg"), map(float, attitude), strict=True))
        turned.append(around_marker(at.at(target={**at.target.model_dump(), **angles}), SURROUNDINGS_PX))
    settings = []
    for k, (near, fine) in enumerate(zip(turned, fine_frames(turned, "eclipse"), strict=True)):
        budget = chain.link_budget(near, "eclipse")
        seconds = tuple(exposure_for(budget, c) for c in cnr) if cnr else (chain.solve_exposure(near, budget, "auto"),)
        images = np.array([fine.image(tuple(s)) for s in shifts[k]])
        settings.append(Setting(family, near, Truth(chain.view(near)), images, shifts[k], seconds, draws, seed + k))
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


def study(
    scenario: Scenario, attitudes: int, shifts: int, draws: int, px_per_bit: tuple[float, ...] = PX_PER_BIT,
    cnr: tuple[float, ...] = CNR, workers: int | None = None, progress: Progress | None = None,
    attitudes_at_target: int = 0,
) -> xr.Dataset:  # fmt: skip
    """Counts of frames with the marker found, over family, detector and pixels per bit, and over contrast.

    Every detector of a family sees the same `attitudes · shifts · draws` frames.

    Args:
        attitudes_at_target: attitudes at `AT_PX_PER_BIT`, where more than elsewhere.
    """
    rng = np.random.default_rng(scenario.seed)
    most = max(attitudes, attitudes_at_target)
    angles = rng.uniform(-1, 1, (most, 3)) * (TILT_DEG, TILT_DEG, 180.0)
    places = rng.uniform(-0.5, 0.5, (most, shifts, 2))
    cases = [(f, px, None) for f in FAMILIES for px in px_per_bit] + [(f, PX_PER_BIT_OF_CNR, cnr) for f in FAMILIES]
    names = list(dict.fromkeys(name for family in FAMILIES for name in finders(family)))
    by_size = np.full((len(FAMILIES), len(names), len(px_per_bit)), np.nan)
    by_cnr = np.full((len(FAMILIES), len(names), len(cnr)), np.nan)
    with pool(look, workers) as submit:
        waiting = []
        for k, (family, px, contrasts) in enumerate(cases):
            if progress is not None:
                progress(k, len(cases), f"{family}, {px:g} px/bit")
            used = attitudes if contrasts or px != AT_PX_PER_BIT else most
            for setting in settings_of(
                scenario, family, px, contrasts, angles[:used], places[:used], draws, scenario.seed + 1000 * k
            ):
                waiting.append((family, px, contrasts, submit(setting)))
        for family, px, contrasts, job in waiting:
            row = list(FAMILIES).index(family)
            for name, count in job.result().items():
                table, column = (by_cnr, slice(None)) if contrasts else (by_size, list(px_per_bit).index(px))
                cell = table[row, names.index(name), column]
                table[row, names.index(name), column] = np.where(np.isnan(cell), 0, cell) + (
                    count if contrasts else count[0]
                )
    by_attitude = shifts * draws
    frames = [by_attitude * (most if px == AT_PX_PER_BIT else attitudes) for px in px_per_bit]
    dims = ("family", "detector")
    return xr.Dataset(
        {
            "found_by_size": ((*dims, "px_per_bit"), by_size, {"units": "1", "long_name": "frames with the marker found"}),
            "found_by_cnr": ((*dims, "cnr"), by_cnr, {"units": "1", "long_name": "frames with the marker found"}),
            "frames_by_size": ("px_per_bit", frames, {"units": "1", "long_name": "frames shown to each detector"}),
            "frames_by_cnr": (
                "cnr", [by_attitude * attitudes] * len(cnr), {"units": "1", "long_name": "frames shown to each detector"},
            ),
        },
        {
            "family": list(FAMILIES),
            "detector": names,
            "px_per_bit": ("px_per_bit", list(px_per_bit), {"units": "pixel", "long_name": "pixels per bit, frontal"}),
            "cnr": ("cnr", list(cnr), {"units": "1", "long_name": "contrast-to-noise ratio of a bit, closed form"}),
        },
        {"px_per_bit_of_cnr": PX_PER_BIT_OF_CNR},
    )  # fmt: skip
