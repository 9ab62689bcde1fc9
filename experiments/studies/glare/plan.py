"""What the glare study walks through."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from experiments.studies.glare.modes import MODES


@dataclass(frozen=True)
class Attitude:
    """How the target faces the camera, and the crinkle of its foil."""

    pitch_deg: float
    yaw_deg: float
    roll_deg: float
    facet_seed: int


@dataclass(frozen=True)
class Plan:
    """Ranges, Suns, attitudes and noise draws of every part of the study.

    Attributes:
        attitudes: of the target, each with a crinkle of its foil.
        draws: noise draws of each mode at one range, Sun and attitude.
        pair_interval_s: from the frame with LEDs to the one without; default the thesis's frame time.
        rays: of one rendering of a crop.
        whole_range_m, whole_azimuths_deg: of the whole frames that are searched for markers that are not there.
        dimmed_scales: intensity of the LEDs over the scenario's, where they are dimmed; `dimmed_draws` noise draws each.
        condition_phases_deg: phase angles at which one condition is changed at a time, with `condition_draws` noise draws and
            `condition_rays` a rendering.
    """

    ranges_m: tuple[float, ...] = (2.0, 5.0, 9.0)
    phases_deg: tuple[float, ...] = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 45.0, 90.0, 150.0)
    azimuths_deg: tuple[float, ...] = (0.0, 60.0, 120.0, 180.0, 240.0, 300.0)
    attitudes: tuple[Attitude, ...] = (Attitude(-4, 7, 10, 1), Attitude(14, -18, -30, 2))
    draws: int = 8
    modes: tuple[str, ...] = tuple(MODES)
    pair_interval_s: float = 1 / 30
    rays: int = 200_000
    whole_range_m: float = 5.0
    whole_azimuths_deg: tuple[float, ...] = (60.0, 240.0)
    dimmed_scales: tuple[float, ...] = tuple(10.0 ** (-0.5 * step) for step in range(9))
    dimmed_draws: int = 8
    condition_phases_deg: tuple[float, ...] = (2.0, 10.0, 45.0, 90.0, 150.0)
    condition_draws: int = 4
    condition_rays: int = 200_000

    def suns(self) -> Iterator[tuple[int, int, int, int]]:
        """Indices of attitude, range, phase and azimuth; attitudes first, as the renderer keeps the scenes of a few crinkles."""
        yield from product(*map(range, map(len, (self.attitudes, self.ranges_m, self.phases_deg, self.azimuths_deg))))


FULL = Plan()
QUICK = Plan(
    ranges_m=(5.0,),
    phases_deg=(0.0, 2.0, 20.0, 75.0),
    azimuths_deg=(0.0, 120.0, 240.0),
    attitudes=FULL.attitudes[:1],
    draws=3,
    whole_azimuths_deg=(60.0,),
    dimmed_scales=FULL.dimmed_scales[::2],
    dimmed_draws=4,
    condition_phases_deg=FULL.condition_phases_deg[1:3],
    condition_draws=1,
    condition_rays=60_000,
)
