"""What shows through the slits of an encoding element: the closed form of its blob.

Slats and end walls lie in planes through the virtual line, so between two of them a sight line that enters at the blob
goes straight to the floor, and one that enters at a distance from it meets the wall where that distance is too large.
"""

from __future__ import annotations

import numpy as np

from radiometry.geometry import FloatArray
from scenes.marker import Element, MarkerDesign


class Slits:
    """Intervals of floor seen through the slits of one element, for a camera with the light beside its lens."""

    def __init__(self, marker: MarkerDesign, element: Element, camera_m: FloatArray):
        self.pitch = element.length_m / marker.slit_count
        self.start = -element.length_m / 2
        self.count = marker.slit_count
        self.half_slat = marker.slat_fraction * self.pitch / 2
        depth = element.depth_m
        #: Rate at which the sight line leaves the slit's wall, per metre between slit and blob, over the depth.
        leave = depth * (1 / max(camera_m[2], depth) + 1 / element.virtual_depth_m)
        self.follow = leave / (1 - depth / element.virtual_depth_m + leave)
        #: Distance from the blob at which a slit shows nothing [m].
        self.half_width = (self.pitch - 2 * self.half_slat) / self.follow
        # Across the slits a floor point hides behind the side wall where the sight line is oblique.
        k, across = depth / max(camera_m[2], depth), float((camera_m - element.centre_m) @ element.across)
        side = element.width_m / 2
        self.across = max((-side + across * k) / (1 + k), -side), min((side + across * k) / (1 + k), side)

    def seen_up_to(self, u: FloatArray, blob: FloatArray) -> FloatArray:
        """Length of floor seen below each u (n,) for each blob coordinate (k,), (k, n) [m]."""
        low = self.start + self.half_slat + self.pitch * np.arange(self.count)
        high = low + self.pitch - 2 * self.half_slat
        away = blob[:, None]
        seen_low = low + np.maximum((away - low) * self.follow, 0)
        length = np.maximum(high + np.minimum((away - high) * self.follow, 0) - seen_low, 0)
        before = np.cumsum(length, axis=1) - length
        slit = np.clip(((u - self.start) / self.pitch).astype(int), 0, self.count - 1)
        return before[:, slit] + np.minimum(np.maximum(u - seen_low[:, slit], 0), length[:, slit])

    def cut_fraction(self, blob: float) -> float:
        """Part of the blob's triangle that lies beyond the ends of the element."""
        room = (self.count * self.pitch / 2 - abs(blob)) / self.half_width
        return float(
            np.clip((1 - np.clip(room, -1, 1)) ** 2 / 2 if room > 0 else 1 - (1 + max(room, -1)) ** 2 / 2, 0, 1)
        )
