"""A page says with which seed its data was made, or that nothing in it is random."""

from __future__ import annotations

import pytest
import xarray as xr

from experiments.reporting.page import Page
from experiments.scenario import load_scenario

FIXED = "Nothing in it is random."


@pytest.mark.parametrize(
    ("data", "said"),
    [(None, FIXED), (xr.Dataset(), FIXED), (xr.Dataset(attrs={"seed": 7.0}), "Seed 7; the same input and seed")],
)
def test_seed_is_that_of_the_data_where_there_is_no_scenario(data: xr.Dataset | None, said: str) -> None:
    assert said in Page("probe", "Title", "So.", None, "mantis probe", (), data=data).html()


def test_seed_of_the_scenario_wins() -> None:
    page = Page("probe", "Title", "So.", None, "mantis probe", (), scenario=load_scenario(overrides=("seed=5",)))
    assert "Seed 5; the same input and seed" in page.html()
