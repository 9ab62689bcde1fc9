"""Geometries of the glare study: where the Sun is, how the target faces the camera and how far it has turned, rendered once each.

LEDs and Sun are rendered at four wavelengths that span every filter, and once more for the target as it stands a frame interval
later: turned at the tumble rate about an axis behind the marker.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from experiments import chain
from experiments.scenario import Scenario
from experiments.scenario.presets import presets
from experiments.studies.glare.modes import (
    MODES,
    POLARISATION_KEPT,
    POLARISER_TRANSMISSION,
    Mode,
    Rates,
    chaser_shadow,
    through,
)
from experiments.studies.glare.plan import Attitude
from radiometry.filters import Bandpass
from radiometry.geometry import FloatArray
from scenes.render.transport import Quality, render_basis
from scenes.view import View

#: Filter whose band spans those of all modes; over it transport is a cubic in wavelength to a test's tolerance.
WIDEST_FILTER = "lp715"
#: Side of a crop beyond the marker's, over the marker's.
CROP_MARGIN = 0.3


@dataclass(frozen=True)
class MovedView(View):
    """The view one interval later: the target has turned about an axis along the image's columns, behind the marker."""

    turn_rad: float = 0.0
    lever_m: float = 0.0

    @cached_property
    def _turn(self) -> FloatArray:
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])

    @cached_property
    def rotation(self) -> FloatArray:
        """Marker -> camera, (3, 3)."""
        return self._turn @ View.rotation.func(self)  # type: ignore[attr-defined]

    @cached_property
    def translation_m(self) -> FloatArray:
        """Marker's origin in the camera frame, (3,) [m]."""
        axis = np.array([0.0, 0.0, self.range_m + self.lever_m])
        return axis - self._turn @ np.array([0.0, 0.0, self.lever_m])


@dataclass(frozen=True)
class Geometry:
    """A range, a Sun and an attitude, with the electron rates through each filter by preset name (None: the scenario's).

    Attributes:
        scenario: its camera is cropped about the marker.
        motion_px: image motion (2,) of the marker's centre between the frames of a pair.
        free: share of the Sun left by the chaser, (H, W), by its radius [m].
        grey_sun: electron rate of sunlight from a surface that returns all wavelengths alike, by filter, in a common unit.
    """

    scenario: Scenario
    rates: dict[str | None, Rates]
    motion_px: FloatArray
    free: dict[float, FloatArray]
    grey_sun: dict[str | None, float]

    def mode_rates(self, mode: Mode) -> Rates:
        """Rates of a mode: with its filters, its polarisers, and its chaser's shadow."""
        rates = self.rates[mode.filter]
        if mode.off_filter is not None:
            second = self.rates[mode.off_filter]
            ratio = self.grey_sun[mode.filter] / self.grey_sun[mode.off_filter]
            rates = replace(rates, off=second.led + second.sun, off_scale=ratio)
        if mode.polarised:
            sun = POLARISER_TRANSMISSION / 2
            led = sun * (1 + POLARISATION_KEPT)
            rates = Rates(rates.led * led, rates.sun * sun, rates.moved_sun * sun)
        if mode.chaser_radius_m:
            free = self.free[mode.chaser_radius_m]
            rates = Rates(rates.led, rates.sun * free, rates.moved_sun * free)
        return rates


def at_sun(scenario: Scenario, range_m: float, phase_deg: float, azimuth_deg: float, attitude: Attitude) -> Scenario:
    """The scenario with another range, Sun and attitude of the target."""
    sun = scenario.sun.model_copy(update={"phase_deg": phase_deg, "azimuth_deg": azimuth_deg})
    target = scenario.target.model_copy(update=vars(attitude))
    return scenario.model_copy(update={"range_m": range_m, "sun": sun, "target": target})


def cropped(scenario: Scenario) -> Scenario:
    """The camera's middle about the marker, every pixel at its place: counts keep their parity."""
    camera, marker = scenario.camera, scenario.marker
    half = marker.size_m / 2 * (1 + CROP_MARGIN)
    corners = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    reach = np.abs(chain.view(scenario).to_image(corners) - camera.principal_point_px).max(axis=0)
    size = {}
    for key, pixels in zip(("width_px", "height_px"), reach, strict=True):
        full = getattr(camera, key)
        size[key] = min(full, 2 * int(np.ceil(pixels)) + full % 2)
    return scenario.model_copy(update={"camera": camera.model_copy(update=size)})


def render(scenario: Scenario, names: tuple[str, ...], pair_interval_s: float, rays: int) -> Geometry:
    """Render a geometry through the filters of the named modes, and once more an interval later where one is a pair.

    Args:
        scenario: camera, lights, marker and target.
        names: of the modes.
        pair_interval_s: time between the two frames of a pair [s].
        rays: of one rendering of the frame.
    """
    modes = [MODES[name] for name in names]
    wide = scenario.model_copy(update={"filter": Bandpass(**presets("filter")[WIDEST_FILTER])})
    view, camera, target = chain.view(wide), scenario.camera, scenario.target
    # Marker and foil alike: one pass over the frame, none over the marker alone.
    samples = int(np.clip(np.sqrt(rays / (camera.width_px * camera.height_px)), 1, 16))
    quality = Quality(samples, 1, scenario.seed)
    turn = np.radians(target.tumble_deg_s) * pair_interval_s
    later = MovedView(**_fields(view), turn_rad=float(turn), lever_m=target.tumble_lever_m)
    paired = any(m.pair for m in modes)
    now = render_basis(view, quality)
    then = render_basis(later, quality) if paired else now
    rates, grey_sun = {}, {}
    for name in {m.filter for m in modes} | {m.off_filter for m in modes if m.off_filter}:
        here = through(scenario, name)
        grey_sun[name] = (chain.source_spectra(here)["sun"] * chain.responsivity(here)).integral()
        led, both = (chain.electron_rate(here, now, illumination) for illumination in ("eclipse", "sunlit"))
        sun = moved_sun = both - led
        if paired:
            moved_sun = chain.electron_rate(here, then, "sunlit") - chain.electron_rate(here, then, "eclipse")
        rates[name] = Rates(led, np.maximum(sun, 0), np.maximum(moved_sun, 0))
    centre = np.zeros((1, 3))
    return Geometry(
        scenario=scenario,
        rates=rates,
        motion_px=(later.to_image(centre) - view.to_image(centre))[0],
        free={m.chaser_radius_m: chaser_shadow(view, m.chaser_radius_m) for m in modes},
        grey_sun=grey_sun,
    )


def _fields(view: View) -> dict[str, Any]:
    """The fields of a view."""
    return {name: getattr(view, name) for name in View.__dataclass_fields__}
