"""Figures of the power study."""

from __future__ import annotations

from typing import Any

import numpy as np

from experiments.reporting.figures import BLACK, BLUE, COLOURS, GREEN, VERMILION, new_figure
from experiments.reporting.formatting import ILLUMINATION_NAMES
from experiments.thesis.power.emitters import BOARD_C
from experiments.thesis.power.study import PowerResult
from experiments.thesis.power.tables import THESIS_EXPOSURES_S
from radiometry import link
from radiometry.power import swing_px


def rate_over_exposure(result: PowerResult) -> Any:
    """Equation 6.10 over exposure for 1, 10 and 100 LEDs, the thesis's points and the needed ones."""
    dataset, scenario, power = result.dataset, result.scenario, result.power
    figure, axes = new_figure(size_in=(6.4, 4.0))
    axis = axes[0, 0]
    exposure = np.geomspace(1e-7, 1e-1, 200)
    for count, colour in zip(dataset.leds.values, (BLUE, GREEN, BLACK), strict=True):
        energy = scenario.leds.electrical_power_w * count * exposure
        plural = "" if count == 1 else "s"
        axis.loglog(
            exposure, link.frames_per_second(power.limit_w, energy), color=colour, label=f"{count} LED{plural} alone"
        )
    whole = power.frame_rate(scenario.leds, exposure)
    axis.loglog(exposure, whole, color=BLACK, ls="--", label="100 LEDs, driver, camera, readout")
    thesis = np.array(THESIS_EXPOSURES_S)
    energy = scenario.leds.energy_per_frame_j(thesis)
    axis.plot(thesis, power.limit_w / energy, "s", color=VERMILION, ms=5, label="thesis, 1/30 to 1/200 s")
    for illumination, marker in (("eclipse", "o"), ("sunlit", "^")):
        at = dataset.sel(illumination=illumination, leds=100)
        axis.plot(
            at.exposure_s,
            at.rate_light,
            marker,
            color=COLOURS[4],
            ms=4,
            label=f"as needed, {ILLUMINATION_NAMES[illumination]}",
        )
    axis.set(xlabel="exposure [s]", ylabel="frame rate [1/s]", ylim=(0.2, 1e7))
    axis.legend(fontsize=8, loc="upper right")
    return figure


def over_range(result: PowerResult) -> Any:
    """Exposure, frame rates and turn between frames over range."""
    dataset, scenario, power = result.dataset, result.scenario, result.power
    figure, axes = new_figure(1, 3, (9.0, 3.2))
    for illumination, colour in (("eclipse", BLUE), ("sunlit", VERMILION)):
        at = dataset.sel(illumination=illumination, leds=100)
        name = ILLUMINATION_NAMES[illumination]
        axes[0, 0].semilogy(at.range_m, 1e6 * at.exposure_s, color=colour, marker="o", label=name)
        axes[0, 1].semilogy(at.range_m, at.rate_light, color=colour, marker="o", label=f"LEDs alone, {name}")
    at = dataset.sel(illumination="eclipse", leds=100)
    axes[0, 1].semilogy(at.range_m, at.rate, color=BLACK, ls="--", label="camera's readout")
    axes[0, 1].axhline(1.19, color=VERMILION, ls=":", label="thesis, 1/50 s")
    focal, lever = max(scenario.camera.focal_px), scenario.target.tumble_lever_m
    slow = swing_px(focal, lever, at.range_m.values, np.radians(scenario.target.tumble_deg_s / 1.19))
    axes[0, 2].semilogy(at.range_m, slow, color=VERMILION, ls=":", label="thesis, 1/50 s")
    axes[0, 2].semilogy(at.range_m, at.swing_px, color=BLACK, ls="--", label="at the camera's readout")
    size = focal * scenario.marker.size_m / at.range_m
    axes[0, 2].semilogy(at.range_m, size, color=BLUE, label="side of the marker")
    axes[0, 0].set(xlabel="range [m]", ylabel="exposure [µs]")
    axes[0, 1].set(xlabel="range [m]", ylabel=f"frame rate under {power.limit_w:g} W [1/s]", ylim=(0.5, None))
    swing = f"motion between frames at {scenario.target.tumble_deg_s:g}°/s [px]"
    axes[0, 2].set(xlabel="range [m]", ylabel=swing)
    for axis in axes[0]:
        axis.legend(fontsize=7.5)
        axis.set_xlim(0, 21)
    return figure


def junction(result: PowerResult) -> Any:
    """Peak junction temperature of each LED over pulse length, with its limit and the exposures in use."""
    dataset, emitters = result.dataset, result.emitters
    figure, axes = new_figure(size_in=(6.4, 3.8))
    axis = axes[0, 0]
    pulse = np.geomspace(1e-7, 1.0, 300)
    for emitter, colour in zip(emitters, COLOURS, strict=False):
        rise = emitter.rise_k(pulse, np.full_like(pulse, np.inf))
        axis.semilogx(pulse, BOARD_C + rise, color=colour, label=f"{emitter.name}, {emitter.electrical_w:g} W")
    axis.axhline(emitters[0].junction_max_c, color=BLACK, ls="--", lw=1)
    axis.text(1.2e-7, emitters[0].junction_max_c - 4, "junction's limit, all three", fontsize=8, va="top")
    needed = dataset.sel(leds=100).exposure_s
    low, high = float(needed.min()), float(needed.max())
    axis.axvspan(low, high, color=COLOURS[4], alpha=0.25, lw=0)
    axis.text(np.sqrt(low * high), 128, "as needed,\n1 to 20 m", fontsize=8, ha="center", va="top")
    axis.axvspan(1 / 200, 1 / 30, color=VERMILION, alpha=0.2, lw=0)
    axis.text(1 / 75, 128, "thesis", fontsize=8, ha="center", va="top")
    axis.set(
        xlabel="length of a single pulse [s]",
        ylabel=f"junction temperature, board at {BOARD_C:g} °C [°C]",
        ylim=(55, 155),
    )
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(0.0, 0.45))
    return figure
