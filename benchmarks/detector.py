"""Time of features and pose beside bare ArUco detection, on the same frames in one run."""

from __future__ import annotations

import time

import cv2
import numpy as np

from benchmarks.rows import Row
from detector.features import find_features
from detector.pose.pose import solve_pose
from detector.sensor.noise import noise_of
from experiments import chain
from experiments.scenario import load_scenario
from experiments.studies.shared.baseline import to_eight_bits
from scenes.marker import aruco_dictionary

TITLE = "Features and pose of one frame"
TEXT = """
Frames of 752 × 580 px of the default scenario, in eclipse and in sunlight. `cv2.aruco` as it comes, on the frame stretched
beforehand from its darkest to its brightest pixel to 8 bits, against this project's corners, blobs and pose with their
covariances from the frame in full depth. Both take turns, one thread each, and the medians count.
"""
COLUMNS = "range, light"
_RANGES_M = (1.0, 2.0, 4.0, 8.0, 12.0)
_TARGET = "≤ 1.5"


def run(quick: bool) -> list[Row]:
    """Milliseconds of both, and their ratio, at each range and light."""
    repeats, rows = (15 if quick else 60), []
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for illumination in ("eclipse", "sunlit"):
            for range_m in _RANGES_M:
                rows += _rows(range_m, illumination, repeats)
    finally:
        cv2.setNumThreads(threads)
    return rows


def _rows(range_m: float, illumination: str, repeats: int) -> list[Row]:
    scenario = load_scenario(
        None, (f"range_m={range_m}", f"illumination={illumination}", "target.pitch_deg=10", "target.yaw_deg=3")
    )
    rate = chain.electron_rate(scenario, chain.transport(scenario), illumination)
    seconds = chain.solve_exposure(
        scenario, chain.link_budget_beside(scenario, illumination, rate), scenario.exposure_s
    )
    frame = chain.expose(scenario, rate, illumination, seconds).dn
    camera, noise = chain.view(scenario).camera, noise_of(scenario.sensor, frame)
    eight = to_eight_bits(frame, float(frame.min()), float(frame.max()))
    aruco = cv2.aruco.ArucoDetector(aruco_dictionary(scenario.marker.dictionary))
    ring_m, found, bare, ours = scenario.leds.ring_radius_m, False, [], []
    for _ in range(repeats + 3):
        start = time.perf_counter()
        aruco.detectMarkers(eight)
        middle = time.perf_counter()
        features = find_features(frame, scenario.marker, camera, noise, ring_m)
        pose = solve_pose(features, scenario.marker, camera)
        bare.append(middle - start)
        ours.append(time.perf_counter() - middle)
        found = pose is not None
    # The first few compile and warm up.
    times = {name: float(np.median(spent[3:])) for name, spent in (("cv2.aruco", bare), ("features and pose", ours))}
    where, note = f"{range_m:g} m, {illumination}", "" if found else "marker not found"
    ratio = times["features and pose"] / times["cv2.aruco"]
    timed = [Row(where, 1e3 * spent, "ms", series=name) for name, spent in times.items()]
    return [Row(f"features and pose over cv2.aruco, {where}", ratio, "", _TARGET, note), *timed]
