"""What `mantis budget --require` asks for, and when it is met."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from experiments.scenario import load_scenario
from experiments.studies.budget import requirement
from experiments.studies.budget.study import BudgetResult

SCENARIO = load_scenario(None, ("budget.ranges_m=[1, 2, 4]", 'budget.exposures_s=["auto", 1e-3]'))


def closing(*failing: tuple[str, float]) -> BudgetResult:
    """Judgement over three ranges and two illuminations: all close but those named, and none with the other exposure."""
    ranges, illuminations = [1.0, 2.0, 4.0], ["eclipse", "sunlit"]
    closes = [[[(illumination, r) not in failing, False] for illumination in illuminations] for r in ranges]
    coords = {"range_m": ranges, "illumination": illuminations, "exposure": ["auto", "1 ms"]}
    dataset = xr.Dataset({"closes": (("range_m", "illumination", "exposure"), np.array(closes))}, coords)
    return BudgetResult(SCENARIO, dataset, [])


@pytest.mark.parametrize(
    ("condition", "failing", "told"),
    [
        ("closes", (), None),
        ("closes", (("sunlit", 4.0),), "4 m in sunlit"),
        ("sunlit:2", (("sunlit", 4.0),), None),
        ("sunlit:2", (("eclipse", 1.0),), None),
        ("eclipse:2", (("eclipse", 1.0), ("eclipse", 2.0)), "1 m in eclipse, 2 m in eclipse"),
        ("eclipse:3.5", (("eclipse", 2.0), ("eclipse", 4.0)), "2 m in eclipse"),
    ],
)
def test_a_closing_requirement_judges_its_illumination_up_to_its_range(
    condition: str, failing: tuple[tuple[str, float], ...], told: str | None
) -> None:
    said = requirement.unmet(requirement.parse(condition, SCENARIO), closing(*failing))
    assert said == ("" if told is None else f"the budget does not close at {told} (exposure auto)")


def test_an_illumination_that_the_plan_leaves_out_is_no_condition() -> None:
    dark = SCENARIO.changed('budget.illuminations=["eclipse"]')
    with pytest.raises(ValueError, match="expected 'closes' or ILLUMINATION:RANGE"):
        requirement.parse("sunlit:2", dark)
