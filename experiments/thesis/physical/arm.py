"""The laboratory: its scenario, the passes of the arm, and what the camera sees from each of their stations."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from experiments import chain
from experiments.scenario import Scenario, load_data, overridden, set_key, validate
from experiments.studies.shared.judge import tilt_deg
from experiments.thesis.physical.plan import Plan
from radiometry.geometry import FRONTAL, FloatArray
from radiometry.laboratory import HalogenSpot, LedClusters
from scenes.view import View

#: Pixels around the marker that are rendered with it, over its reach; bars and foil are seen in them.
CROP = 1.15


@cache
def table() -> dict[str, Any]:
    """The data file."""
    return tomllib.loads((files("experiments") / "thesis" / "physical" / "laboratory.toml").read_text(encoding="utf-8"))


def load(overrides: tuple[str, ...] = (), seed: int | None = None) -> Scenario:
    """The laboratory's scenario, with changes as `--set` takes them; its LEDs and its Sun are replaced by `equipped`.

    Raises:
        ScenarioError: one line that names the key, the value, and what was expected.
        ValueError: when the LEDs do not fill the clusters evenly.
    """
    data = load_data()
    for key, value in table()["scenario"].items():
        set_key(data, key, value)
    told = table()["leds"]
    count = told["clusters"] * told["leds_each"]
    # Fewer watts an LED than its preset has, and light in proportion.
    power = told["supply_v"] * told["supply_a"] / count
    preset = validate(data).leds
    set_key(data, "leds.count", count)
    set_key(data, "leds.electrical_power_w", power)
    set_key(data, "leds.intensity_w_sr", preset.intensity_w_sr * power / preset.electrical_power_w)
    scenario = overridden(data, overrides, seed)
    _check_clusters(scenario)
    return scenario


def _check_clusters(scenario: Scenario) -> None:
    clusters = table()["leds"]["clusters"]
    if scenario.leds.count % clusters:
        raise ValueError(f"leds.count: {scenario.leds.count}, expected a multiple of the {clusters} clusters")


def equipped(scenario: Scenario) -> Scenario:
    """The scenario with its LEDs in clusters and a halogen spot for the Sun, and its camera cropped about the marker.

    Raises:
        ValueError: when the LEDs do not fill the clusters evenly.
    """
    told, lamp = table()["leds"], table()["lamp"]
    _check_clusters(scenario)
    leds = LedClusters(
        **scenario.leds.model_dump(), clusters=told["clusters"], cluster_radius_m=told["cluster_radius_m"]
    )
    spot = HalogenSpot(
        temperature_k=lamp["temperature_k"],
        illuminance_lx=lamp["illuminance_lx"],
        lamp_radius_m=lamp["radius_m"],
        lamp_distance_m=lamp["distance_m"],
    )
    camera, half = scenario.camera, scenario.marker.size_m / np.sqrt(2)
    size = {}
    for key, focal in zip(("width_px", "height_px"), camera.focal_px, strict=True):
        full = getattr(camera, key)
        reach = CROP * focal * half / (table()["arm"]["distance_m"] - half)
        size[key] = min(full, full % 2 + 2 * int(np.ceil(reach)))
    return scenario.model_copy(update={"leds": leds, "sun": spot, "camera": camera.model_copy(update=size)})


@dataclass(frozen=True)
class Station:
    """Where the camera is in a pass.

    Attributes:
        passing: number of the pass, from zero.
        step: number of the station along it.
        place_m: the lens in the marker frame, (3,).
    """

    passing: int
    step: int
    place_m: FloatArray

    @property
    def range_m(self) -> float:
        """Distance of the lens from the marker's centre [m]."""
        return float(np.linalg.norm(self.place_m))

    @property
    def rotation(self) -> FloatArray:
        """Marker -> camera (3, 3) of a camera that looks at the marker's centre with its rows level."""
        forward = -self.place_m / self.range_m
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    @property
    def attitude_deg(self) -> FloatArray:
        """Pitch, yaw and roll (3,) of the marker as the camera sees it: angles of R_0 · Rz · Ry · Rx."""
        turned = FRONTAL.T @ self.rotation
        return np.append(tilt_deg(self.rotation), np.degrees(np.arctan2(turned[1, 0], turned[0, 0])))


def stations(plan: Plan) -> list[list[Station]]:
    """Every pass's stations on the way out, from the marker's left to its right."""
    arm = table()["arm"]
    heights = arm["heights_m"][: plan.passes]
    along = np.linspace(-1, 1, plan.steps or arm["steps"]) * arm["half_length_m"]
    return [
        [Station(p, s, np.array([x, height, arm["distance_m"]])) for s, x in enumerate(along)]
        for p, height in enumerate(heights)
    ]


def nearest() -> Station:
    """The middle of the first pass, where the exposure is set."""
    arm = table()["arm"]
    return Station(0, -1, np.array([0.0, arm["heights_m"][0], arm["distance_m"]]))


def lamp_direction() -> FloatArray:
    """Unit vector marker -> lamp in the marker frame, (3,): off the normal to the right, level."""
    angle = np.radians(table()["lamp"]["incidence_deg"])
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def lamp_phase_deg(station: Station) -> float:
    """Angle lamp–marker–camera [deg]."""
    cosine = lamp_direction() @ station.place_m / station.range_m
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def at(scenario: Scenario, station: Station) -> Scenario:
    """An equipped scenario with the camera at a station: range, attitude, and the lamp where it then stands."""
    pitch, yaw, roll = station.attitude_deg
    towards = station.rotation @ lamp_direction()
    sun = {
        "phase_deg": lamp_phase_deg(station),
        "azimuth_deg": float(np.degrees(np.arctan2(-towards[1], towards[0]))),
    }
    target = {"pitch_deg": float(pitch), "yaw_deg": float(yaw), "roll_deg": float(roll)}
    return scenario.model_copy(
        update={
            "range_m": station.range_m,
            "target": scenario.target.model_copy(update=target),
            "sun": scenario.sun.model_copy(update=sun),
        }
    )


def views(scenario: Scenario, passes: list[list[Station]]) -> Iterator[View]:
    """Views from every station, pass by pass."""
    for passing in passes:
        for station in passing:
            yield chain.view(at(scenario, station))
