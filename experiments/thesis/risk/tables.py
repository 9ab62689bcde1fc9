"""Claims and rows of the risk page: the thesis's levels beside the counted ones, and why they differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from experiments.reporting.blocks import Table, text_table
from experiments.reporting.formatting import number
from experiments.thesis.claims import Claim
from experiments.thesis.risk.study import LEVELS, MAJOR_DEG, MAJOR_RANGE, STAGES, Place, RiskResult, modes

NAN = float("nan")
HEADINGS = (
    "failure",
    "frames",
    "stage",
    "failed",
    "of",
    "rate [%]",
    "95 % [%]",
    "likelihood",
    "likelihood at most",
    "severity",
    "error [°]",
    "range error [%]",
    "thesis: likelihood, severity",
    "against the thesis",
)


def percent_text(place: Place) -> str:
    """The rate in per cent; for none at all, the most that it can be."""
    value = place.rate.value
    return f"{number(100 * value)} %" if value else f"0 (at most {number(100 * place.rate.interval[1])} %)"


def claims(result: RiskResult) -> list[Claim]:
    """Likelihood levels of figure 8.14 beside those counted with the thesis's pipeline, then those of figure 8.17.

    Of figure 8.17 ‘right’ is the level of this project's detector where it does worst, ‘reproduced’ that of one mitigation alone.
    """
    return [*_before(result), *_after(result)]


def _before(result: RiskResult) -> Iterator[Claim]:
    for k, mode in enumerate(modes(), 1):
        for source in result.sources:
            place = result.places.get((source["name"], "before", mode["name"]))
            if place is not None:
                yield Claim(
                    f"fig. 8.14, {k}",
                    f"likelihood level of {mode['title']}, {source['title']}",
                    "level",
                    printed=str(mode["before"][0]),
                    reproduced=NAN,
                    right=place.likelihood,
                    remark=_against(place, mode, "before", source),
                )


def _after(result: RiskResult) -> Iterator[Claim]:
    for k, mode in enumerate(modes(), 1):
        own = {
            stage: [p for (_, s, m), p in result.places.items() if s == stage and m == mode["name"]] for stage in STAGES
        }
        if own["after"]:
            highest = max(own["after"], key=lambda place: (place.rate.value, place.rate.interval[1]))
            yield Claim(
                f"fig. 8.17, {k}",
                f"likelihood level of {mode['title']}, worst of all",
                "level",
                printed=str(mode["after"][0]),
                reproduced=max((place.likelihood for place in own["part"]), default=NAN),
                right=highest.likelihood,
                remark=f"thesis: {mode['mitigation']}; here: {mode['here']}. {percent_text(highest)} of the frames at worst, "
                f"95 % surely level {_level(highest.proven)} or less",
            )


def places_table(result: RiskResult) -> Table:
    """One row a mode, source and stage."""
    rows: list[tuple[str, ...]] = [HEADINGS]
    for k, mode in enumerate(modes(), 1):
        for source in result.sources:
            for stage in STAGES:
                place = result.places.get((source["name"], stage, mode["name"]))
                if place is not None:
                    rows.append((f"{k} {mode['title']}", source["title"], stage, *_cells(place, mode, stage, source)))
    return text_table(
        rows,
        "Every failure mode over every study's frames",
        key="places",
        terminal=True,
        terminal_columns=(0, 1, 2, 3, 4, 5, 7, 9, 12),
    )


def _cells(place: Place, mode: dict[str, Any], stage: str, source: dict[str, Any]) -> tuple[str, ...]:
    """Texts under `HEADINGS` from 'failed' on."""
    low, high = (number(100 * end) for end in place.rate.interval)
    printed = {"before": mode["before"], "after": mode["after"]}.get(stage)
    return (
        str(place.rate.failed),
        str(place.rate.frames),
        number(100 * place.rate.value),
        f"{low}–{high}",
        _level(place.likelihood),
        _level(place.proven),
        str(place.severity),
        number(place.error_deg),
        number(100 * place.range_error),
        "–" if printed is None else f"{printed[0]}, {printed[1]}",
        _against(place, mode, stage, source),
    )


def _against(place: Place, mode: dict[str, Any], stage: str, source: dict[str, Any]) -> str:
    """How a measured place stands to the thesis's, and why."""
    if stage == "part":
        return str(source.get("part_title", ""))
    printed = mode[stage]
    words = []
    if place.likelihood > printed[0]:
        why = mode["higher"] if stage == "before" else source.get("after_why", f"{percent_text(place)} of the frames")
        words.append(f"likelier: {why}")
    elif place.likelihood < printed[0]:
        words.append("rarer" + (f": {mode['lower']}" if stage == "before" and mode["lower"] else ""))
    if not np.isnan(place.error_deg) and place.severity != printed[1] and stage == "before":
        words.append(
            f"severity {place.severity}: its frames are off by {number(place.error_deg)}° and "
            f"{number(100 * place.range_error)} % of the range; major is beyond {MAJOR_DEG:g}° or {100 * MAJOR_RANGE:g} %"
        )
    return "; ".join(words) or "agrees"


def _level(value: int) -> str:
    return str(value) if value < LEVELS else "above 3"
