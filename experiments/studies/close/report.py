"""The files of `mantis close`: the HTML report, docs/closure.md with its figures, and tables as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from experiments import chain
from experiments.reporting.blocks import Block, Card, Cell, Figures, Section, Table, Text, csv_text
from experiments.reporting.figures import save_svg
from experiments.reporting.files import write_text
from experiments.reporting.formatting import number, percent
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import assumptions, footer, reproduction
from experiments.studies.close import page as close_page
from experiments.studies.close.confirm import Confirmed, summarise
from experiments.studies.close.figures import figures
from experiments.studies.close.search import CRITERIA_TEXT
from experiments.studies.close.study import Study

#: Columns of a confirmation's records that hold text; all others are numbers.
_TEXT_COLUMNS = ("set", "illumination", "fails")


def write(study: Study, records: list[dict[str, Any]], out_dir: Path, command: str = "mantis close") -> None:
    """Write report.html, closure.md, figures/closure_*.svg and data/closure-*.csv; the folder is laid out as docs/."""
    confirmed = summarise(records)
    drawn = figures(study, records)
    write_text(report(study, records, command), out_dir / "report.html")
    if study.lead is not None:
        write_text(close_page.page(study, confirmed), out_dir / "closure.md")
    for name, (plot, _) in drawn.items():
        save_svg(plot, out_dir / "figures" / f"closure_{name}.svg")
    for name, text in tables(study, records).items():
        write_text(text, out_dir / "data" / f"closure-{name}.csv")


def tables(study: Study, records: list[dict[str, Any]]) -> dict[str, str]:
    """CSV texts: every closing set, the ladder of the recommended one, and the confirmation case by case."""
    front, proposed = set(map(id, study.found.front)), set(map(id, study.proposed))
    sets: dict[str, list[object]] = {}
    for p in study.found.closing:
        row = {
            "tape": p.tape, "size_m": p.size_m, "focal_length_m": p.focal_length_m, "f_number": p.f_number, "leds": p.led_count,
            "power_w": f"{p.power_w:.6g}", "energy_j": f"{p.energy_j:.6g}", "on_front": id(p) in front,
            "proposed": id(p) in proposed, **{f"margin_{name}": f"{p.margins[name]:.6g}" for name in CRITERIA_TEXT},
        }  # fmt: skip
        for key, value in row.items():
            sets.setdefault(key, []).append(value)
    ladder: dict[str, list[object]] = {
        "range_m": [r.range_m for r in study.rungs], "illumination": [r.illumination for r in study.rungs],
        "life": [r.life for r in study.rungs], "leds": [r.leds for r in study.rungs],
        "pulse_s": [f"{r.pulse_s:.6g}" for r in study.rungs], "energy_j": [f"{r.energy_j:.6g}" for r in study.rungs],
    }  # fmt: skip
    cases = {key: [_plain(r[key]) for r in records] for key in (records[0] if records else {})}
    result = {"sets": csv_text(sets), "ladder": csv_text(ladder)}
    return result | ({"confirmation": csv_text(cases)} if cases else {})


def _plain(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value


def read_records(path: Path) -> list[dict[str, Any]]:
    """Records of a confirmation as `tables` writes them.

    Raises:
        OSError: when the file cannot be read.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        {k: v == "True" if k == "closes" else v if k in _TEXT_COLUMNS else float(v) for k, v in row.items()}
        for row in rows
    ]


def report(study: Study, records: list[dict[str, Any]], command: str = "mantis close") -> str:
    """The report as one HTML text that loads nothing from elsewhere."""
    confirmed = summarise(records)
    lead, constraints, base = study.lead, study.constraints, study.base
    scenario = lead.scenario(base, constraints, constraints.end_of_life) if lead else base
    history = f"{datetime.now(UTC):%Y-%m-%dT%H:%MZ} mantis close"
    attributes = {**chain.provenance(scenario), "history": history}
    passed = lead is not None and all(c.confirmed for c in confirmed if c.label == lead.label)
    return render(
        Report(
            constraints.title, "Mantis closure search", close_page.headline(study, confirmed), passed,
            tuple(_cards(study, confirmed)), tuple(_advice(study, confirmed)), tuple(_sections(study, records, confirmed)),
            tuple(assumptions(scenario)), tuple(reproduction(scenario, attributes, command)), footer(attributes),
        )
    )  # fmt: skip


def _advice(study: Study, confirmed: list[Confirmed]) -> Iterator[str]:
    if study.lead is None:
        yield (
            f"Of {study.found.tried:,} sets, {study.found.focused:,} meet sampling, frame and focus: relax these first where it "
            "is none."
        )
        return
    said = close_page.words(study, confirmed)
    yield close_page.plain(said["binds"])
    for topic, key in (
        ("Exposure", "follow_note"), ("Sensitivity", "sensitivity"), ("Probability", "chance"), ("Hardware", "hardware"),
    ):  # fmt: skip
        yield f"{topic}: {close_page.plain(said[key])}"


def _cards(study: Study, confirmed: list[Confirmed]) -> Iterator[Card]:
    lead = study.lead
    if lead is not None:
        seen = next((c for c in confirmed if c.label == lead.label), None)
        lines = [f"{name}: ×{number(m)}" for name, m in sorted(lead.margins.items(), key=lambda item: item[1])[:5]]
        note = f"binds: {lead.binding[0]} at {lead.binding[1]:g} m"
        note += "" if seen is None else f"; {seen.closing} of {seen.cases} rendered cases close"
        yield Card("Recommended set", lead.label, note, tuple(lines), seen is None or seen.confirmed)
        first = study.probabilities[0]
        others = tuple(
            f"{p.label}: {percent(p.following)}, ladder as it stands {percent(p.frozen)}" for p in study.probabilities
        )
        yield Card(
            "Probability of closure", percent(first.following), "under the stated uncertainties, exposure follows the light",
            others, first.following >= 0.95,
        )  # fmt: skip
    plain = study.hardware[1]
    least = study.minimal.name if study.minimal else "no single change"
    yield Card(
        "The thesis's own hardware", f"to {plain.reach_m:.1f} m", "where the exposure follows the light",
        tuple(
            f"{c.name}: {'closes' if c.closes else 'does not close'}{'' if c.allowed else ', not allowed'}"
            for c in study.hardware
        ),
        plain.closes, "Smallest change", (least,),
    )  # fmt: skip


def _sections(study: Study, records: list[dict[str, Any]], confirmed: list[Confirmed]) -> Iterator[Section]:
    drawn = figures(study, records)

    def picture(name: str) -> Block:
        plot, caption = drawn[name]
        return Figures((figure(plot, name, caption),), caption + ".")

    if study.lead is None:
        yield Section("hardware", "The thesis's own hardware", (_table(close_page.hardware_rows(study)),), wordy=True)
        return
    said = close_page.words(study, confirmed)

    def text(*keys: str) -> Text:
        return Text(tuple(close_page.plain(said[key]) for key in keys))

    yield Section(
        "sets", "Sets that close",
        (text("answer", "proposed_note"), _table(close_page.proposed_rows(study, confirmed)), picture("front")),
    )  # fmt: skip
    yield Section(
        "binding",
        "What binds",
        (text("binds"), picture("binding"), _table(close_page.criteria_rows(study))),
        wordy=True,
    )
    yield Section(
        "ladder", "Exposure and LED ladder",
        (text("ladder_note"), _table(close_page.ladder_rows(study)), text("follow_note"), picture("ladder")),
    )  # fmt: skip
    yield Section(
        "sensitivity", "What the margin hangs on",
        (text("sensitivity"), picture("tornado"), _table(close_page.tornado_rows(study))), wordy=True,
    )  # fmt: skip
    yield Section(
        "probability", "Probability of closure",
        (text("chance"), _table(close_page.probability_rows(study)), picture("probability")), wordy=True,
    )  # fmt: skip
    yield Section(
        "alternatives", "Other hardware", (text("alternatives"), _table(close_page.alternative_rows(study))), wordy=True
    )
    yield Section(
        "hardware", "The thesis's own hardware", (text("hardware"), _table(close_page.hardware_rows(study))), wordy=True
    )
    blocks: list[Block] = [text("confirmation")]
    if records:
        blocks += [_table(close_page.confirmation_rows(confirmed)), picture("confirmation")]
    yield Section("confirmation", "Confirmation by rendering", tuple(blocks), wordy=True)


def _table(rows: list[tuple[str, ...]]) -> Table:
    return Table(rows[0], tuple(tuple(Cell(text) for text in row) for row in rows[1:]))
