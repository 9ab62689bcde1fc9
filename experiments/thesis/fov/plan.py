"""What the field-of-view study walks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """What is rendered.

    Attributes:
        ranges_m: of the map [m]; the cut is taken at the first.
        grid_deg: pitches, and yaws, of the map [deg].
        draws: noise draws of each tilt.
        cut_deg: yaws of the cut [deg].
        rays: traced on the marker; twice as many for the cut.
    """

    ranges_m: tuple[float, ...]
    grid_deg: tuple[float, ...]
    draws: int
    cut_deg: tuple[float, ...]
    rays: int


FULL = Plan(
    ranges_m=(2.0, 5.0),
    grid_deg=tuple(float(angle) for angle in range(-75, 76, 5)),
    draws=4,
    cut_deg=tuple(float(angle) for angle in range(-70, 71)),
    rays=1_000_000,
)
QUICK = Plan(
    ranges_m=(2.0,),
    grid_deg=(-40.0, 0.0, 40.0),
    draws=1,
    cut_deg=(-50.0, -30.0, 0.0, 30.0, 50.0),
    rays=200_000,
)
