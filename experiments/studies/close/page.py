"""The page of `mantis close`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from experiments.reporting.blocks import Block, Card, Plot, Plots, Section, Table, Text, csv_text, text_table
from experiments.reporting.formatting import number, percent
from experiments.reporting.page import Page
from experiments.studies.close import figures, sentences, tables
from experiments.studies.close.facts import Facts, facts_of
from experiments.studies.close.study import ClosureResult


def page(result: ClosureResult, command: str) -> Page:
    """The search: the answer, the exposures, what the margin depends on, other hardware, and the rendered confirmation."""
    facts = facts_of(result)
    line = sentences.headline(result)
    confirmed = result.confirmed
    return Page(
        study="close",
        title=sentences.title(result),
        headline=line,
        passed=facts is not None and (facts.seen is None or facts.seen.confirmed),
        command=command,
        sections=(_hardware_section(result, facts),) if facts is None else _sections(result, facts),
        findings=tuple(_findings(result, facts)),
        cards=tuple(_cards(result, facts)),
        about=sentences.about(result),
        limits=sentences.limits(result),
        scenario=result.scenario,
        data=dataset(result),
        stem="closure",
        unmet={} if any(c.confirmed for c in confirmed) else {"closes": line},
        extra=as_json(result),
        files=_files(result),
    )


def _findings(result: ClosureResult, facts: Facts | None) -> list[str]:
    if facts is None:
        return [
            f"Of {result.found.tried:,} sets, {result.found.focused:,} meet sampling, frame and focus. Where it is none, relax "
            "these first."
        ]
    return [
        sentences.binding(result, facts)[0],
        f"Exposure: {sentences.exposure_follows(facts)}",
        f"Sensitivity: {sentences.sensitivity(facts)}",
        f"Probability: {sentences.probability(facts)}",
        f"Hardware: {sentences.smallest_change(result)}",
    ]


def _cards(result: ClosureResult, facts: Facts | None) -> list[Card]:
    cards = []
    if facts is not None:
        point, seen, likely = facts.point, facts.seen, facts.likely
        note = f"binds: {point.binding[0]} at {point.binding[1]:g} m"
        note += "" if seen is None else f"; {seen.closing} of {seen.cases} rendered cases close"
        smallest = sorted(point.margins.items(), key=lambda item: item[1])[:5]
        margins = tuple(f"{name}: ×{number(margin)}" for name, margin in smallest)
        cards.append(Card("Recommended set", point.label, note, margins, seen is None or seen.confirmed))
        shares = tuple(
            f"{p.label}: {percent(p.following)}, with exposures set beforehand {percent(p.fixed)}"
            for p in result.probabilities
        )
        cards.append(
            Card(
                "Probability of closure",
                percent(likely.following),
                "under the stated uncertainties, where the exposure follows the light",
                shares,
                likely.following >= 0.95,
            )
        )
    following = result.hardware[1]
    changes = tuple(
        f"{c.name}: {'closes' if c.closes else 'does not close'}{'' if c.allowed else ', not allowed'}"
        for c in result.hardware
    )
    cards.append(
        Card(
            "The thesis's own hardware",
            f"to {following.reach_m:.1f} m",
            "where the exposure follows the light",
            changes,
            following.closes,
            remarks_title="Smallest change",
            remarks=(result.minimal.name if result.minimal else "no single change",),
        )
    )
    return cards


def _sections(result: ClosureResult, facts: Facts) -> tuple[Section, ...]:
    proposed = text_table(tables.proposed_rows(result), "Sets that close", terminal=True)
    confirmation: list[Block] = [Text((sentences.confirmation(result),))]
    if result.records:
        confirmation.append(text_table(tables.confirmation_rows(result.confirmed)))
        confirmation.append(
            _plot("confirmation", figures.confirmation(result), "Rendered frames of the recommended set over range.")
        )
    return (
        Section(
            "answer",
            "The answer",
            (
                Text((sentences.answer(result, facts),)),
                proposed,
                Text((sentences.proposed(result),)),
                _plot(
                    "front",
                    figures.front(result),
                    "Closing sets: mean power against marker size, coloured by focal length.",
                ),
                Text(sentences.binding(result, facts)),
                _plot(
                    "binding",
                    figures.binding(result),
                    "Margin of every criterion over range, recommended set, worst illumination.",
                ),
                text_table(tables.criteria_rows(result)),
            ),
        ),
        Section(
            "exposures",
            "Exposure and LEDs at each range",
            (
                Text((sentences.schedule(result, facts),)),
                text_table(tables.schedule_rows(result)),
                Text((sentences.exposure_follows(facts),)),
                _plot("exposures", figures.exposures(result), "Pulse over range, recommended set."),
            ),
        ),
        Section(
            "sensitivity",
            "What the margin depends on",
            (
                Text((sentences.sensitivity(facts),)),
                _plot("tornado", figures.tornado_figure(result), "Smallest margin with one assumption at either end."),
                text_table(tables.tornado_rows(result)),
            ),
            wordy=True,
        ),
        Section(
            "probability",
            "Probability of closure",
            (
                Text((sentences.drawing(facts),)),
                text_table(tables.probability_rows(result)),
                Text((sentences.probability(facts),)),
                _plot("probability", figures.probability_figure(result), "Probability of closure over range."),
            ),
        ),
        Section(
            "alternatives",
            "Other hardware",
            (Text(sentences.alternatives(facts)), text_table(tables.alternative_rows(result))),
        ),
        _hardware_section(result, facts),
        Section("confirmation", "Confirmation by rendering", tuple(confirmation)),
    )


def _hardware_section(result: ClosureResult, facts: Facts | None) -> Section:
    table: Table = text_table(tables.hardware_rows(result), "The thesis's hardware", terminal=facts is not None)
    words: tuple[Block, ...] = () if facts is None else (Text(sentences.hardware(result, facts)),)
    return Section("hardware", "The thesis's own hardware", (*words, table), wordy=True)


def _plot(key: str, figure: Figure, caption: str) -> Plots:
    return Plots((Plot(key, figure, caption),), caption)


def dataset(result: ClosureResult) -> xr.DataTree:
    """Closing sets, exposures of the recommended set and rendered cases as groups, with what made them."""
    groups = {
        name: xr.Dataset({key: (name, _array(values)) for key, values in columns.items()})
        for name, columns in tables.data_columns(result).items()
    }
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {"title": result.constraints.title, **result.made}
    return tree


def _array(values: list[Any]) -> np.ndarray:
    return np.array(values, object) if isinstance(values[0], str) else np.array(values)


def _files(result: ClosureResult) -> dict[str, str]:
    return {
        f"data/closure-{name}.csv": csv_text({key: [_six_digits(v) for v in values] for key, values in columns.items()})
        for name, columns in tables.data_columns(result).items()
    }


def _six_digits(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value


def as_json(result: ClosureResult) -> dict[str, Any]:
    """Sets, exposures, sensitivity, probabilities and hardware as plain data."""
    return {
        "tried": result.found.tried,
        "closing": len(result.found.closing),
        "proposed": [asdict(p) for p in result.proposed],
        "front": [asdict(p) for p in result.found.front],
        "alternatives": [
            {
                "name": a.name,
                "closing": len(a.found.closing),
                "tried": a.found.tried,
                "recommended": asdict(a.recommended) if a.recommended else None,
            }
            for a in result.alternatives
        ],
        "by_tape": {tape: asdict(p) if p else None for tape, p in result.by_tape.items()},
        "exposures": [asdict(e) for e in result.schedule],
        "tornado": asdict(result.tornado) if result.tornado else None,
        "probabilities": [asdict(p) for p in result.probabilities],
        "hardware": [asdict(c) for c in result.hardware],
        "confirmed": [{**asdict(c), "confirmed": c.confirmed} for c in result.confirmed],
    }
