"""What the physical experiment walks through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Plan:
    """How much of the laboratory's programme is run.

    Attributes:
        passes: of the arm; None for all of the data file.
        steps: stations of a pass; None for as many as the data file has.
        binning: of the detector in the chessboards' images; None for the data file's.
        boards: views of the chessboard; None for all of the data file.
        sharpness_px: point spreads of the lens that are tried in place of the scenario's focus, sharp first [px].
    """

    passes: int | None = None
    steps: int | None = None
    binning: int | None = None
    boards: int | None = None
    sharpness_px: tuple[float, ...] = (0.7, 1.5, 2.0, 2.5, 3.0)


FULL = Plan()
QUICK = Plan(passes=2, steps=3, binning=16, boards=4, sharpness_px=(0.7, 3.0))
