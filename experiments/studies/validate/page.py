"""The page of `mantis validate`: whether closed form and rendering agree, where not, and what the difference is made of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Block, Bullets, Card, Cell, Download, Plot, Plots, Section, Table, Text
from experiments.reporting.formatting import listed, number, percent
from experiments.reporting.page import Page
from experiments.studies.validate import figures
from experiments.studies.validate.cells import EFFECTS, QUANTITIES, REMAINDERS
from experiments.studies.validate.crosscheck import TOLERANCE, Agreement
from experiments.studies.validate.study import (
    COARSE_TOLERANCE,
    CONFIDENCE,
    FINE_PX_PER_BIT,
    FINE_TOLERANCE,
    ValidationResult,
)
from experiments.studies.validate.summary import cells_csv, outside, summary

STEM = "validation"
#: Lines about single cells that the page shows at most.
MAX_LINES = 10
_NAMES = {"signal": "signal", "background": "background", "snr": "SNR", "cnr": "CNR"}

ABOUT = (
    "Every bit's signal S, background B, SNR and CNR are computed twice, in closed form (experiments/chain/link_budget.py) and "
    "from rendered transport, over a grid of cells. The exposure is the automatic one of each cell.",
)
LIMITS = (
    "Closed form and renderer share the materials' definition (tests hold it to Mitsuba's own BSDFs) and the camera's; what "
    "neither has is not seen here.",
    "The Sun is a point in the closed form and a disc of 0.27° in the renderer. At a phase angle of exactly 0° it stands in the "
    "retroreflective lobe and the closed form is 30 % too bright; from 5° on the disc does not matter.",
    "The closed form takes the Sun to light the floors of the encoding elements as the LEDs do.",
    "Veiling glare is left out, because only the detector's middle is rendered.",
)


def page(result: ValidationResult, command: str = "mantis validate") -> Page:
    """The page of a validation.

    Args:
        result: of `study.run`.
        command: the command line that made it.
    """
    facts, cells_outside = summary(result.dataset), list(outside(result.dataset))
    failed = [check for check in result.checks if not check.agrees]
    bad = [*cells_outside, *(f"{c.what} differs from {c.by} by {percent(c.difference)}" for c in failed)]
    cells = f"{facts['validated'] - facts['outside']:.0f} of {facts['validated']:.0f} cells agree"
    agreeing = len(result.checks) - len(failed)
    return Page(
        study="validate",
        title="Closed form against rendering",
        headline=f"{cells}, and {agreeing} of {len(result.checks)} cross-checks by other people's code.",
        passed=not bad,
        command=command,
        sections=(
            Section("cells", "What is compared", tuple(_cells(result.dataset, facts))),
            Section("agreement", "Agreement", tuple(_agreement(result.dataset, facts, cells_outside))),
            Section("budget", "Error budget", tuple(_error_budget(result.dataset, facts)), wordy=True),
            Section("crosschecks", "Cross-checks by other people's code", tuple(_crosschecks(result))),
        ),
        findings=(*_findings(facts), *(f"Outside: {line}" for line in bad[:MAX_LINES])),
        cards=tuple(_cards(result, facts, failed)),
        about=ABOUT,
        limits=LIMITS,
        scenario=result.scenario,
        data=result.dataset,
        stem=STEM,
        unmet={"agrees": f"{len(bad)} outside, first: {bad[0]}"} if bad else {},
        extra={
            "summary": facts,
            "outside": bad,
            "crosschecks": {check.what: check.difference for check in result.checks},
            "indirect": result.indirect,
        },
    )


def _findings(facts: dict[str, float]) -> Iterator[str]:
    if facts["validated"]:
        yield (
            f"Error budget: what the facets do not explain is at most {percent(facts['signal_unexplained'])} of the signal and "
            f"{percent(facts['background_unexplained'])} of the background."
        )
        yield (
            f"Noise: the drawn variance is {_pooled(facts)} times the closed form's over all cells; the worst cell is at "
            f"{facts['noise_worst_sigma']:.1f} standard deviations."
        )


def _pooled(facts: dict[str, float]) -> str:
    return f"{facts['noise_pooled_ratio']:.4f} ± {facts['noise_pooled_uncertainty']:.4f}"


def _cards(result: ValidationResult, facts: dict[str, float], failed: list[Agreement]) -> Iterator[Card]:
    dataset = result.dataset
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
        score = f"worst cell at {facts['noise_worst_sigma']:.1f} standard deviations"
        note = f"times the closed form's variance, over {dataset.attrs['draws']} draws"
        agrees = bool(dataset.noise_agrees.where(dataset.px_per_bit > 0).all())
        yield Card("Drawn noise", _pooled(facts), note, (score,), agrees)
    largest = max((abs(check.difference) for check in result.checks), default=0.0)
    note = f"agree to {percent(TOLERANCE)} and four standard uncertainties of the sampling"
    text = f"{len(result.checks) - len(failed)} of {len(result.checks)}"
    yield Card("Cross-checks", text, note, (f"largest difference {percent(largest)}",), not failed)


def _cells(dataset: xr.Dataset, facts: dict[str, float]) -> Iterator[Block]:
    suns = [f"{phase:g}°" for phase in dataset.phase_deg.values if np.isfinite(phase)]
    axes = {
        "range": f"{_values(dataset.range_m)} m",
        "side of the marker": f"{_values(100 * dataset.size_m)} cm",
        "tilt": f"{_values(dataset.tilt_deg)}°, shared by yaw and pitch, so that the marker's axes are skew in the image",
        "illumination": f"eclipse; LEDs and the Sun at phase angles of {listed(suns)}",
        "sensor": "the scenario's; presets: " + ", ".join(map(str, dataset.sensor.values[1:])),
    }
    rows = tuple((Cell(name, style="left"), Cell(values, style="left")) for name, values in axes.items())
    yield Table(("axis", "values"), rows, sortable=False)
    missing = facts["cells"] - facts["validated"]
    text = f"All combinations are {facts['cells']:.0f} cells."
    if missing:
        text += f" In {missing:.0f} of them bits lie outside the frame; they are not judged."
    yield Text((text,))
    yield Download("Every cell as CSV", "mantis-validation-cells.csv", cells_csv(dataset), key="cells")


def _values(axis: xr.DataArray) -> str:
    return listed([f"{value:g}" for value in axis.values])


def _agreement(dataset: xr.Dataset, facts: dict[str, float], cells_outside: list[str]) -> Iterator[Block]:
    caption = (
        "Rendered over closed form, less one, against pixels per bit: every cell. Grey is what is allowed; the scale is linear "
        "up to 0.01 %."
    )
    yield Plots((Plot("agreement", figures.agreement(dataset), caption),))
    sides = (("fine", FINE_TOLERANCE), ("coarse", COARSE_TOLERANCE))
    rows = tuple(
        (Cell(_NAMES[name]), *(_held(facts[f"{name}_worst_{side}"], allowed) for side, allowed in sides))
        for name in QUANTITIES
    )
    heads = (
        "quantity",
        f"from {FINE_PX_PER_BIT:g} px per bit on ({percent(FINE_TOLERANCE)} allowed)",
        f"below {FINE_PX_PER_BIT:g} px per bit ({percent(COARSE_TOLERANCE)} allowed)",
    )
    yield Table(heads, rows, "Largest difference", key="agreement", terminal=True)
    yield Text(
        (
            f"Noise: the variance of each cell's bright-bit pixels over {dataset.attrs['draws']} draws is held to the sensor's "
            "closed-form variance, and their mean to its mean, each within an interval so wide that all checks pass together "
            f"with a probability of {percent(CONFIDENCE)} (Šidák).",
        )
    )
    if cells_outside:
        yield Bullets(tuple(f"Outside: {line}" for line in cells_outside))


def _held(value: float, allowed: float) -> Cell:
    """A share and whether it is within what is allowed; a dash where no cell is on that side."""
    return Cell(percent(value), value, None if np.isnan(value) else value <= allowed)


def _error_budget(dataset: xr.Dataset, facts: dict[str, float]) -> Iterator[Block]:
    caption = (
        "Every term over range for the smallest marker at the largest tilt and phase. Left: by how much the signal would be "
        "off without an effect. Middle and right: what remains between closed form and rendering (black), and what it is made of."
    )
    yield Plots((Plot("error-budget", figures.error_budget(dataset), caption),))
    rows: list[tuple[Cell, ...]] = []
    for name, text in EFFECTS.items():
        size = abs(dataset.effect_on_signal.sel(effect=name))
        rows.append((Cell(name.replace("_", " ")), Cell(text, style="left"), _largest(size)))
    heads: tuple[str, ...] = ("effect in the closed form", "left out", "largest change of the signal")
    yield Table(heads, tuple(rows), "What the closed form includes", key="effects")
    sides = ("signal", "background")
    rows = []
    for name, text in REMAINDERS.items():
        sizes = [abs(dataset.remainder.sel(source=name, quantity=side)) for side in sides]
        rows.append((Cell(name.replace("_", " ")), Cell(text, style="left"), *map(_largest, sizes)))
    found = [abs(dataset[f"{side}_difference"]) for side in sides]
    rows.append((Cell("difference found"), Cell("", style="left"), *map(_largest, found)))
    unexplained = [facts[f"{side}_unexplained"] for side in sides]
    text = "difference found, less the facets' part"
    rows.append((Cell("unexplained"), Cell(text, style="left"), *(Cell(percent(u), u) for u in unexplained)))
    heads = ("what remains", "how it is computed", "signal, at most", "background, at most")
    yield Table(heads, tuple(rows), "What remains", key="remainders")


def _largest(sizes: xr.DataArray) -> Cell:
    largest = float(sizes.max())
    return Cell(percent(largest), largest)


def _crosschecks(result: ValidationResult) -> Iterator[Block]:
    yield Text(
        (
            "Taken at 2 m, tilted by 40°, with the ICX429AL, whose quantum efficiency falls steeply over the passband.",
            "Transport: stock Mitsuba's path samples wavelengths at random, with the sources' own spectra, on a specfilm "
            "whose response is the camera's, with knots 1 nm apart. Pixels are square and without point spread on both sides.",
            "Spectral integrals: colour-science interpolates (Sprague) and integrates the solar spectrum and the LED line "
            "against filter, quantum efficiency and photon energy.",
            "Electrons: mean and variance of the numbers that prysm's detector draws, against the closed-form moments. Its "
            "full well is left open, because prysm lets the bias take room in it.",
        )
    )
    rows = tuple(
        (
            Cell(check.what),
            Cell(check.by, style="left"),
            Cell(number(check.ours), check.ours),
            Cell(number(check.theirs), check.theirs),
            Cell(f"{check.difference:+.1e}", check.difference, check.agrees),
            Cell(f"{check.uncertainty:.0e}", check.uncertainty),
        )
        for check in result.checks
    )
    exact = tuple((c.what, c.by, c.ours, c.theirs, c.difference, c.uncertainty) for c in result.checks)
    heads = ("quantity", "by", "ours", "theirs", "ours over theirs, less one", "uncertainty of the sampling")
    caption = "The same quantity by other people's code"
    yield Table(heads, rows, caption, key="crosschecks", exact=exact, terminal=True)
    yield Text(
        (
            "Nothing faces the marker's front plane, so bits and dark cells gain nothing from light that is reflected twice; "
            "foil and cavities do.",
        )
    )
    yield Table(
        ("part of the frame", "gain"),
        tuple((Cell(part), Cell(f"{gain:+.1e}", gain)) for part, gain in result.indirect.items()),
        "Indirect light, which this project leaves out: stock path with four segments against two",
        key="indirect",
        exact=tuple(result.indirect.items()),
    )
