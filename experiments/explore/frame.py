"""What the page shows of the rendered frame: pictures, histogram, detection, pose, and the three models side by side."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import sensor_noise
from detector.sensor.pair import difference
from detector.sensor.sensor import Sensor, expose
from experiments import chain
from experiments.chain.trials import known_values
from experiments.explore.stock import Prepared
from experiments.reporting import pictures
from experiments.reporting.detection import as_record, describe
from experiments.reporting.formatting import number, percent
from experiments.scenario import Scenario
from radiometry import link
from radiometry.geometry import FloatArray
from radiometry.thesis import PrintedModel

#: Bars of the histogram.
HISTOGRAM_BINS = 96
#: Side of the pictured crop over the marker's side.
CROP_OVER_MARKER = 1.35
#: Width of the picture of the whole frame [px].
OVERVIEW_PX = 376
#: Half axes of the ellipse that holds 95 % of a normal distribution in the plane, over its standard deviations: √(−2 ln 0.05).
ELLIPSE_95 = float(np.sqrt(-2 * np.log(0.05)))


@dataclass(frozen=True)
class Shot:
    """One frame, or the difference of a pair: the image the detector is given, and the frame with LEDs of which it is made."""

    image: FloatArray | NDArray[np.uint16]
    dn: NDArray[np.uint16]
    seen: chain.Detection


def shoot(scenario: Scenario, rate: FloatArray, off_rate: FloatArray | None, seconds: float) -> Shot:
    """One exposure and what the detector finds in it; with the Sun's rate alone, the difference of a pair."""
    frame = chain.expose(scenario, rate, scenario.illumination, seconds).dn
    if off_rate is None:
        return Shot(frame, frame, chain.detect(scenario, frame))
    # The frame without LEDs is the next of the same noise stream.
    rng = chain.frame_generator(scenario, scenario.illumination, seconds, trial=1)
    dark = expose(scenario.sensor, off_rate, seconds, rng).dn
    image, _ = difference(frame, dark, sensor_noise(scenario.sensor))
    return Shot(image, frame, chain.detect(scenario, frame, off=dark))


def rendered(scenario: Scenario, prepared: Prepared, drive: float, pair: bool) -> dict[str, Any]:
    """All that comes from the rendered frame: pictures, histogram, detection, pose, and the three models side by side.

    Args:
        scenario: of the state, LED current included.
        prepared: its geometry at the current of the scenario that was opened.
        drive: LED current over that.
    """
    budgets, illumination = prepared.budgets.scaled(drive), scenario.illumination
    budget, rate = budgets.by_illumination[illumination], prepared.rate(illumination, drive)
    seconds = chain.solve_exposure(scenario, budget, scenario.exposure_s)
    off = np.maximum(prepared.rates[illumination] - prepared.rates["eclipse"], 0.0) if pair else None
    shot = shoot(scenario, rate, off, seconds)
    known = {name: values[0] for name, values in known_values(scenario, illumination, budget, rate, [seconds]).items()}
    return {
        **_pictures(scenario, shot),
        "histogram": histogram(scenario.sensor, shot.dn),
        "detection": as_record(shot.seen),
        "lines": describe(shot.seen),
        "pose": pose_view(scenario, shot.seen),
        "models": models(scenario, budget, known, seconds),
    }


def models(
    scenario: Scenario, budget: chain.LinkBudget, known: dict[str, float], seconds: float
) -> list[dict[str, Any]]:
    """The thesis as printed, the closed form, and the rendered frame before noise: S, B, SNR and CNR of one frame."""
    dark, noise = scenario.sensor.dark_electrons(seconds), scenario.sensor.total_noise_electrons
    printed = PrintedModel().signal_e(scenario.range_m, seconds, sun=scenario.illumination == "sunlit")
    signal, background = known["signal_expected"], known["background_expected"]
    rows = (
        ("the thesis as printed", float(printed), None, known["snr_thesis"], None),
        (
            "closed form",
            known["signal_analytic"],
            known["background_analytic"],
            known["snr_analytic"],
            known["cnr_analytic"],
        ),
        (
            "rendered",
            signal,
            background,
            float(link.snr(signal, dark, noise)),
            float(link.cnr(signal, background, dark, noise)),
        ),
    )
    names = ("signal", "background", "snr", "cnr")
    return [
        {
            "model": model,
            **{n: v for n, v in zip(names, row, strict=True)},
            "texts": ["–" if v is None else number(v) for v in row],
        }
        for model, *row in rows
    ]


def histogram(sensor: Sensor, dn: NDArray[np.uint16]) -> dict[str, Any]:
    """Pixels by charge [electrons], from zero to the converter's end, with the usable well."""
    edges = np.linspace(sensor.offset_dn, sensor.max_dn + 1, HISTOGRAM_BINS + 1)
    counts = np.bincount(dn.ravel(), minlength=sensor.max_dn + 1)[: sensor.max_dn + 1]
    cumulative = np.concatenate([[0], np.cumsum(counts)])
    cut = np.rint(edges).astype(int)
    cut[0] = 0  # noise takes some below the offset
    electrons = (edges - sensor.offset_dn) * sensor.gain_electrons_per_dn
    return {
        "edges": electrons.tolist(),
        "counts": np.diff(cumulative[cut]).tolist(),
        "full_well": chain.usable_well_electrons(sensor),
        "saturated": float(np.mean(dn >= sensor.saturation_dn)),
    }


def _pictures(scenario: Scenario, shot: Shot) -> dict[str, Any]:
    view = chain.view(scenario)
    outline, centre = view.to_image(scenario.marker.corners_m), view.to_image(np.zeros((1, 3)))[0]
    side = scenario.marker.size_m * max(scenario.camera.focal_px) / scenario.range_m * CROP_OVER_MARKER
    image = shot.image if shot.image.dtype == np.uint16 else np.rint(shot.image).astype(np.int32)
    drawn = pictures.marker_picture(image, shot.seen.features, centre, side, outline)
    height, width = image.shape
    scale = min(1.0, OVERVIEW_PX / width)
    size = round(width * scale), round(height * scale)
    small = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    low, high = np.percentile(small, [1, 99.9])
    grey = np.rint(255 * np.sqrt(np.clip((small - low) / max(high - low, 1.0), 0, 1))).astype(np.uint8)
    png = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    return {
        "marker_svg": drawn.svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1),  # to stand alone
        "enlarged": drawn.enlarged,
        "frame_png": base64.b64encode(bytes(png)).decode("ascii"),
        "frame_px": [width, height],
        "crop": [float(v) for v in (*(centre - side / 2), side, side)],
    }


def pose_view(scenario: Scenario, seen: chain.Detection) -> dict[str, Any] | None:
    """Errors of the pose, and 95 % ellipses of its covariance: across the line of sight [mm], and of the tilt [°].

    None without a pose. Attitude is the turn from the estimate to the truth about the camera's x and y axes.
    """
    pose = seen.pose
    if pose is None:
        return None
    view = chain.view(scenario)
    turn, _ = cv2.Rodrigues(view.rotation @ pose.rotation.T)
    off_mm = 1e3 * (view.translation_m - pose.translation_m)
    attitude_rad, range_share = chain.pose_errors(scenario, pose)
    sigma = np.sqrt(np.diag(pose.covariance))
    requirement = scenario.requirement
    off_deg, sigma_deg = float(np.degrees(attitude_rad)), float(np.degrees(np.linalg.norm(sigma[:3])))
    return {
        "attitude_error_deg": off_deg,
        "attitude_text": f"{number(off_deg)}° of {requirement.attitude_error_max_deg:g}° allowed",
        "range_error": range_share,
        "range_text": f"{percent(range_share)} of {percent(requirement.range_error_max)} allowed",
        "sigma_text": f"± {number(sigma_deg)}° attitude, ± {number(1e3 * float(sigma[5]))} mm range",
        "within": off_deg <= requirement.attitude_error_max_deg and range_share <= requirement.range_error_max,
        "ambiguous": pose.ambiguous,
        "across_mm": _ellipse(1e6 * pose.covariance[3:5, 3:5], off_mm[:2]),
        "tilt_deg": _ellipse(np.degrees(np.degrees(pose.covariance[:2, :2])), np.degrees(turn[:2, 0])),
    }


def _ellipse(covariance: FloatArray, truth: FloatArray) -> dict[str, Any]:
    """Half axes and direction of the 95 % ellipse about the estimate, and where the truth lies from it."""
    values, vectors = np.linalg.eigh(covariance)
    half = ELLIPSE_95 * np.sqrt(np.maximum(values, 0))
    distance2 = float(truth @ np.linalg.solve(covariance, truth))
    return {
        "half": [float(half[1]), float(half[0])],
        "angle_deg": float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))),
        "truth": [float(v) for v in truth],
        "inside": distance2 <= ELLIPSE_95**2,
    }
