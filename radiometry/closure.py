"""Closure: the criteria that a budget must meet, and by which margin it meets each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from radiometry.parameters import Positive, PositiveFraction


class Requirement(BaseModel):
    """Limits that a range must meet to close."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cnr_min: Positive = Field(10.0, description="contrast-to-noise ratio, at least")
    full_well_fraction_max: PositiveFraction = Field(0.7, description="bright bits over full well, at most")
    px_per_bit_min: Positive = Field(
        2.0, description="pixels along the shorter side of a bit, at least; 3 where OpenCV's ArUco decodes"
    )
    smear_px_max: Positive = Field(0.5, description="motion during an exposure [px], at most")
    detection_min: PositiveFraction = Field(0.99, description="share of frames whose marker is found, at least")
    attitude_error_max_deg: Positive = Field(
        2.0,
        description="95th percentile of attitude error [deg], at most; assumption: figure 3.6 gives no numbers",
    )
    range_error_max: PositiveFraction = Field(
        0.02, description="95th percentile of range error over range, at most; assumption"
    )


@dataclass(frozen=True)
class Verdict:
    """Whether one criterion is met at one range.

    Attributes:
        name: the criterion, a key of `CRITERIA`.
        value: what was measured; NaN where it could not be measured.
        limit: the limit, in the same unit as the value.
        margin: by which factor the criterion is met: 1 is just met, below 1 fails, 0 where nothing was measured.
    """

    name: str
    value: float
    limit: float
    margin: float

    @property
    def passed(self) -> bool:
        """True where the criterion is met."""
        return self.margin >= 1.0


#: Criterion -> (attribute of Requirement, True where the value must be at least the limit), in the order in which they bind.
CRITERIA: dict[str, tuple[str, bool]] = {
    "saturation": ("full_well_fraction_max", False),
    "cnr": ("cnr_min", True),
    "sampling": ("px_per_bit_min", True),
    "smear": ("smear_px_max", False),
    "detection": ("detection_min", True),
    "attitude": ("attitude_error_max_deg", False),
    "range": ("range_error_max", False),
}


def judge(requirement: Requirement, values: dict[str, float]) -> list[Verdict]:
    """Hold measured values against a requirement, criterion by criterion. A NaN value fails.

    Args:
        requirement: the limits.
        values: by the names of `CRITERIA`; criteria that are left out are not judged.

    Returns:
        A verdict for each criterion that was given, in the order of `CRITERIA`.

    Example:
        >>> from radiometry.closure import Requirement, judge
        >>> for verdict in judge(Requirement(), {"cnr": 15.0, "smear": 1.0}):
        ...     print(verdict.name, verdict.margin, verdict.passed)
        cnr 1.5 True
        smear 0.5 False
    """
    verdicts = []
    for name, (attribute, at_least) in CRITERIA.items():
        if name not in values:
            continue
        value, limit = float(values[name]), float(getattr(requirement, attribute))
        if np.isnan(value):
            margin = 0.0
        elif at_least:
            margin = value / limit
        else:
            margin = limit / value if value > 0 else np.inf
        verdicts.append(Verdict(name, value, limit, float(margin)))
    return verdicts
