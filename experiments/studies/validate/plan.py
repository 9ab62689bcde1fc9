"""The cells that `mantis validate` compares: ranges, marker sizes, tilts, Suns and sensors."""

from __future__ import annotations

from dataclasses import dataclass

#: Sensor name that stands for the scenario's own.
SCENARIO_SENSOR = "scenario"


@dataclass(frozen=True)
class Plan:
    """Every combination of these is a cell; each has the eclipse besides the Suns.

    Attributes:
        ranges_m: camera to marker [m].
        sizes_m: side of the marker [m].
        tilts_deg: between the marker's normal and the line of sight [deg].
        phases_deg: Sun–target–camera [deg].
        sensors: presets, or `SCENARIO_SENSOR`.
        draws: noise draws of each cell.
        rays: about the marker, of each rendering.
    """

    ranges_m: tuple[float, ...] = tuple(float(r) for r in range(1, 21))
    sizes_m: tuple[float, ...] = (0.05, 0.10, 0.20)
    tilts_deg: tuple[float, ...] = (0.0, 20.0, 40.0)
    phases_deg: tuple[float, ...] = (15.0, 45.0, 75.0)
    sensors: tuple[str, ...] = (SCENARIO_SENSOR, "icx429al")
    draws: int = 16
    rays: int = 2_000_000


FULL = Plan()
QUICK = Plan((1.0, 3.0, 8.0, 20.0), (0.05, 0.20), (0.0, 40.0), (45.0, 75.0), rays=500_000)
