"""Where a scenario's marker is seen: its view, and the pixels of its bits."""

from __future__ import annotations

from experiments.scenario import Scenario
from radiometry.optics import camera_at, wavelength_nodes
from scenes.view import View


def view(scenario: Scenario) -> View:
    """The part of a scenario that changes transport; its camera's point spread is the whole blur at the range."""
    nodes = wavelength_nodes(scenario.filter.spectrum(), scenario.render.wavelength_nodes)
    return View(
        camera_at(scenario.camera, scenario.range_m, scenario.filter.centre_nm),
        scenario.marker, scenario.target, scenario.leds, scenario.sun, scenario.range_m, nodes, scenario.earth,
    )  # fmt: skip
