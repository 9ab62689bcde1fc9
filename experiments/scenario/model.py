"""The scenario: one validated description of camera, lights, target, sensor and study, read from a TOML file.

Every package owns its own parameter model; this module only composes them.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from detector.sensor.sensor import Sensor
from experiments.scenario import errors as messages
from experiments.scenario.presets import SECTIONS, clear_for_preset, expand
from materials import library
from radiometry.closure import Requirement
from radiometry.filters import Bandpass
from radiometry.geometry import sun_direction
from radiometry.optics import Camera, camera_at
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.target import Target

Range = Annotated[float, Field(ge=0.05, le=1000, allow_inf_nan=False)]
Exposure = Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] | Literal["auto"]
#: A value of a scenario key.
KeyValue = float | str | bool | Sequence[float]
Illumination = Literal["eclipse", "sunlit"]

DEFAULT_SCENARIO = "default"
#: Keys of [target] that name a material: one of the library, or a path of a data file.
MATERIAL_KEYS = tuple(key for key in Target.model_fields if key.endswith("_material"))

#: The one key that takes true and false, beside numbers; elsewhere pydantic would take them for 1 and 0.
SWITCH = "sensor.blooming"


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message is one line with key, value, what was expected and its unit."""


class AutoExposure(BaseModel):
    """The exposure that puts the bright bits at a fraction of full well, from the closed-form budget."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    full_well_fraction: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.5, description="bright bits over full well, aimed at"
    )
    shortest_s: Annotated[float, Field(gt=0, le=1)] = Field(
        1e-7, description="shortest pulse of the LEDs, which gates the exposure [s]; assumption"
    )
    longest_s: Annotated[float, Field(gt=0, le=100)] = Field(
        1 / 30, description="longest exposure [s]: the thesis's frame time"
    )


class RenderQuality(BaseModel):
    """How densely transport is sampled."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    frame_samples: Annotated[int, Field(ge=1, le=16)] = Field(
        1, description="rays along a pixel's side, outside the marker"
    )
    marker_rays: Annotated[int, Field(ge=10_000, le=50_000_000)] = Field(
        4_000_000, description="most rays on the marker's surroundings; fewer where they suffice"
    )
    wavelength_nodes: Annotated[int, Field(ge=4, le=64, multiple_of=4)] = Field(
        4, description="wavelengths rendered, in groups of four"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        1, description="seed of the rays' lattices, apart from the scenario's, so that new noise needs no new rendering"
    )


class BudgetPlan(BaseModel):
    """What `mantis budget` walks through."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    ranges_m: Annotated[tuple[Range, ...], Field(min_length=1, max_length=1000)] = Field(
        tuple(float(r) for r in range(1, 21)), description="ranges [m], increasing"
    )
    illuminations: Annotated[tuple[Illumination, ...], Field(min_length=1)] = Field(
        ("eclipse", "sunlit"), description="illuminations"
    )
    exposures_s: Annotated[tuple[Exposure, ...], Field(min_length=1)] = Field(
        (1 / 30, 1e-3, "auto"), description="exposures [s], or 'auto'"
    )
    trials: Annotated[int, Field(ge=2, le=100_000)] = Field(16, description="noise draws of every case")

    @model_validator(mode="after")
    def _distinct(self) -> BudgetPlan:
        if list(self.ranges_m) != sorted(set(self.ranges_m)):
            raise ValueError("ranges_m: must increase, none twice [m]")
        if len(set(self.illuminations)) < len(self.illuminations) or len(set(self.exposures_s)) < len(self.exposures_s):
            raise ValueError("illuminations and exposures_s: none may occur twice")
        return self


class Scenario(BaseModel):
    """Everything a study needs. The first three keys say which single frame `render`, `expose` and `detect` are about."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = Field("Mantis scenario", max_length=200, description="one line for reports")
    range_m: Range = Field(4.0, description="camera to marker along the optical axis [m]")
    illumination: Illumination = Field("eclipse", description="'eclipse': LEDs alone; 'sunlit': LEDs and Sun")
    exposure_s: Exposure = Field("auto", description="exposure and LED pulse [s], or 'auto'")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(1, description="seed of every random number")
    camera: Camera = Camera()
    filter: Bandpass = Bandpass()
    sensor: Sensor = Sensor()
    leds: LedRing = LedRing()
    sun: Sun = Sun()
    earth: Earth | None = Field(None, description="the sunlit Earth beside the Sun; absent: none")
    marker: MarkerDesign = MarkerDesign()
    target: Target = Target()
    auto_exposure: AutoExposure = AutoExposure()
    render: RenderQuality = RenderQuality()
    budget: BudgetPlan = BudgetPlan()
    requirement: Requirement = Requirement()

    @model_validator(mode="before")
    @classmethod
    def _no_switches(cls, data: Any) -> Any:
        for key in _switches(data):
            if key != SWITCH:
                raise ValueError(f"{key}: true or false, expected a number or text; {SWITCH} alone is a switch")
        return data

    @model_validator(mode="before")
    @classmethod
    def _expand_presets(cls, data: Any) -> Any:
        return expand(data) if isinstance(data, dict) else data

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        for key in MATERIAL_KEYS:
            try:
                library.load(getattr(self.target, key))
            except ValueError as error:
                raise ValueError(f"target.{key}: {error}") from None
        if self.marker.size_m > self.target.face_m:
            raise ValueError(f"marker.size_m: {self.marker.size_m:g} m exceeds target.face_m, {self.target.face_m:g} m")
        for range_m in {self.range_m, *self.budget.ranges_m}:
            try:
                camera_at(self.camera, range_m, self.filter.centre_nm)
            except ValueError as error:
                raise ValueError(f"camera.{error}") from None
        return self

    @model_validator(mode="after")
    def _sun_before_earth(self) -> Scenario:
        if self.earth is None:
            return self
        towards = [sun_direction(np.radians(s.phase_deg), np.radians(s.azimuth_deg)) for s in (self.sun, self.earth)]
        apart_deg = np.degrees(np.arccos(np.clip(towards[0] @ towards[1], -1, 1)))
        if apart_deg < self.earth.angular_radius_deg:
            raise ValueError(
                f"earth: its disc of {self.earth.angular_radius_deg:g} deg hides the Sun, {apart_deg:.1f} deg from its centre; "
                "expected the Sun outside it [deg]"
            )
        return self

    @model_validator(mode="after")
    def _pulses_that_leds_stand(self) -> Scenario:
        for key, exposures in (("exposure_s", (self.exposure_s,)), ("budget.exposures_s", self.budget.exposures_s)):
            longest = max((e for e in exposures if not isinstance(e, str)), default=0.0)
            if not self.leds.pulse_allowed(longest):
                raise ValueError(
                    f"{key}: {longest:g} s, expected at most leds.longest_pulse_s, {self.leds.longest_pulse_s:g} s"
                )
        return self

    def digest(self) -> str:
        """Hash of every parameter, 16 hexadecimal digits: the same for the same physics, however the file was written."""
        parameters = self.model_dump(mode="json")
        for key in MATERIAL_KEYS:
            parameters["target"][key] = library.fingerprint(parameters["target"][key])
        text = json.dumps(parameters, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def at(self, **changes: Any) -> Scenario:
        """A copy with some top-level keys changed, validated anew."""
        return Scenario.model_validate({**self.model_dump(), **changes})

    def changed(self, *overrides: str) -> Scenario:
        """A copy with changes as `--set` takes them: ``scenario.changed("leds.count=20", "sensor.preset=imx287")``.

        Raises:
            ScenarioError: one line that names the key, the value, and what was expected.
        """
        data = self.model_dump()
        for override in overrides:
            apply_override(data, override)
        return validate(data)

    def with_values(self, values: Mapping[str, KeyValue]) -> Scenario:
        """A copy with values by dotted key, say ``{"leds.count": 20}``.

        Raises:
            ScenarioError: one line that names the key, the value, and what was expected.
        """
        data = self.model_dump()
        for key, value in values.items():
            set_key(data, key, value)
        return validate(data)


def load_scenario(source: str | Path | None = None, overrides: tuple[str, ...] = ()) -> Scenario:
    """Read a scenario file, or a shipped one by name, and apply ``key=value`` overrides.

    Args:
        source: path of a TOML file or the name of a shipped scenario; None is the default scenario. Materials that it names
            by path are looked for beside it.
        overrides: such as ``leds.count=50`` or ``exposure_s=1e-3``; values are TOML, bare words are strings.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    return validate(load_data(source, overrides))


def load_data(source: str | Path | None = None, overrides: tuple[str, ...] = ()) -> dict[str, Any]:
    """The plain data of a scenario file with overrides applied, not yet validated; see `load_scenario`."""
    path = _find(source)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{source or DEFAULT_SCENARIO}: not a TOML file ({error})") from error
    except OSError as error:
        raise ScenarioError(f"{source}: cannot be read ({error.strerror})") from error
    _find_materials(data, path.parent)
    for override in overrides:
        apply_override(data, override)
    return data


def overridden(data: dict[str, Any], overrides: tuple[str, ...], seed: int | None) -> Scenario:
    """Scenario from nested plain data, with ``key=value`` overrides and then a seed in place of its own.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    for override in overrides:
        apply_override(data, override)
    if seed is not None:
        set_key(data, "seed", seed)
    return validate(data)


def validate(data: dict[str, Any]) -> Scenario:
    """Scenario from nested plain data.

    Raises:
        ScenarioError: one line about the first thing wrong, and how many more there are.
    """
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(explain(error)) from None


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(
        sorted(
            f.name.removesuffix(".toml")
            for f in (files("experiments") / "scenarios").iterdir()
            if f.name.endswith(".toml")
        )
    )


def _switches(data: Any, key: str = "") -> Iterator[str]:
    """Dotted keys whose value is, or holds, true or false."""
    if isinstance(data, dict):
        for name, value in data.items():
            yield from _switches(value, f"{key}.{name}" if key else str(name))
    elif isinstance(data, bool) or (isinstance(data, (list, tuple)) and any(isinstance(v, bool) for v in data)):
        yield key


def _find(source: str | Path | None) -> Path:
    name = str(source) if source is not None else DEFAULT_SCENARIO
    if name in shipped_scenarios():
        return Path(str(files("experiments") / "scenarios" / f"{name}.toml"))
    path = Path(name)
    if not path.is_file():
        what = "a folder, no scenario file" if path.is_dir() else "no such scenario file"
        raise ScenarioError(f"{name}: {what}; shipped: {', '.join(shipped_scenarios())}")
    return path


def _find_materials(data: dict[str, Any], folder: Path) -> None:
    """Paths of material files in a scenario are relative to it; those of an override to the working directory."""
    target = data.get("target")
    for key in MATERIAL_KEYS:
        name = target.get(key) if isinstance(target, dict) else None
        if isinstance(target, dict) and isinstance(name, str) and library.is_path(name):
            target[key] = str(folder.resolve() / name)


def apply_override(data: dict[str, Any], override: str) -> None:
    """Set a key of nested data as ``key=value`` says; the value is TOML, a bare word a string.

    Raises:
        ScenarioError: when it has no key or no value, or as `set_key`.
    """
    key, separator, text = override.partition("=")
    if not separator or not key.strip():
        raise ScenarioError(f"--set {override}: expected key=value, say leds.count=50")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    set_key(data, key.strip(), value)


def set_key(data: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key in nested data, say ``leds.count``.

    Raises:
        ScenarioError: when a part of the key holds a value rather than keys.
    """
    *parents, leaf = key.split(".")
    node = data
    for parent in parents:
        node = node.setdefault(parent, {})
        if not isinstance(node, dict):
            raise ScenarioError(f"{key}: {parent} holds a value, not keys")
    if leaf == "preset" and parents and parents[0] in SECTIONS:
        clear_for_preset(data, parents[0], str(value))
    node[leaf] = value


def explain(error: ValidationError, root: type[BaseModel] | None = None) -> str:
    """One line about the first thing wrong with a model's data, a scenario's by default; see `experiments.scenario.errors`."""
    return messages.explain(error, root or Scenario)


def describe(location: list[Any], root: type[BaseModel] | None = None) -> str:
    """Description of the innermost known key of a location, a scenario's by default; empty where there is none."""
    return messages.describe(location, root or Scenario)
