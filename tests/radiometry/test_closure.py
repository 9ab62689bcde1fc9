"""Closure criteria: a margin of one is just met, and what could not be measured has failed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from radiometry.closure import CRITERIA, Requirement, judge

AT_LEAST = [name for name, (_, at_least) in CRITERIA.items() if at_least]
AT_MOST = [name for name, (_, at_least) in CRITERIA.items() if not at_least]


def limit(name: str) -> float:
    return float(getattr(Requirement(), CRITERIA[name][0]))


@settings(deadline=None, derandomize=True)
@given(st.sampled_from(AT_LEAST), st.floats(0, 1e6))
def test_a_minimum_is_met_from_the_limit_upwards(name: str, value: float) -> None:
    (verdict,) = judge(Requirement(), {name: value})
    assert verdict.passed == (value >= limit(name))
    assert verdict.margin == value / limit(name)


@settings(deadline=None, derandomize=True)
@given(st.sampled_from(AT_MOST), st.floats(1e-6, 1e6))
def test_a_maximum_is_met_up_to_the_limit(name: str, value: float) -> None:
    (verdict,) = judge(Requirement(), {name: value})
    assert verdict.passed == (value <= limit(name))
    assert verdict.margin == limit(name) / value


@pytest.mark.parametrize("name", CRITERIA)
def test_the_limit_itself_passes_with_a_margin_of_one_and_its_neighbour_does_not(name: str) -> None:
    at_least = CRITERIA[name][1]
    (verdict,) = judge(Requirement(), {name: limit(name)})
    assert verdict.passed
    assert verdict.margin == 1.0
    (verdict,) = judge(Requirement(), {name: np.nextafter(limit(name), -np.inf if at_least else np.inf)})
    assert not verdict.passed


@pytest.mark.parametrize("name", CRITERIA)
def test_what_was_not_measured_fails_with_no_margin(name: str) -> None:
    (verdict,) = judge(Requirement(), {name: float("nan")})
    assert not verdict.passed
    assert verdict.margin == 0
    assert np.isnan(verdict.value)


@pytest.mark.parametrize("name", CRITERIA)
@pytest.mark.parametrize("value", [0.0, np.inf])
def test_zero_and_infinity_are_extreme_margins_and_no_errors(name: str, value: float) -> None:
    (verdict,) = judge(Requirement(), {name: value})
    assert verdict.margin == (value if CRITERIA[name][1] else (0.0 if value else np.inf))


def test_only_what_is_given_is_judged_and_in_the_order_in_which_criteria_bind() -> None:
    values = {"smear": 0.1, "saturation": 0.5, "range": 0.01}
    assert [v.name for v in judge(Requirement(), values)] == ["saturation", "smear", "range"]
    assert judge(Requirement(), {}) == []


def test_every_limit_of_the_requirement_is_judged_and_none_twice() -> None:
    assert sorted(attribute for attribute, _ in CRITERIA.values()) == sorted(Requirement.model_fields)


@pytest.mark.parametrize(
    ("field", "value"),
    [("cnr_min", 0), ("cnr_min", np.inf), ("full_well_fraction_max", 1.5), ("detection_min", np.nan), ("cnr", 10)],
)
def test_an_impossible_requirement_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        Requirement(**{field: value})
