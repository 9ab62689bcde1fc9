"""What the trade-off walks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """A decision problem is solved as its file states it: there is nothing to choose."""


FULL = Plan()
#: Nothing here takes long.
QUICK = FULL
