"""Noise draws of one case: what the bits, the detector and the pose solver give over many frames of one exposure.

A case is a scenario's geometry, an illumination and an exposure. Every study that repeats frames calls `draw`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.features import Features
from detector.sensor.sensor import Sensor, usable_well_electrons
from experiments.chain.belief import Belief
from experiments.chain.case import Case
from experiments.chain.detection import detect, pose_errors
from experiments.chain.exposure import camera_pattern, expose
from experiments.chain.link_budget import LinkBudget
from radiometry.geometry import FloatArray

#: Rows and columns of some pixels.
Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]

#: What is known of a case: unit and long name.
VARIABLES: dict[str, tuple[str, str]] = {
    "exposure_s": ("s", "exposure"),
    "signal_analytic": ("electron", "signal of a bright bit, closed form"),
    "background_analytic": ("electron", "signal of a neighbouring dark cell, closed form"),
    "snr_analytic": ("1", "signal-to-noise ratio of a bright bit, closed form"),
    "cnr_analytic": ("1", "contrast-to-noise ratio of a bit, closed form"),
    "signal_expected": ("electron", "signal of a bright bit, rendered, before noise and clipping"),
    "background_expected": ("electron", "signal of a neighbouring dark cell, rendered, before noise and clipping"),
    "signal_rendered": ("electron", "signal of a bright bit, mean over the noise draws of the rendered frames"),
    "background_rendered": ("electron", "signal of a neighbouring dark cell, mean over the noise draws"),
    "snr_rendered": ("1", "signal-to-noise ratio over the noise draws; missing where bits saturate"),
    "snr_rendered_ci95": ("1", "half width of the 95 % interval of snr_rendered"),
    "cnr_rendered": ("1", "contrast-to-noise ratio over the noise draws; missing where bits saturate"),
    "cnr_rendered_ci95": ("1", "half width of the 95 % interval of cnr_rendered"),
    "full_well_fraction": ("1", "expected signal of a bright bit over the usable well"),
    "saturated_fraction": ("1", "share of bright-bit pixels that saturate"),
    "smear_px": ("pixel", "motion of the target during the exposure"),
    "detected_fraction": ("1", "share of frames with a usable pose: marker found, pose not ambiguous"),
    "attitude_error_p95_deg": ("degree", "95th percentile of the attitude error"),
    "range_error_p95": ("1", "95th percentile of the range error over range"),
}


@dataclass(frozen=True)
class Trials:
    """Results of the noise draws of one range, illumination and exposure.

    Attributes:
        values: statistics over the draws, by the names of `VARIABLES`.
        detected, attitude_error_deg, range_error: of each draw; errors are NaN without a pose.
        pose_covariance: mean of what the solver states, (6, 6) of (ω, δt) [rad, m], as `Pose.covariance` of
            `detector.pose.pose`; NaN where no draw gave a pose.
        reason: what most draws miss and why, and in how many of them something is missing; empty where nothing is.
        frame, features: of the first draw.
    """

    values: dict[str, float]
    detected: NDArray[np.bool_]
    attitude_error_deg: FloatArray
    range_error: FloatArray
    pose_covariance: FloatArray
    reason: str
    frame: NDArray[np.uint16]
    features: Features


def known_values(case: Case, budget: LinkBudget, rate: FloatArray, seconds: list[float]) -> dict[str, list[float]]:
    """Per exposure, what needs no noise: closed form, and the rendered expectation.

    Args:
        case: a scenario in an illumination.
        budget: of the case, with the veil of the frame where it has one (`Case.link_budget_beside`).
        rate: electron rate of every pixel (height, width) [e-/s].
        seconds: exposures.
    """
    signal_rate, background_rate = case.bright.mean(rate), case.dark.mean(rate)
    well = usable_well_electrons(case.scenario.sensor)
    values: dict[str, list[float]] = {name: [] for name in VARIABLES}
    for t in seconds:
        analytic = budget.at(t)
        values["exposure_s"].append(t)
        for name in ("signal", "background", "snr", "cnr"):
            values[f"{name}_analytic"].append(analytic[name])
        values["signal_expected"].append(signal_rate * t)
        values["background_expected"].append(background_rate * t)
        values["full_well_fraction"].append((signal_rate * t + analytic["dark"]) / well)
        values["smear_px"].append(analytic["smear_px"])
    return {name: v for name, v in values.items() if v}


def draw(case: Case, rate: FloatArray, seconds: list[float]) -> list[Trials]:
    """Noise draws of every exposure: statistics of the bits, detection and pose."""
    return list(draws(case, rate, seconds))


def draws(case: Case, rate: FloatArray, seconds: list[float]) -> Iterator[Trials]:
    """`draw`, one exposure after the other as they are asked for."""
    bright, dark = case.bright.index, case.dark.index
    for t in seconds:
        yield _draw_exposure(case, rate, t, bright, dark)


def _draw_exposure(case: Case, rate: FloatArray, seconds: float, bright: Pixels, dark: Pixels) -> Trials:
    scenario, sensor, belief = case.scenario, case.scenario.sensor, Belief.of(case.scenario)
    trials = scenario.budget.trials
    signal, background = np.empty((trials, len(bright[0]))), np.empty((trials, len(dark[0])))
    detections, first = [], None
    for trial in range(trials):
        frame = expose(scenario, rate, case.illumination, seconds, trial).dn
        first = frame if first is None else first
        signal[trial], background[trial] = _electrons(sensor, frame[bright]), _electrons(sensor, frame[dark])
        detections.append(detect(belief, frame))
    assert first is not None
    errors = np.array([pose_errors(scenario, s.pose) for s in detections])
    found = np.array([s.usable for s in detections])
    # A frame without a usable pose is as far off as can be: it must not drop out of the percentile.
    counted = np.where(found[:, None], errors, np.inf)
    ceiling = (sensor.saturation_dn - sensor.offset_dn) * sensor.gain_electrons_per_dn
    saturated = float(np.mean(signal >= ceiling - 4 * sensor.total_noise_electrons))
    stated = [s.pose.covariance for s in detections if s.pose is not None]
    values = {
        **_noise_statistics(signal, background, saturated, _pattern_variance(case, signal, bright, background, dark)),
        "saturated_fraction": saturated,
        "detected_fraction": float(found.mean()),
        "attitude_error_p95_deg": _percentile95(np.degrees(counted[:, 0])),
        "range_error_p95": _percentile95(counted[:, 1]),
    }
    return Trials(
        values=values,
        detected=found,
        attitude_error_deg=np.degrees(errors[:, 0]),
        range_error=errors[:, 1],
        pose_covariance=np.mean(stated, axis=0) if stated else np.full((6, 6), np.nan),
        reason=_reason([s.features.reason for s in detections]),
        frame=first,
        features=detections[0].features,
    )


def _pattern_variance(
    case: Case, signal: FloatArray, bright: Pixels, background: FloatArray, dark: Pixels
) -> tuple[float, float]:
    """Variance [electrons²] that the camera's fixed pattern adds to the noise of bright and dark pixels, from its own maps.

    It is constant from frame to frame, so the scatter over draws does not hold it; a flat target that moves over the pixels does.
    """
    pattern = camera_pattern(case.scenario)
    if pattern is None or not signal.size or not background.size:
        return 0.0, 0.0
    found = []
    for level, pixels in ((signal.mean(), bright), (background.mean(), dark)):
        deviation = pattern.prnu[pixels].astype(float) * level + pattern.dsnu_electrons[pixels]
        found.append(float(np.mean(deviation**2)))
    return found[0], found[1]


def _percentile95(values: FloatArray) -> float:
    """95th percentile: the error that 95 % of the frames do not exceed; NaN where a frame without a usable pose stands there."""
    found = float(np.percentile(values, 95, method="inverted_cdf"))
    return found if np.isfinite(found) else np.nan


def _electrons(sensor: Sensor, dn: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Charge that digital numbers stand for [electrons]."""
    return (dn - np.float32(sensor.offset_dn)) * np.float32(sensor.gain_electrons_per_dn)


def _reason(reasons: Sequence[str | None]) -> str:
    """The most frequent of some frames' reasons, with how many frames have any; of equally frequent ones the first."""
    known = Counter(reason for reason in reasons if reason)
    if not known:
        return ""
    text = known.most_common(1)[0][0]
    return text if known.total() == len(reasons) else f"{text} ({known.total()} of {len(reasons)} frames)"


def _noise_statistics(
    signal: FloatArray, background: FloatArray, saturated: float, pattern: tuple[float, float] = (0.0, 0.0)
) -> dict[str, float]:
    """Mean levels, SNR and CNR over noise draws (trials, pixels), with half widths of their 95 % intervals.

    The variance of a pixel is taken over the draws and averaged over pixels: pixels·(trials − 1) degrees of freedom n, so
    its relative standard deviation is √(2/n), and that of a ratio to its root is half of it. To this adds the scatter of the
    means, variance over pixels·trials, which prevails below an SNR of about one. `pattern` is the variance of the fixed pattern.
    """
    means = signal.mean() if signal.size else np.nan, background.mean() if background.size else np.nan
    result = {"signal_rendered": float(means[0]), "background_rendered": float(means[1])}
    names = ("snr_rendered", "snr_rendered_ci95", "cnr_rendered", "cnr_rendered_ci95")
    if saturated > 0.01 or not signal.size or not background.size:
        return {**result, **dict.fromkeys(names, np.nan)}
    variance = [levels.var(axis=0, ddof=1).mean() + v for levels, v in zip((signal, background), pattern, strict=True)]
    freedom = [levels.shape[1] * (len(levels) - 1) for levels in (signal, background)]
    total = variance[0] + variance[1]
    snr, cnr = means[0] / np.sqrt(variance[0]), (means[0] - means[1]) / np.sqrt(total)
    of_means = [v / levels.size for v, levels in zip(variance, (signal, background), strict=True)]
    spread2 = 2 * sum((v / total) ** 2 / n for v, n in zip(variance, freedom, strict=True))
    snr_ci95 = 1.96 * np.sqrt(of_means[0] / variance[0] + snr**2 * 0.5 / freedom[0])
    cnr_ci95 = 1.96 * np.sqrt(sum(of_means) / total + cnr**2 * spread2 / 4)
    return {**result, **dict(zip(names, (snr, snr_ci95, cnr, cnr_ci95), strict=True))}
