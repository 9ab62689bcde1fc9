"""Constraints of the closure search: what may be built, what it may draw, and how sure each assumption is."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from experiments.scenario import MATERIAL_KEYS, Range, Scenario, ScenarioError, explain, load_data, set_key, validate
from experiments.scenario.presets import presets
from materials import library

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1)]
Phase = Annotated[float, Field(ge=0, le=180)]
#: Prefix of an override that is meant for the constraints and not for the scenario.
PREFIX = "close."

#: What an uncertainty may scale.
UNCERTAIN = (
    "retro",
    "retro_life",
    "retro_tail",
    "tape_diffuse",
    "absorber",
    "foil_lobe",
    "full_well",
    "led_intensity",
    "quantum_efficiency",
    "lens_transmission",
    "psf",
    "focal_length",
)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Steps(_Model):
    """Equal steps between two ends, both included."""

    first: Positive
    last: Positive
    step: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Steps:
        if self.last < self.first or (self.last - self.first) / self.step > 10_000:
            raise ValueError(
                f"first {self.first:g}, last {self.last:g}, step {self.step:g}: expected first <= last, 10000 steps at most"
            )
        return self

    def values(self) -> tuple[float, ...]:
        """The steps."""
        count = round((self.last - self.first) / self.step) + 1
        return tuple(float(v) for v in np.round(self.first + self.step * np.arange(count), 9))


class ConfirmView(_Model):
    """A tilt of the marker and a Sun at which a set is rendered."""

    pitch_deg: Annotated[float, Field(ge=-80, le=80)] = 0.0
    yaw_deg: Annotated[float, Field(ge=-80, le=80)] = 0.0
    phase_deg: Phase = 45.0
    ranges_m: tuple[Range, ...] | None = Field(None, description="ranges [m]; all of the constraints where left out")

    @property
    def label(self) -> str:
        """'pitch 20°, yaw 0°, Sun at 10°'."""
        return f"pitch {self.pitch_deg:g}°, yaw {self.yaw_deg:g}°, Sun at {self.phase_deg:g}°"


class Confirmation(_Model):
    """What every proposed set is rendered, exposed and detected at."""

    views: Annotated[tuple[ConfirmView, ...], Field(min_length=1)] = (ConfirmView(),)
    trials: Annotated[int, Field(ge=2, le=10_000)] = Field(5, description="noise draws of every case")


class Uncertainty(_Model):
    """An assumption as a factor between two ends, log-uniform."""

    key: Literal[UNCERTAIN]  # type: ignore[valid-type]
    name: str = Field(max_length=60)
    low: Positive
    high: Positive
    source: str

    @model_validator(mode="after")
    def _about_one(self) -> Uncertainty:
        if not self.low <= 1 <= self.high:
            raise ValueError(f"{self.name}: factors {self.low:g} to {self.high:g}; expected low <= 1 <= high")
        return self


class Constraints(_Model):
    """What a set of parameters must meet, and from what it may be made."""

    title: str = Field("Closure search", max_length=200)
    scenario: str = Field("default", description="hardware that is not searched: a scenario file or a shipped name")
    ranges_m: Annotated[tuple[Range, ...], Field(min_length=2)]
    phases_deg: Annotated[tuple[Phase, ...], Field(min_length=1)]
    tilt_deg: Annotated[float, Field(ge=0, lt=80)] = Field(description="tilt at which a bit is still sampled [deg]")
    end_of_life: bool = True
    led_derating: Share = Field(description="LED intensity at the end of the mission over new")
    tapes: Annotated[tuple[str, ...], Field(min_length=1)]
    marker_sizes_m: Annotated[tuple[Positive, ...], Field(min_length=1)]
    focal_lengths_m: Steps
    f_numbers: Annotated[tuple[Positive, ...], Field(min_length=1)]
    sensors: tuple[str, ...] = Field((), description="presets tried beside the scenario's sensor")
    filters: tuple[str, ...] = Field((), description="presets tried beside the scenario's filter")
    ring_radii_m: tuple[Positive, ...] = Field((), description="radii tried beside that of the scenario's ring [m]")
    led_counts: Annotated[tuple[Annotated[int, Field(ge=1)], ...], Field(min_length=1)]
    marker_over_face_max: Share = Field(description="marker's side over the face's (SYS-REQ-6)")
    aperture_max_m: Positive = Field(description="largest entrance pupil [m]")
    average_power_w: Positive = Field(description="mean electrical power of the LEDs, at most [W]")
    energy_per_frame_j: Positive = Field(description="electrical energy of one pulse, at most [J]")
    turn_per_frame_deg: Positive = Field(description="turn of the target between frames, at most [deg]")
    frame_share_max: Share = Field(description="marker over the detector's side at the nearest range, at most")
    blur_bits_max: Positive = Field(description="defocus disc over a bit, at most")
    led_over_sun_min: Positive = Field(description="tape lit by LEDs over tape lit by the Sun, at least")
    glint_over_well_max: Positive = Field(description="foil facet that mirrors the Sun over full well, at most")
    confirm: Confirmation = Confirmation()
    uncertainties: tuple[Uncertainty, ...] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Constraints:
        for name in ("ranges_m", "phases_deg", "marker_sizes_m", "f_numbers", "led_counts"):
            values = getattr(self, name)
            if list(values) != sorted(set(values)):
                raise ValueError(f"{name}: must increase, none twice")
        for name, section in (("sensors", "sensor"), ("filters", "filter")):
            unknown = [f for f in getattr(self, name) if f not in presets(section)]
            if unknown:
                raise ValueError(f"{name}: {unknown[0]!r}; expected some of {', '.join(presets(section))}")
        for tape in self.tapes:
            try:
                library.load(tape)
            except ValueError as error:
                raise ValueError(f"tapes: {error}") from None
        return self

    def frame_rate_hz(self, scenario: Scenario) -> float:
        """Frames a second that the tumble asks for; one where nothing turns."""
        return max(scenario.target.tumble_deg_s / self.turn_per_frame_deg, 1.0)


@dataclass(frozen=True)
class Problem:
    """Constraints, and the scenario of the hardware that is not searched, as new."""

    constraints: Constraints
    base: Scenario


def load_problem(path: Path | str | None = None, overrides: tuple[str, ...] = (), seed: int | None = None) -> Problem:
    """Constraints of a TOML file, by default the shipped one, and the scenario that they name.

    Args:
        path: TOML file of constraints; None is the shipped one.
        overrides: ``key=value``; keys that begin with ``close.`` change the constraints, all others the scenario.
        seed: of every random number; None is the scenario's.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    source = Path(str(files("experiments") / "studies" / "close" / "default.toml")) if path is None else Path(path)
    try:
        data: dict[str, Any] = tomllib.loads(source.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{source}: not a TOML file ({error})") from error
    except OSError as error:
        raise ScenarioError(f"{source}: cannot be read ({error.strerror})") from error
    for override in overrides:
        if override.startswith(PREFIX):
            key, _, text = override.removeprefix(PREFIX).partition("=")
            try:
                set_key(data, key.strip(), tomllib.loads(f"value = {text}")["value"])
            except tomllib.TOMLDecodeError:
                set_key(data, key.strip(), text.strip())
    try:
        constraints = Constraints.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(f"constraints: {explain(error, Constraints)}") from None
    of_scenario = tuple(o for o in overrides if not o.startswith(PREFIX))
    scenario = validate(load_data(constraints.scenario, of_scenario))
    return Problem(constraints, scenario if seed is None else scenario.at(seed=seed))


def at_life(scenario: Scenario, constraints: Constraints, end: bool) -> Scenario:
    """The scenario with materials and LEDs new, or at the end of the mission."""
    if not end:
        return scenario
    target, leds = scenario.target.model_dump(), scenario.leds.model_dump()
    for key in MATERIAL_KEYS:
        target[key] = _worn(target[key])
    leds["intensity_w_sr"] *= constraints.led_derating
    return scenario.at(target=target, leds=leds)


def _worn(material: str) -> str:
    """Name of a material at the end of its life; the material itself where its file does not say, or it is worn already."""
    try:
        return library.load(material + library.END_OF_LIFE).name
    except ValueError:
        return material
