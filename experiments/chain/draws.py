"""Draws of a scenario's geometry: what differs from one approach to the next, and no frame shares with another.

A rate over frames of one pose says how that pose does under noise. Frames that differ in place, turn, tilt and crinkle say how
the system does. Only these are independent trials.
"""

from __future__ import annotations

import numpy as np

from experiments.scenario import Scenario
from radiometry.geometry import FloatArray

#: Largest tilt about the scenario's own, and the share of the free field over which the marker's place is drawn. Assumptions: a
#: chaser that points at the marker, and holds its approach axis, to about this.
TILT_DEG = 3.0
FIELD_SHARE = 0.5
#: Part of the marker's size that stays clear of the frame's edge.
_CLEAR = 0.1


def geometry_draw(scenario: Scenario, index: int) -> Scenario:
    """The scenario with another geometry: place in the field, roll, tilt and crinkle, by its seed and the draw's number.

    The place is uniform over the middle half of the field that is free for the whole marker, and so is uniform within a pixel.
    The roll is uniform over all angles, the tilt over a cone of 3 deg about the scenario's own, and the foil crinkles anew.

    Args:
        scenario: about which the draws are made.
        index: of the draw; the same gives the same geometry.
    """
    rng = np.random.default_rng((scenario.seed, round(scenario.range_m * 1e6), 7, index))
    target = scenario.target
    tilt_deg = TILT_DEG * np.sqrt(rng.random()) * _direction(rng)
    place_m = FIELD_SHARE * free_field_m(scenario) * rng.uniform(-1, 1, 2)
    changed = {
        "pitch_deg": float(np.clip(target.pitch_deg + tilt_deg[0], -80, 80)),
        "yaw_deg": float(np.clip(target.yaw_deg + tilt_deg[1], -80, 80)),
        "roll_deg": float(rng.uniform(-180, 180)),
        "offset_x_m": target.offset_x_m + float(place_m[0]),
        "offset_y_m": target.offset_y_m + float(place_m[1]),
        "facet_seed": target.facet_seed + 1 + index,
    }
    return scenario.at(target={**target.model_dump(), **changed})


def free_field_m(scenario: Scenario) -> FloatArray:
    """How far (2,) the marker's centre may lie off the axis, along rows and columns, and be whole in the frame at any roll [m].

    At least a pixel's width, so that the place within a pixel is drawn even where the frame has no room.
    """
    camera = scenario.camera
    focal = np.array(camera.focal_px)
    half_frame = np.array([camera.width_px, camera.height_px]) / 2 / focal * scenario.range_m
    half_marker = scenario.marker.size_m * (1 + _CLEAR) / np.sqrt(2)
    return np.maximum(half_frame - half_marker, scenario.range_m / focal)


def _direction(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])
