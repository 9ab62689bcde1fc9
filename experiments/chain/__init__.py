"""The chain, in the one place that runs it: scenario -> transport -> electron rate -> DN -> features -> pose.

Every study takes these functions from here; each stage can also be run by itself from files (`mantis render`, `expose`,
`detect`).
"""

from __future__ import annotations

from detector.sensor.sensor import usable_well_electrons
from experiments.chain.case import Case, link_budget, link_budget_beside
from experiments.chain.detection import DetectedImage, Detection, detect, pose_errors
from experiments.chain.exposure import expose, frame_generator
from experiments.chain.illumination import SOURCES, active_sources, responsivity, source_spectra, sun_stray_rate
from experiments.chain.link_budget import Bits, LinkBudget, solve_exposure
from experiments.chain.provenance import provenance
from experiments.chain.rate import electron_rate
from experiments.chain.render_noise import renderer_variance_fraction
from experiments.chain.transport import check_geometry, geometry_digest, quality, transport, transports
from experiments.chain.view import view
from scenes.projection.bits import bit_pixels, bit_scale_px

__all__ = [
    "SOURCES",
    "Bits",
    "Case",
    "DetectedImage",
    "Detection",
    "LinkBudget",
    "active_sources",
    "bit_pixels",
    "bit_scale_px",
    "check_geometry",
    "detect",
    "electron_rate",
    "expose",
    "frame_generator",
    "geometry_digest",
    "link_budget",
    "link_budget_beside",
    "pose_errors",
    "provenance",
    "quality",
    "renderer_variance_fraction",
    "responsivity",
    "solve_exposure",
    "source_spectra",
    "sun_stray_rate",
    "transport",
    "transports",
    "usable_well_electrons",
    "view",
]
