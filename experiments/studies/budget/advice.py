"""Advice on a budget: the smallest single change for each failing criterion, in closed form, and what the frames show."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from scipy.optimize import brentq

from experiments.reporting.formatting import (
    ILLUMINATION_NAMES,
    factor,
    listed,
    number,
    percent,
    ranges_text,
    seconds_text,
)
from experiments.scenario import Scenario
from radiometry import link

#: SYS-REQ-6 (thesis, section 3.6): side of a marker over side of the target's face, at most.
MARKER_OVER_FACE_MAX = 0.10
#: More LEDs than this many times the scenario's are not proposed; assumption.
_LED_FACTOR_MAX = 1000.0


def advise(dataset: xr.Dataset, scenario: Scenario, shown: int, failing: set[str]) -> tuple[str, ...]:
    """One sentence for each thing to change or to know, in the order in which the criteria bind.

    Args:
        dataset: of `study.run`.
        scenario: the one it was made from.
        shown: index of the exposure that the verdict is about.
        failing: criteria that fail somewhere with that exposure.
    """
    here = dataset.isel(exposure=shown)
    windows = exposure_windows(dataset, scenario)
    advice = []
    if "cnr" in failing:
        advice += _cnr_advice(here, windows, scenario)
    if "sampling" in failing:
        advice.append(_sampling_advice(here, scenario))
    if "detection" in failing:
        advice.append(_detection_advice(here))
    for criterion, variable, limit in (
        ("attitude", "attitude_error_deg", scenario.requirement.attitude_error_max_deg),
        ("range", "range_error", scenario.requirement.range_error_max),
    ):
        if criterion in failing:
            advice += _error_advice(here, scenario, criterion, variable, limit)
    if not (dataset.margin.sel(criterion=["saturation", "cnr", "smear"]) >= 1).all():
        advice += _exposure_advice(dataset, windows)
        advice += _led_advice(dataset, scenario)
    return (*advice, *_evidence(here, scenario))


def exposure_windows(dataset: xr.Dataset, scenario: Scenario) -> xr.Dataset:
    """Exposures [s] over range and illumination that just meet CNR (at least), saturation and smear (at most), in closed form.

    Charges grow with time: saturation and smear are linear in it. CNR ≥ c is a quadratic: with rates s, b, d of signal,
    background and dark charge and noise σ, (s − b)² t² = c² [(s + b + 2d) t + 2σ²].
    """
    here = dataset.isel(exposure=0)
    seconds = here.exposure_s
    signal, background = here.signal_analytic / seconds, here.background_analytic / seconds
    dark, noise2 = scenario.sensor.dark_rate_electrons_per_s, scenario.sensor.total_noise_electrons**2
    requirement = scenario.requirement
    contrast, shot = (signal - background).clip(min=0), requirement.cnr_min**2 * (signal + background + 2 * dark)
    with np.errstate(divide="ignore"):
        root = np.sqrt(shot**2 + 8 * (requirement.cnr_min * contrast) ** 2 * noise2)
        shortest = xr.where(contrast > 0, (shot + root) / (2 * contrast**2), np.inf)
        fullest = requirement.full_well_fraction_max / (here.full_well_fraction / seconds)
        stillest = requirement.smear_px_max / (here.smear_px / seconds)
    return xr.Dataset({"cnr": shortest, "saturation": fullest, "smear": stillest}).drop_vars("exposure")


def _place(array: xr.DataArray, index: dict[str, xr.DataArray]) -> str:
    at = array.isel(index)
    return f"{float(at.range_m):g} m in {ILLUMINATION_NAMES[str(at.illumination.values)]}"


def _exposure_advice(dataset: xr.Dataset, windows: xr.Dataset) -> list[str]:
    """Whether one exposure meets CNR, saturation and smear everywhere, or at least one a range."""
    ceiling = np.minimum(windows.saturation, windows.smear)
    floor = windows.cnr
    lowest, highest = ceiling.argmin(...), floor.argmax(...)
    least, most = float(floor.max()), float(ceiling.min())
    why = "saturation" if float(windows.saturation.isel(lowest)) <= float(windows.smear.isel(lowest)) else "smear"
    if least <= most:
        return [
            f"Exposure: any single one from {seconds_text(least)} to {seconds_text(most)} meets CNR, saturation and smear "
            f"at every range in {listed([ILLUMINATION_NAMES[str(v)] for v in dataset.illumination.values])}."
        ]
    if bool((floor <= ceiling).all()):
        return [
            f"Exposure: no single one serves all ranges. {_place(ceiling, lowest)} allows at most {seconds_text(most)} "
            f"({why}), {_place(floor, highest)} needs at least {seconds_text(least)} (CNR): let it follow range, as 'auto' does."
        ]
    shut = floor > ceiling
    sentences = []
    for illumination in dataset.illumination.values:
        grid = [float(r) for r in dataset.range_m.values]
        closed = [r for r, s in zip(grid, shut.sel(illumination=illumination).values, strict=True) if s]
        if closed:
            sentences.append(
                f"Exposure: at {ranges_text(grid, closed)} in {ILLUMINATION_NAMES[str(illumination)]} none meets CNR and {why} "
                "together; light or contrast must change there."
            )
    return sentences


def _led_advice(dataset: xr.Dataset, scenario: Scenario) -> list[str]:
    """How many LEDs each exposure takes whose bits saturate; nothing where eclipse was not computed."""
    limit, count = scenario.requirement.full_well_fraction_max, scenario.leds.count
    if "eclipse" not in dataset.illumination.values:
        return []
    said: dict[str, list[str]] = {}
    for here in (dataset.full_well_fraction.isel(exposure=i) for i in range(dataset.sizes["exposure"])):
        if not float(here.max()) > limit:
            continue
        led = here.sel(illumination="eclipse", drop=True)
        sun = here - led
        allowed = float((count * (limit - sun) / led).min())
        if float(sun.max()) > limit:
            text = "sunlight alone saturates the bits; no number of LEDs helps"
        elif allowed >= 1:
            text = f"at most {math.floor(allowed)} of the {count} LEDs may shine"
        else:
            text = f"fewer LEDs do not help: one alone exceeds the saturation limit {factor(float(led.max()) / count / limit)}"
        said.setdefault(text, []).append(str(here.exposure.values))
    return [f"LEDs: with {listed(labels)} of exposure {text}." for text, labels in said.items()]


def _cnr_advice(here: xr.Dataset, windows: xr.Dataset, scenario: Scenario) -> list[str]:
    """The exposure, or the number of LEDs, that lifts the lowest CNR of each illumination to the limit."""
    sentences = []
    for illumination in here.illumination.values:
        worst = int(here.cnr_analytic.sel(illumination=illumination).fillna(np.inf).argmin("range_m"))
        case = here.sel(illumination=illumination).isel(range_m=worst)
        window = windows.sel(illumination=illumination).isel(range_m=worst)
        if not float(case.cnr_analytic) < scenario.requirement.cnr_min:
            continue
        needed, ceiling = float(window.cnr), min(float(window.saturation), float(window.smear))
        text = (
            f"CNR: at {float(case.range_m):g} m in {ILLUMINATION_NAMES[str(illumination)]} it takes {seconds_text(needed)} of "
            f"exposure instead of {seconds_text(float(case.exposure_s))}"
        )
        if needed > ceiling:
            text += f", more than saturation and smear allow ({seconds_text(ceiling)})"
        leds = _led_factor(here.isel(range_m=worst), scenario, str(illumination))
        sentences.append(
            text + (f"; or {factor(leds)} the LEDs' intensity." if leds else "; more LEDs do not reach it.")
        )
    return sentences


def _led_factor(at_range: xr.Dataset, scenario: Scenario, illumination: str) -> float | None:
    """Factor on the LEDs' intensity that brings CNR to the limit at the exposure as it is; None where none does."""
    if "eclipse" not in at_range.illumination.values:
        return None
    case, led = at_range.sel(illumination=illumination), at_range.sel(illumination="eclipse")
    seconds = float(case.exposure_s)
    scale = seconds / float(led.exposure_s)
    led_e = np.array([float(led.signal_analytic), float(led.background_analytic)]) * scale
    sun_e = np.array([float(case.signal_analytic), float(case.background_analytic)]) - led_e
    dark, noise = scenario.sensor.dark_electrons(seconds), scenario.sensor.total_noise_electrons

    def excess(log_factor: float) -> float:
        signal, background = led_e * np.exp(log_factor) + sun_e
        return float(link.cnr(signal, background, dark, noise)) - scenario.requirement.cnr_min

    top = math.log(_LED_FACTOR_MAX)
    return math.exp(brentq(excess, 0.0, top)) if excess(0.0) < 0 < excess(top) else None


def _sampling_advice(here: xr.Dataset, scenario: Scenario) -> str:
    """Focal length or marker side that samples a bit well enough at the farthest range, and whether each is allowed."""
    camera, marker, limit = scenario.camera, scenario.marker, scenario.requirement.px_per_bit_min
    near, far = float(here.range_m[0]), float(here.range_m[-1])
    worst = float(here.px_per_bit.min())
    short = limit / worst
    focal_m, side_m = _round_up(camera.focal_length_m * short), _round_up(marker.size_m * short)
    view = [
        f"{number(2 * np.degrees(np.arctan(camera.width_px * camera.pixel_pitch_x_m / 2 / f)))}°"
        for f in (camera.focal_length_m, focal_m)
    ]
    image_px = marker.size_m * focal_m / near / np.array([camera.pixel_pitch_x_m, camera.pixel_pitch_y_m])
    fits = bool(np.all(image_px <= (camera.width_px, camera.height_px)))
    largest_m = MARKER_OVER_FACE_MAX * scenario.target.face_m
    allowed = side_m <= largest_m * (1 + 1e-9)
    return (
        f"Sampling: {number(worst)} px/bit at {far:g} m, {number(limit)} needed; this marker and lens carry to about "
        f"{number(float(here.px_per_bit[-1]) * far / limit)} m. Change one: focal length {number(camera.focal_length_m * 1e3)} → "
        f"{number(focal_m * 1e3)} mm at the same F-number (field of view {view[0]} → {view[1]}; the marker "
        f"{'still fits' if fits else 'no longer fits'} the frame at {near:g} m); or marker side {number(marker.size_m * 100)} → "
        f"{number(side_m * 100)} cm, which SYS-REQ-6 {'allows' if allowed else 'does not allow'} "
        f"(at most {number(largest_m * 100)} cm on a {number(scenario.target.face_m)} m face)."
    )


def _round_up(value: float) -> float:
    """To three significant digits, upwards, so that what is printed is enough."""
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.ceil(value / step - 1e-9) * step


def _detection_advice(here: xr.Dataset) -> str:
    """At which ranges every frame, some or none shows the marker, in each illumination."""
    grid = [float(r) for r in here.range_m.values]
    said: dict[str, list[str]] = {}
    for illumination in here.illumination.values:
        share = here.detected_fraction.sel(illumination=illumination).values
        groups = {
            "every frame": share == 1,
            "some frames": (share > 0) & (share < 1),
            "no frame": share == 0,
        }
        text = listed(
            [
                f"in {word} at {ranges_text(grid, np.array(grid)[chosen])}"
                for word, chosen in groups.items()
                if chosen.any()
            ]
        )
        said.setdefault(text, []).append(ILLUMINATION_NAMES[str(illumination)])
    first = float(here.px_per_bit.where((here.detected_fraction < 1).any("illumination")).max())
    parts = [f"in {listed(illuminations)} the marker is found {text}" for text, illuminations in said.items()]
    return f"Detection: {'; '.join(parts)}. The first misses come at {number(first)} px/bit."


def _error_advice(here: xr.Dataset, scenario: Scenario, criterion: str, variable: str, limit: float) -> list[str]:
    """How many frames are off at the ranges where the marker is found and yet the error too large."""

    def say(value: float) -> str:
        return f"{value:.2g}°" if criterion == "attitude" else percent(value)

    sentences = []
    for illumination in scenario.budget.illuminations:
        parts = []
        for i, range_m in enumerate(here.range_m.values):
            case = here.sel(illumination=illumination).isel(range_m=i)
            errors = case[variable].values
            errors = errors[np.isfinite(errors)]
            if float(case.margin.sel(criterion=criterion)) >= 1 or not len(errors):
                continue
            off = errors[errors > limit]
            if not len(off):  # what fails are the frames without a usable pose, of which the detection tells
                continue
            rest = f", the others by at most {say(errors[errors <= limit].max())}" if len(off) < len(errors) else ""
            parts.append(
                f"at {range_m:g} m {len(off)} of {len(errors)} poses are off by more than {say(limit)} "
                f"(up to {say(off.max())}){rest}"
            )
        if parts:
            sentences.append(f"{criterion.capitalize()}: in {ILLUMINATION_NAMES[illumination]} {'; '.join(parts)}.")
    return sentences


def _evidence(here: xr.Dataset, scenario: Scenario) -> list[str]:
    """What a clean sheet of so few frames proves: n of n found bounds the rate from below by 0.05^(1/n), one-sided 95 %."""
    trials, wanted = scenario.budget.trials, scenario.requirement.detection_min
    proven = 0.05 ** (1 / trials)
    if not bool((here.detected_fraction == 1).any()) or proven >= wanted or wanted == 1:
        return []
    needed = math.ceil(math.log(0.05) / math.log(wanted))
    return [
        f"Evidence: {trials} of {trials} frames prove a detection rate of {percent(proven)} at 95 % confidence, no more; "
        f"to prove {percent(wanted)} set budget.trials to {needed}."
    ]
