"""The chain, in the one place that runs it: scenario -> transport -> electron rate -> DN -> features -> pose.

Every study takes these functions from here; each stage can also be run by itself from files (`mantis render`, `expose`,
`detect`).
"""

from __future__ import annotations

from detector.sensor.sensor import usable_well
from experiments.chain.detection import Sighting, look, pose_errors
from experiments.chain.exposure import frame_generator, noise_model, take_frame
from experiments.chain.illumination import LIGHTS_ON, lights_on, responsivity, strengths, sun_stray_rate
from experiments.chain.link_budget import LinkBudget, exposure_s, link_budget, link_budget_beside
from experiments.chain.provenance import provenance
from experiments.chain.rate import electron_rate
from experiments.chain.render_noise import renderer_variance_fraction
from experiments.chain.transport import check_geometry, geometry_digest, quality, transport, transports
from experiments.chain.view import view
from scenes.projection.bits import bit_pixels, bit_scale_px

__all__ = [
    "LIGHTS_ON",
    "LinkBudget",
    "Sighting",
    "bit_pixels",
    "bit_scale_px",
    "check_geometry",
    "electron_rate",
    "exposure_s",
    "frame_generator",
    "geometry_digest",
    "lights_on",
    "link_budget",
    "link_budget_beside",
    "look",
    "noise_model",
    "pose_errors",
    "provenance",
    "quality",
    "renderer_variance_fraction",
    "responsivity",
    "strengths",
    "sun_stray_rate",
    "take_frame",
    "transport",
    "transports",
    "usable_well",
    "view",
]
