"""Runs of the virtual experiment: which target turns how, how far away, and the views of it that are rendered."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any
from zlib import crc32

import numpy as np

from experiments import chain
from experiments.scenario import Scenario, load_data, overridden, set_key
from experiments.studies.shared.trackers import Design
from experiments.thesis.virtual.plan import Plan
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign
from scenes.tags import DotPlate, TagPlate, view_of
from scenes.view import View

#: Steps of the angles where the table does not say otherwise, as the thesis has them [deg].
STEP_DEG = 0.1
#: Pixels around a target that are rendered with it.
_MARGIN_PX = 8


@cache
def table() -> dict[str, Any]:
    """The data file: scenario, rotations, targets and runs."""
    return tomllib.loads((files("experiments") / "thesis" / "virtual" / "table_8_1.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Run:
    """A target at a range, turned through some angles.

    Attributes:
        test: number in table 8.1; 0 for what is run beside it.
        target: key of the data file's targets.
        rotation: 'pitch', or 'both' for pitch = yaw.
        angles_deg: pitch of every frame.
    """

    test: int
    target: str
    range_m: float
    rotation: str
    angles_deg: tuple[float, ...]

    @property
    def name(self) -> str:
        """Say 'mantis 2.3 m pitch'."""
        return f"{self.target} {self.range_m:g} m {self.rotation}"

    @property
    def number(self) -> int:
        """What its random numbers are drawn from: its name's check sum, the same in every plan."""
        return crc32(self.name.encode())

    @property
    def attitudes_deg(self) -> FloatArray:
        """Pitch and yaw of every frame, (n, 2) [deg]."""
        pitch = np.array(self.angles_deg)
        return np.column_stack([pitch, pitch if self.rotation == "both" else np.zeros_like(pitch)])


def runs(plan: Plan) -> list[Run]:
    """The plan's runs, in the order of the data file."""
    found = []
    for entry in table()["run"]:
        test = entry.get("test", 0)
        if plan.tests and test not in plan.tests:
            continue
        step = plan.step_deg or entry.get("step_deg", STEP_DEG)
        span = table()["rotation"][entry["rotation"]]
        count = round((span["to_deg"] - span["from_deg"]) / step) + 1
        # Rounded, so that 0.1° steps hit 0 and are the same numbers everywhere.
        angles = tuple(float(a) for a in np.linspace(span["from_deg"], span["to_deg"], count).round(6))
        found.append(Run(test, entry["target"], entry["range_m"], entry["rotation"], angles))
    return found


def load(overrides: tuple[str, ...] = (), seed: int | None = None) -> Scenario:
    """The experiment's scenario, with changes as `--set` takes them.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
    """
    data = load_data()
    for key, value in table()["scenario"].items():
        set_key(data, key, value)
    return overridden(data, overrides, seed)


def design(scenario: Scenario, target: str) -> Design:
    """What a target is, of the scenario's marker's outer size.

    The protrusion stands as high as the Mantis Marker's virtual points lie deep, so that it turns as far in the image.
    """
    told: Mapping[str, Any] = table()["target"][target]
    marker, size = scenario.marker, scenario.marker.size_m
    if "ring_fraction" in told:
        changes = {key: value for key, value in told.items() if key != "title"}
        return MarkerDesign.model_validate({**marker.model_dump(), **changes})
    if "dictionary" in told:
        return TagPlate(dictionary=told["dictionary"], side_m=size)
    return DotPlate(side_m=size, height_fraction=marker.elements[0].virtual_depth_m / size)


def believed(scenario: Scenario, run: Run) -> Design:
    """What the methods take a run's target for: as designed, or as calibrated from images at other attitudes."""
    built = design(scenario, run.target)
    if not (isinstance(built, MarkerDesign) and any(built.element_offsets_m)):
        return built
    designed = built.model_copy(update={"element_offsets_m": (0.0,) * 4})
    if run.target != "calibrated":
        return designed
    from experiments.studies.shared.calibrations import elements_from_images, rendered_views

    at = scenario.at(range_m=run.range_m, marker=designed.model_dump(), illumination="eclipse")
    images, _, near = rendered_views(at, built.element_offsets_m)
    return elements_from_images(images, near).marker(designed)


def cropped(scenario: Scenario, run: Run) -> Scenario:
    """The scenario at a run's range, its detector cropped about the axis to what the target can reach."""
    shown = design(scenario, run.target)
    half = shown.size_m / np.sqrt(2)  # at any roll, and at any tilt
    camera = scenario.camera
    crop = {}
    for key, focal in zip(("width_px", "height_px"), camera.focal_px, strict=True):
        full = getattr(camera, key)
        reach = focal * half / (run.range_m - half) + _MARGIN_PX
        # Taking as much on either side keeps the axis where it is between pixels.
        crop[key] = min(full, full % 2 + 2 * int(np.ceil(reach)))
    marker = shown if isinstance(shown, MarkerDesign) else scenario.marker
    return scenario.at(
        range_m=run.range_m, camera={**camera.model_dump(), **crop}, marker=marker.model_dump(), illumination="eclipse"
    )


def views(scenario: Scenario, run: Run) -> list[View]:
    """A run's views on a cropped scenario's detector, in order."""
    shown = design(scenario, run.target)
    frontal = chain.view(scenario)
    if not isinstance(shown, MarkerDesign):
        frontal = view_of(shown, frontal)
    return [
        replace(frontal, target=frontal.target.model_copy(update={"pitch_deg": pitch, "yaw_deg": yaw}))
        for pitch, yaw in run.attitudes_deg
    ]


def exposure_s(scenario: Scenario, run: Run) -> float:
    """Exposure of all of a run's frames [s]: for the scenario's marker squarely before the camera; all targets alike."""
    frontal = scenario.at(
        range_m=run.range_m, target={**scenario.target.model_dump(), "pitch_deg": 0.0, "yaw_deg": 0.0}
    )
    return chain.solve_exposure(frontal, chain.link_budget(frontal, "eclipse"), frontal.exposure_s)
