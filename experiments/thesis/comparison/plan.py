"""What the comparison walks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """Ranges and tilts of every marker.

    Attributes:
        ranges_m: of the marker [m].
        tilts_deg: about the marker's x axis [deg].
        frames: of each tilt, spread about it by `study.SPREAD_DEG`.
    """

    ranges_m: tuple[float, ...]
    tilts_deg: tuple[float, ...]
    frames: int


FULL = Plan(ranges_m=(2.3, 4.6), tilts_deg=tuple(float(angle) for angle in range(0, 61, 5)), frames=16)
QUICK = Plan(ranges_m=(2.3,), tilts_deg=(0.0, 30.0), frames=3)
