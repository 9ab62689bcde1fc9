"""Three models of the thesis's own system side by side, as a section of any report: printed, repaired, full."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import xarray as xr

from experiments.reporting.blocks import Block, Figures, Text
from experiments.reporting.html import figure
from experiments.thesis.errata import figures as errata_figures
from experiments.thesis.errata import study as errata


@cache
def _models() -> xr.Dataset:
    return errata.compute()


def three_models() -> Iterator[Block]:
    """SNR of the three models over range in both lights, and what each repair of the printed one is worth at 8 m."""
    dataset = _models()
    yield Text(
        (
            "The thesis's own system (5 mm bit, its exposures and beam) in three models: its listing as printed, the same with "
            "its slips repaired one at a time, and the full model that the rest of this report uses. The command mantis errata "
            "gives the numbers.",
        )
    )
    yield Figures(
        (
            figure(errata_figures.eclipse_figure(dataset), "models-eclipse", "SNR of the three models in eclipse"),
            figure(errata_figures.sun_figure(dataset), "models-sun", "SNR of the three models in sunlight"),
        ),
        "Open markers: the pixel cannot hold the charge, so the SNR is formal only.",
    )
    yield Figures(
        (
            figure(
                errata_figures.waterfall_figure(dataset, "eclipse", 8.0),
                "models-steps-eclipse",
                "Repairs in eclipse, 8 m",
            ),
            figure(
                errata_figures.waterfall_figure(dataset, "sun alone", 8.0),
                "models-steps-sun",
                "Repairs in sunlight, 8 m",
            ),
        ),
        "Each step multiplies signal and SNR by the factor written beside it; diamonds mark the three models.",
    )
