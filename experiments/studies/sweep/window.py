"""Frames that are read out in a window about the marker, as a tracker reads them once it knows roughly where to look.

Whole frames are what a camera has when it searches: noise and glare anywhere in them may be taken for the marker. A window
leaves all that lies outside it unseen, and costs a fraction of the time. It is always several times the marker's extent and about
the optical axis, whatever the frame shows, so that detection is told no more than a tracker's prediction would tell it.
"""

from __future__ import annotations

import numpy as np

from experiments import chain
from experiments.scenario import Scenario, ScenarioError

#: Smallest side of a window [px]: all passes of the detector, down to four times binned copies, find room in it.
MIN_WINDOW_PX = 96


def windowed(scenario: Scenario, extents: float) -> Scenario:
    """The scenario with its detector cut to a window about the optical axis, where the marker is.

    Args:
        scenario: of a whole frame.
        extents: side of the window over the marker's extent in the image, along columns and rows apart.

    Raises:
        ScenarioError: with veiling glare, which depends on the light of the whole frame.
    """
    camera = scenario.camera
    if camera.veiling_glare > 0:
        raise ScenarioError(
            f"window: {extents:g}, but camera.veiling_glare is {camera.veiling_glare:g}, which spreads the light of the whole "
            "frame; expected no window, or no veiling glare"
        )
    half = scenario.marker.size_m / 2
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    reach = np.abs(chain.view(scenario).to_image(corners) - camera.principal_point_px).max(axis=0)
    sides = [_side(2 * r * extents, full) for r, full in zip(reach, (camera.width_px, camera.height_px), strict=True)]
    # The loss at the corner pixels is what the key states, and the corners have moved inwards.
    inside, whole = (
        ((w - 1) * camera.pixel_pitch_x_m) ** 2 + ((h - 1) * camera.pixel_pitch_y_m) ** 2
        for w, h in (sides, (camera.width_px, camera.height_px))
    )
    changes = {"width_px": sides[0], "height_px": sides[1], "vignetting": camera.vignetting * inside / whole}
    return scenario.at(camera={**camera.model_dump(), **changes})


def _side(wanted_px: float, full_px: int) -> int:
    """Pixels along a side: of the frame's parity, so that the pixels stay where they are, and no more than the frame's."""
    side = max(int(np.ceil(wanted_px)), MIN_WINDOW_PX)
    return min(side + (full_px - side) % 2, full_px)
