"""Frames of one geometry in one mode: exposed, searched by the mode's pipeline, and compared with the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from detector.detect import Detection
from detector.sensor.noise import sensor_noise
from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.glare.geometry import Geometry
from experiments.studies.glare.modes import MODES, Mode, ModeImage, bracket_exposures_s, detect, expose_mode, pulse_s
from experiments.studies.shared.truth import MISPLACED_BITS, Truth
from radiometry.geometry import FloatArray
from scenes.marker import ELEMENT_NAMES

#: What is kept of every frame: unit and long name.
VARIABLES: Mapping[str, tuple[str, str]] = {
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


@dataclass(frozen=True)
class JudgedFrame:
    """One image of a mode, what was found in it, and `VARIABLES`; those that are not known are left out."""

    image: ModeImage
    detection: Detection
    values: dict[str, float]


def labelled(values: FloatArray, dims: tuple[str, ...]) -> dict[str, tuple]:
    """Values (variables, *dims) as variables of a dataset, with unit and long name."""
    return {
        name: (dims, value, {"units": unit, "long_name": long_name})
        for (name, (unit, long_name)), value in zip(VARIABLES.items(), values, strict=True)
    }


def judge(scenario: Scenario, truth: Truth, detection: Detection) -> dict[str, float]:
    """Detection, false positive, and errors of corners and pose of one frame; without errors where not detected."""
    features = detection.features
    if features.corners_px is None:
        other = features.identity not in (None, scenario.marker.identity)
        return {"detected": 0.0, "false_positive": float(other)}
    error = features.corners_px - truth.corners_px
    if np.sqrt(np.mean(np.sum(error**2, axis=1))) > MISPLACED_BITS * truth.px_per_bit:
        return {"detected": 0.0, "false_positive": 1.0}
    attitude, distance = chain.pose_errors(scenario, detection.pose)
    x, y = error.mean(axis=0)
    return {
        "detected": 1.0,
        "false_positive": 0.0,
        "attitude_error_deg": float(np.degrees(attitude)),
        "range_error": distance,
        "corner_error_x_px": float(x),
        "corner_error_y_px": float(y),
        "corner_error_max_px": float(np.linalg.norm(error, axis=1).max()),
    }


@dataclass(frozen=True)
class BitRates:
    """Mean electron rates of the pixels of bright bits and of the dark cells beside them [e⁻/s]."""

    bright: float
    dark: float


def expected_cnr(
    scenario: Scenario, mode: Mode, led: BitRates, sun: BitRates, pulse: float, off_scale: float = 1.0
) -> float:
    """Contrast-to-noise ratio of a bit in a mode; NaN where the bright bit would fill the well.

    A difference has the LEDs' contrast alone, and as noise the Sun's and the reading of both frames, the second times
    `off_scale`. An exposure bracket is read from its longest exposure that the bright bit does not fill.

    Args:
        scenario: camera, lights, marker and target.
        mode: the counter-measure.
        led: electron rates of the bits by the LEDs alone.
        sun: the same by the Sun alone.
        pulse: LED pulse [s].
        off_scale: factor on the frame that is subtracted.
    """
    shutter = pulse if mode.shutter_s is None else mode.shutter_s
    well = chain.usable_well_electrons(scenario.sensor)
    shares = [s / pulse for s in bracket_exposures_s(scenario, mode, pulse)] if len(mode.bracket) > 1 else [1.0]
    fitting = [share for share in shares if share * (led.bright * pulse + sun.bright * shutter) <= well]
    if not fitting:
        return np.nan
    led_bright, led_dark = fitting[0] * led.bright * pulse, fitting[0] * led.dark * pulse
    sun_bright, sun_dark = fitting[0] * sun.bright * shutter, fitting[0] * sun.dark * shutter
    subtracts = bool(mode.pair or mode.off_filter)
    second = off_scale if subtracts else 0.0
    contrast = led_bright - led_dark + (0 if subtracts else sun_bright - sun_dark)
    # The second frame holds the Sun over its scale, and counts by the scale's square.
    noise2 = led_bright + led_dark + (1 + second) * (sun_bright + sun_dark)
    noise2 += (1 + second**2) * 2 * scenario.sensor.total_noise_electrons**2
    return float(contrast / np.sqrt(noise2))


def frames(geometry: Geometry, truth: Truth, name: str, draws: int, key: tuple[int, ...]) -> Iterator[JudgedFrame]:
    """Frames of one mode; `key` seeds their noise, alike for all modes."""
    mode, scenario = MODES[name], geometry.scenario
    rates = geometry.mode_rates(mode)
    led, sun = BitRates(*truth.bits(rates.led)), BitRates(*truth.bits(rates.sun))
    seconds = pulse_s(scenario, mode, led.bright, sun.bright)
    known = {"cnr": expected_cnr(scenario, mode, led, sun, seconds, rates.off_scale), "pulse_s": seconds}
    noise = sensor_noise(scenario.sensor)
    full_dn = noise.saturation_dn - 4 * noise.read_noise_dn
    for k in range(draws):
        rng = np.random.default_rng((scenario.seed, *key, k))
        image = expose_mode(scenario, mode, rates, seconds, geometry.motion_px, rng)
        detection = detect(scenario, mode, image)
        saturated = float(np.mean(image.lit_dn[truth.white_bits] >= full_dn))
        values = judge(scenario, truth, detection) | {"saturated_fraction": saturated} | known
        yield JudgedFrame(image, detection, values)


def draw(geometry: Geometry, modes: tuple[str, ...], draws: int, key: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """All modes of a geometry: `VARIABLES` (variables, modes, draws) and blob errors (modes, draws, elements) [px]."""
    truth = Truth.of(geometry.scenario)
    values = np.full((len(VARIABLES), len(modes), draws), np.nan)
    blobs = np.full((len(modes), draws, len(ELEMENT_NAMES)), np.nan)
    for m, name in enumerate(modes):
        if name == "shadowed" and "single" in modes[:m] and geometry.free[MODES[name].chaser_radius_m].min() == 1:
            # No shadow falls: the very same frames.
            values[:, m], blobs[m] = values[:, modes.index("single")], blobs[modes.index("single")]
            continue
        for k, frame in enumerate(frames(geometry, truth, name, draws, key)):
            values[:, m, k] = [frame.values.get(variable, np.nan) for variable in VARIABLES]
            if frame.values["detected"]:
                blobs[m, k] = truth.blob_errors_px(frame.detection.features)
    return values, blobs
