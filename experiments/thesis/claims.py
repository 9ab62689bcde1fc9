"""Claims of the thesis held against this project: printed, reproduced, right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.reporting.blocks import Cell, Section, Table, Text
from experiments.reporting.formatting import number

#: The thesis that `experiments.thesis` holds against this project, as it is cited.
THESIS = (
    "D. Rijlaarsdam, Relative Navigation for Debris Removal (RENDER): Designing a Novel Fiducial Marker System, MSc thesis, "
    "Delft University of Technology, 2021"
)

HEADINGS = ("where", "what", "unit", "printed", "reproduced", "right", "remark")

_ABOUT = (
    "‘Printed’ is what the thesis states, a dash where it leaves the number open. ‘Reproduced’ follows the thesis's own recipe. "
    "‘Right’ is what this project finds."
)


@dataclass(frozen=True)
class Claim:
    """One thing the thesis states.

    Attributes:
        where: section, equation, table or listing.
        what: the quantity.
        unit: of all three values.
        printed: as printed; empty where the thesis leaves it open.
        reproduced: by the thesis's own recipe; NaN where there is none.
        right: by this project.
        remark: why they differ.
    """

    where: str
    what: str
    unit: str
    printed: str
    reproduced: float
    right: float
    remark: str = ""

    @property
    def agrees(self) -> bool | None:
        """Whether the right value, rounded to the printed digits, gives the printed number; None where it is no number."""
        text = self.printed.replace("−", "-")
        try:
            printed = float(text)
        except ValueError:
            return None
        decimals = len(text.partition(".")[2])
        return bool(abs(printed - self.right) <= 0.5 * 10.0**-decimals * (1 + 1e-9))

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Cells under `HEADINGS`; the printed one is marked where it can be judged."""
        return (
            Cell(self.where, style="left"),
            Cell(self.what, style="left"),
            Cell(self.unit),
            Cell(self.printed or "–", passed=self.agrees),
            Cell(number(self.reproduced)),
            Cell(number(self.right)),
            Cell(self.remark, style="left"),
        )

    @property
    def exact(self) -> tuple[str, ...]:
        """Texts under `HEADINGS` for a file, numbers with six significant digits."""
        values = ("" if np.isnan(value) else f"{value:.6g}" for value in (self.reproduced, self.right))
        return (self.where, self.what, self.unit, self.printed, *values, self.remark)


def claims_table(claims: Sequence[Claim], terminal: bool = True) -> Table:
    """The claims as a table of a page, with a file of their own, ``data/STUDY.csv``."""
    return Table(
        HEADINGS,
        tuple(claim.cells for claim in claims),
        "Printed, reproduced by the thesis's own recipe, and right",
        key="",
        exact=tuple(claim.exact for claim in claims),
        terminal=terminal,
    )


def claims_section(claims: Sequence[Claim], terminal: bool = True) -> Section:
    """The section of a page that holds them."""
    return Section(
        "claims", "Printed, reproduced, right", (Text((_ABOUT,)), claims_table(claims, terminal)), wordy=True
    )
