"""Which materials are shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """Which materials are shown.

    Attributes:
        names: materials of the library, or paths of data files; none means the whole library.
    """

    names: tuple[str, ...] = ()


FULL = Plan()
