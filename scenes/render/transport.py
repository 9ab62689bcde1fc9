"""Transport rendering: what the camera would see of each light at unit strength, at a few fixed wavelengths.

Light transport is linear, so one basis image per light and wavelength serves every power, spectrum, filter and exposure.

Units: the LED basis is radiance per unit on-axis intensity of the whole ring [m⁻²], that of the Sun is radiance per unit
irradiance square to the Sun [sr⁻¹], that of the Earth is radiance per unit radiance of its disc [-].
"""

from __future__ import annotations

from scenes.render.batch import render_bases, render_cases
from scenes.view import AFTER_TRANSPORT, LIGHTS, MM_PER_M, UNITS, Quality, Region, TransportBasis, View

__all__ = [
    "AFTER_TRANSPORT",
    "LIGHTS",
    "MM_PER_M",
    "UNITS",
    "Quality",
    "Region",
    "TransportBasis",
    "View",
    "render_bases",
    "render_basis",
    "render_cases",
]


def render_basis(view: View, quality: Quality | None = None) -> TransportBasis:
    """Render every light of a view: the whole frame coarsely, the marker densely. See `render_bases`.

    Args:
        view: what to render.
        quality: how densely; default `Quality()`.

    Raises:
        RuntimeError: when no Mitsuba variant can run here.
    """
    return next(render_bases([view], quality))
