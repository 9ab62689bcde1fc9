"""Where the results lie that failure modes are counted from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Plan:
    """What is read.

    Attributes:
        results: folders with the studies' tables, or studies' own folders; the first that has a table counts.
    """

    results: tuple[Path, ...] = (Path("docs/data"),)


FULL = Plan()
#: Nothing here takes long.
QUICK = FULL
