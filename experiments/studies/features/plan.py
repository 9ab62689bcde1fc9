"""How much of everything the study of features does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How much of everything.

    Attributes:
        ranges_m, pitches_deg, shifts, draws: geometries where accuracy is measured, each at so many sub-pixel positions with so
            many noise draws.
        attitudes, attitude_shifts, attitude_draws: the same where detection is counted; `attitudes_at_target` at the size for
            which the target is stated.
        px_per_bit, cnr: sizes and contrasts at which detection is counted.
        free_quarters, free_whole: marker-free frames of a quarter of the detector and of all of it; `free_renders` faces are
            rendered for them.
        calibrations: whether elements and cameras are calibrated as well.
        processes: beside this one, where the command line names none; None is one a core.
    """

    ranges_m: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
    pitches_deg: tuple[float, ...] = (-35.0, -20.0, 0.0, 20.0, 35.0)
    shifts: int = 8
    draws: int = 10
    attitudes: int = 10
    attitude_shifts: int = 4
    attitude_draws: int = 5
    attitudes_at_target: int = 40
    px_per_bit: tuple[float, ...] = (1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 4.0, 6.0)
    cnr: tuple[float, ...] = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0)
    free_quarters: int = 9_000
    free_whole: int = 1_000
    free_renders: int = 50
    calibrations: bool = True
    processes: int | None = None


FULL = Plan()
#: Starting other processes would take longer than the work.
QUICK = Plan(
    ranges_m=(4.0,),
    pitches_deg=(20.0,),
    shifts=3,
    draws=5,
    attitudes=1,
    attitude_shifts=2,
    attitude_draws=3,
    attitudes_at_target=2,
    px_per_bit=(2.0, 4.0),
    cnr=(2.0, 5.0),
    free_quarters=20,
    free_whole=10,
    free_renders=1,
    calibrations=False,
    processes=0,
)
