"""The part of a scenario that the renderer sees."""

from __future__ import annotations

from experiments.scenario import Scenario
from radiometry.optics import camera_at, wavelength_nodes
from scenes.view import View


def view(scenario: Scenario) -> View:
    """The part of a scenario that changes transport; its camera's point spread is the whole blur at the range."""
    nodes = wavelength_nodes(scenario.filter.spectrum(), scenario.render.wavelength_nodes)
    return View(
        camera=camera_at(scenario.camera, scenario.range_m, scenario.filter.centre_nm),
        marker=scenario.marker,
        target=scenario.target,
        leds=scenario.leds,
        sun=scenario.sun,
        range_m=scenario.range_m,
        nodes_nm=nodes,
        earth=scenario.earth,
    )
