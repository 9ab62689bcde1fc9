"""The report of `mantis validate`: whether the closed form and rendering agree, where not, and what the difference is "
"made of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Block, Bullets, Card, Cell, Download, Figures, Section, Table, Text
from experiments.reporting.formatting import number, percent
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import assumptions, footer, reproduction
from experiments.scenario import Scenario
from experiments.studies.validate import figures as validate_figures
from experiments.studies.validate.crosscheck import TOLERANCE, Agreement
from experiments.studies.validate.study import (
    COARSE_TOLERANCE,
    CONFIDENCE,
    EFFECTS,
    FINE_PX_PER_BIT,
    FINE_TOLERANCE,
    QUANTITIES,
    REMAINDERS,
)
from experiments.studies.validate.tables import cells_csv, outside, summary

_NAMES = {"signal": "signal", "background": "background", "snr": "SNR", "cnr": "CNR"}
LIMITS = (
    "Closed form and renderer share the materials' definition (tests hold it to Mitsuba's own BSDFs) and the camera's; what "
    "neither has is not seen here.",
    "The Sun is a point in the closed form and a disc of 0.27° in the renderer: at a phase angle of exactly 0° the closed "
    "form is 30 % too bright.",
    "The closed form takes the Sun to light the floors of the encoding elements as the LEDs do.",
    "Veiling glare is left out: only the detector's middle is rendered.",
)


def html(
    dataset: xr.Dataset, checks: list[Agreement], indirect: dict[str, float], scenario: Scenario, command: str
) -> str:
    """The report as one HTML text that loads nothing from elsewhere.

    Args:
        dataset: of `study.run`.
        checks, indirect: of `crosscheck.run`.
        scenario: camera, LEDs and materials.
        command: the command line that made it.
    """
    facts, bad = summary(dataset), list(outside(dataset))
    failed = [c for c in checks if not c.agrees]
    cells = f"{facts['validated'] - facts['outside']:.0f} of {facts['validated']:.0f} cells agree"
    headline = f"{cells}, and {len(checks) - len(failed)} of {len(checks)} cross-checks by other people's code."
    evidence = (
        Section("agreement", "Closed form against rendering", tuple(_agreement(dataset, facts, bad))),
        Section("budget", "Error budget", tuple(_error_budget(dataset, facts)), wordy=True),
        Section("crosschecks", "Cross-checks by other people's code", tuple(_crosschecks(checks, indirect))),
    )
    return render(
        Report(
            "Closed form against rendering, cell by cell",
            "Mantis validation",
            headline,
            not bad and not failed,
            tuple(_cards(dataset, facts, checks, failed)),
            tuple(bad[:10]) + tuple(f"{c.what} differs from {c.by} by {percent(c.difference)}" for c in failed),
            evidence,
            (Text(("What this comparison cannot see:",)), Bullets(LIMITS), *assumptions(scenario)),
            tuple(reproduction(scenario, dataset.attrs, command)),
            footer(dataset.attrs),
        )
    )


def _cards(
    dataset: xr.Dataset, facts: dict[str, float], checks: list[Agreement], failed: list[Agreement]
) -> Iterator[Card]:
    for side, where, allowed in (
        ("fine", f"from {FINE_PX_PER_BIT:g} px per bit on", FINE_TOLERANCE),
        ("coarse", f"below {FINE_PX_PER_BIT:g} px per bit", COARSE_TOLERANCE),
    ):
        found = {name: facts[f"{name}_worst_{side}"] for name in QUANTITIES}
        worst = float(np.nanmax([0.0, *found.values()]))
        lines = tuple(f"{_NAMES[name]}: {percent(value)}" for name, value in found.items())
        yield Card(
            f"Largest difference, {where}", percent(worst), f"{percent(allowed)} allowed", lines, worst <= allowed
        )
    if "noise_pooled_ratio" in facts:
        ratio = f"{facts['noise_pooled_ratio']:.4f} ± {facts['noise_pooled_uncertainty']:.4f}"
        score = (
            f"worst cell at {facts['noise_worst_sigma']:.1f} standard deviations; all together held at {CONFIDENCE:.1%}"
        )
        note = f"times the closed form's variance, over {dataset.attrs['draws']} draws"
        yield Card("Drawn noise", ratio, note, (score,), bool(dataset.noise_agrees.where(dataset.px_per_bit > 0).all()))
    largest = max((abs(c.difference) for c in checks), default=0.0)
    note = f"agree to {percent(TOLERANCE)} and four standard uncertainties of the sampling"
    text = f"{len(checks) - len(failed)} of {len(checks)}"
    yield Card("Cross-checks", text, note, (f"largest difference {percent(largest)}",), not failed)


def _agreement(dataset: xr.Dataset, facts: dict[str, float], bad: list[str]) -> Iterator[Block]:
    caption = (
        "Rendered over closed form, less one, against pixels per bit: every cell. Grey is what is allowed; the scale is "
        "linear up to 0.01 %."
    )
    yield Figures((figure(validate_figures.agreement(dataset), "agreement", caption),), caption)
    sides = (("fine", FINE_TOLERANCE), ("coarse", COARSE_TOLERANCE))
    rows = [
        (Cell(_NAMES[name]), *(_held(facts[f"{name}_worst_{side}"], allowed) for side, allowed in sides))
        for name in QUANTITIES
    ]
    heads = ("quantity", f"from {FINE_PX_PER_BIT:g} px per bit on", f"below {FINE_PX_PER_BIT:g} px per bit")
    yield Table(heads, tuple(rows), "Largest difference")
    missing = facts["cells"] - facts["validated"]
    lines = [f"{missing:.0f} cells have bits outside the frame and are not judged."] if missing else []
    yield Bullets((*lines, *(f"Outside: {line}" for line in bad)))
    yield Download("Save every cell as CSV", "mantis-validation-cells.csv", cells_csv(dataset))


def _held(value: float, allowed: float) -> Cell:
    """A share and whether it is within what is allowed; a dash where no cell is on that side."""
    return Cell(percent(value), value, None if np.isnan(value) else value <= allowed)


def _error_budget(dataset: xr.Dataset, facts: dict[str, float]) -> Iterator[Block]:
    caption = (
        "Every term over range for the smallest marker at the largest tilt and phase. Left: by how much the signal would be "
        "off without an effect. Middle and right: what remains between closed form and rendering (black), and what it is "
        "made of."
    )
    yield Figures((figure(validate_figures.error_budget(dataset), "error-budget", caption),), caption)
    rows: list[tuple[Cell, ...]] = []
    for name, text in EFFECTS.items():
        size = float(abs(dataset.effect_on_signal.sel(effect=name)).max())
        rows.append((Cell(name.replace("_", " ")), Cell(text, style="left"), Cell(percent(size), size)))
    yield Table(
        ("effect in the closed form", "left out", "largest change of the signal"),
        tuple(rows),
        "What the closed form includes",
    )
    rows = []
    for name, text in REMAINDERS.items():
        sizes = [float(abs(dataset.remainder.sel(source=name, quantity=q)).max()) for q in ("signal", "background")]
        rows.append((Cell(name.replace("_", " ")), Cell(text, style="left"), *(Cell(percent(s), s) for s in sizes)))
    found = [float(abs(dataset[f"{q}_difference"]).max()) for q in ("signal", "background")]
    rows.append((Cell("difference found"), Cell("", style="left"), *(Cell(percent(s), s) for s in found)))
    unexplained = [facts[f"{q}_unexplained"] for q in ("signal", "background")]
    text = "what the terms above do not explain, Monte Carlo aside"
    rows.append((Cell("unexplained"), Cell(text, style="left"), *(Cell(percent(s), s) for s in unexplained)))
    heads = ("what remains", "how it is computed", "signal, at most", "background, at most")
    yield Table(heads, tuple(rows), "What remains")


def _crosschecks(checks: list[Agreement], indirect: dict[str, float]) -> Iterator[Block]:
    rows = [
        (
            Cell(c.what), Cell(c.by, style="left"), Cell(number(c.ours), c.ours), Cell(number(c.theirs), c.theirs),
            Cell(f"{c.difference:+.1e}", c.difference, c.agrees), Cell(f"{c.uncertainty:.0e}", c.uncertainty),
        )
        for c in checks
    ]  # fmt: skip
    heads = ("quantity", "by", "ours", "theirs", "ours over theirs, less one", "uncertainty of the sampling")
    yield Table(heads, tuple(rows), "The same quantity by other people's code")
    yield Table(
        ("part of the frame", "gain"),
        tuple((Cell(part), Cell(f"{gain:+.1e}", gain)) for part, gain in indirect.items()),
        "Indirect light, which this project leaves out: stock path with four segments against two",
    )
