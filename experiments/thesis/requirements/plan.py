"""Where the results lie that requirements are verified from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Plan:
    """What is read.

    Attributes:
        results: folder with the tables of the other studies; a requirement whose table is not there is not verifiable.
    """

    results: Path = Path("docs/data")


FULL = Plan()
#: Nothing here takes long.
QUICK = FULL
