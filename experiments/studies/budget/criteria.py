"""How each criterion of closure is read from a budget's dataset and said in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from experiments.reporting.formatting import number, percent


@dataclass(frozen=True)
class Measure:
    """What decides a criterion.

    Attributes:
        variable: of the dataset.
        name: of the criterion, in words.
        say: a value in words.
        say_limit: a limit in words.
    """

    variable: str
    name: str
    say: Callable[[float], str]
    say_limit: Callable[[float], str] = number


def _degrees(value: float) -> str:
    return f"{number(value)}°"


#: Criterion -> its measure, in the order of `closure.CRITERIA`.
MEASURES: dict[str, Measure] = {
    "saturation": Measure("full_well_fraction", "saturation", lambda v: f"bright bits {number(v)} × full well"),
    "cnr": Measure("cnr_analytic", "CNR", lambda v: f"CNR {number(v)}"),
    "sampling": Measure("px_per_bit", "sampling", lambda v: f"{number(v)} px/bit"),
    "smear": Measure("smear_px", "smear", lambda v: f"{number(v)} px"),
    "detection": Measure("detected_fraction", "detection", lambda v: f"{percent(v)} of frames", percent),
    "attitude": Measure("attitude_error_p95_deg", "attitude", _degrees, _degrees),
    "range": Measure("range_error_p95", "range error", percent, percent),
}
#: Criteria that the closed form decides without a frame, for one exposure.
EXPOSURE_CRITERIA = ("saturation", "cnr", "smear")
