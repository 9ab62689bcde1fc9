"""What the virtual experiment walks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """Which tests are run, and how finely.

    Attributes:
        tests: numbers of table 8.1; empty for all of them and what is run beside them.
        step_deg: steps of tilt in place of the table's [deg]; None keeps the table's.
        bounds: whether the Cramér–Rao bounds are worked out.
    """

    tests: tuple[int, ...] = ()
    step_deg: float | None = None
    bounds: bool = True


FULL = Plan()
#: Far, where planar markers flip, and the improved design.
QUICK = Plan(tests=(1, 2, 9), step_deg=6.0, bounds=False)
