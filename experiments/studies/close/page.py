"""docs/closure.md, and the words and tables that it shares with the HTML report."""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.resources import files
from textwrap import fill
from typing import Any

import jinja2
import numpy as np

from experiments.reporting.formatting import listed, number, percent, ranges_text, seconds_text
from experiments.studies.close.confirm import Confirmed
from experiments.studies.close.constraints import ConfirmView
from experiments.studies.close.form import FINE_DIFFERENCE, PHASE_DIFFERENCE
from experiments.studies.close.search import CRITERIA_TEXT, Point
from experiments.studies.close.sensitivity import Probability
from experiments.studies.close.study import Change, Study

Rows = list[tuple[str, ...]]
_WRAP: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}


def headline(study: Study, confirmed: list[Confirmed]) -> str:
    """One sentence: whether anything closes, and what is recommended."""
    span = f"{study.form.ranges_m[0]:g}–{study.form.ranges_m[-1]:g} m"
    if study.lead is None:
        return f"No set of parameters closes {span} within the constraints."
    word = "confirmed by rendering" if _is_confirmed(study.lead, confirmed) else "not confirmed by rendering"
    return (
        f"{len(study.found.closing)} of {study.found.tried:,} parameter sets close {span} in eclipse and sunlight; recommended, "
        f"and {word}: {study.lead.label}, {number(1e3 * study.lead.power_w)} mW."
    )


def _is_confirmed(point: Point, confirmed: list[Confirmed]) -> bool:
    return any(c.label == point.label and c.confirmed for c in confirmed)


def proposed_rows(study: Study, confirmed: list[Confirmed]) -> Rows:
    """The proposed sets, the recommended one first."""
    rows: Rows = [
        ("marker", "lens", "pupil", "LEDs (fewest)", "a pulse", "mean", "peak", "smallest margin", "binds", "rendered")
    ]
    for p in study.proposed:
        seen = next((c for c in confirmed if c.label == p.label), None)
        verdict = "–" if seen is None else f"{'✓' if seen.confirmed else '✗'} {seen.closing} of {seen.cases} cases"
        rows.append(
            (
                f"{100 * p.size_m:g} cm", f"{1e3 * p.focal_length_m:.4g} mm F/{p.f_number:.3g}",
                f"{1e3 * p.focal_length_m / p.f_number:.2g} mm", f"{p.led_count} ({p.fewest_leds})",
                f"{number(1e3 * p.energy_j)} mJ",
                f"{number(1e3 * p.power_w)} mW", f"{number(p.peak_power_w)} W", f"{p.margin:.3f}",
                f"{p.binding[0]} at {p.binding[1]:g} m", verdict,
            )
        )  # fmt: skip
    return rows


def criteria_rows(study: Study) -> Rows:
    """Every criterion of the recommended set with its margin."""
    assert study.lead is not None
    c, r = study.constraints, study.base.requirement
    limits = {
        "saturation": f"≤ {r.full_well_fraction_max:g} full well", "cnr": f"≥ {r.cnr_min:g}",
        "sampling": f"≥ {r.px_per_bit_min:g} px/bit at {c.tilt_deg:g}° tilt", "smear": f"≤ {r.smear_px_max:g} px",
        "frame": f"≤ {c.frame_share_max:g} of the shorter side", "focus": f"≤ {c.blur_bits_max:g} bit",
        "sun": f"≥ {c.led_over_sun_min:g}", "glint": f"≤ {c.glint_over_well_max:g}",
        "energy": f"≤ {c.energy_per_frame_j:g} J", "power": f"≤ {c.average_power_w:g} W",
    }  # fmt: skip
    body = [(name, CRITERIA_TEXT[name], limits[name], f"{number(m)}") for name, m in study.lead.margins.items()]
    return [("criterion", "is about", "limit", "margin"), *body]


def ladder_rows(study: Study, ranges_m: tuple[float, ...] | None = None) -> Rows:
    """Pulse and energy at each range, eclipse and Sun, new and worn."""
    rows: Rows = [("range", "LEDs", "eclipse, worn", "Sun, worn", "eclipse, new", "Sun, new", "a pulse, eclipse, worn")]
    worn = _worn(study)
    for range_m in study.form.ranges_m:
        if ranges_m is not None and range_m not in ranges_m:
            continue
        here = {(r.life, r.illumination): r for r in study.rungs if r.range_m == range_m}
        cells = [here[(life, illumination)] for life in (worn, "new") for illumination in ("eclipse", "sunlit")]
        counts = sorted({r.leds for r in cells})
        leds = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}–{counts[-1]}"
        pulses = [seconds_text(r.pulse_s) for r in cells]
        rows.append((f"{range_m:g} m", leds, *pulses, f"{number(1e3 * cells[0].energy_j)} mJ"))
    return rows


def tornado_rows(study: Study) -> Rows:
    """Smallest margins at both ends of every assumption."""
    assert study.tornado is not None
    rows: Rows = [("assumption", "factor", "margin, exposure follows", "margin, ladder as it stands", "source")]
    sources = {u.name: u.source for u in study.constraints.uncertainties}
    for b in study.tornado.bars:
        ends = [f"{number(pair[0])} to {number(pair[1])}" for pair in (b.following, b.frozen)]
        rows.append((b.name, f"×{b.low:.3g} to ×{b.high:.3g}", *ends, sources[b.name]))
    return rows


def probability_rows(study: Study) -> Rows:
    """Probability of closure of every variant, and what fails."""
    rows: Rows = [
        ("hardware", "closes, exposure follows", "closes, ladder as it stands", "fails most, exposure follows")
    ]
    for p in study.probabilities:
        rows.append((p.label, _share(p.following, p.following_ci95), _share(p.frozen, p.frozen_ci95), _worst(p)))
    return rows


def _share(share: float, ends: tuple[float, float]) -> str:
    return f"{100 * share:.1f} % ({100 * ends[0]:.1f}–{100 * ends[1]:.1f})"


def _worst(p: Probability) -> str:
    failing = sorted(((s[0], n) for n, s in p.failing.items() if s[0] > 0), reverse=True)[:2]
    return listed([f"{name} ({100 * share:.1f} %)" for share, name in failing]) if failing else "nothing"


def alternative_rows(study: Study) -> Rows:
    """The search around other hardware: the scenario's own, one thing changed, and the best of each kind together."""
    rows: Rows = [("hardware", "sets that close", "recommended", "mean", "margin of light", "smallest margin, binds")]
    for a in study.alternatives:
        name = f"{a.name} (best)" if a is study.best else a.name
        count = f"{len(a.found.closing):,} of {a.found.tried:,}"
        if a.lead is None:
            rows.append((name, count, "–", "–", "–", "–"))
            continue
        lead = replace(a.lead, hardware="")
        binds = f"{lead.margin:.3f}, {lead.binding[0]} at {lead.binding[1]:g} m"
        rows.append((name, count, lead.label, f"{number(1e3 * lead.power_w)} mW", number(a.light_margin), binds))
    return rows


def hardware_rows(study: Study) -> Rows:
    """The thesis's hardware as flown and with one change at a time."""
    rows: Rows = [("hardware", "change", "closes at", "fails, by the factor missed", "allowed")]
    for c in study.hardware:
        change = "none" if c.factor == 1 else f"×{c.factor:.2f}"
        rows.append((c.name, change, _where(c), _misses(c), "yes" if c.allowed else "no"))
    return rows


def _where(c: Change) -> str:
    return "every range" if c.closes else ranges_text(c.ranges_m, c.closing_m)


def _misses(c: Change) -> str:
    return ", ".join(f"{n} ×{number(1 / m)}" for n, m in c.failing.items()) or "nothing"


def confirmation_rows(confirmed: list[Confirmed]) -> Rows:
    """What the frames say of every set."""
    rows: Rows = [
        ("set", "cases that close", "frames with the marker", "attitude", "range", "CNR, least", "signal, form")
    ]
    for c in confirmed:
        rows.append(
            (
                c.label, f"{c.closing} of {c.cases}", f"{c.found} of {c.frames} (> {100 * c.found_low:.1f} %)",
                f"{number(c.attitude_deg)}°", percent(c.range_error), number(c.cnr),
                f"within {100 * max(c.signal_difference, 1e-4):.2f} %",
            )
        )  # fmt: skip
    return rows


def words(study: Study, confirmed: list[Confirmed]) -> dict[str, str]:
    """The sentences of `words.md`, by name; without a closing set none.

    Markdown's bold is kept; `plain` takes it away.
    """
    if study.lead is None:
        return {}
    module = _environment().from_string(_template("words.md")).make_module(_facts(study, confirmed))
    return {
        name: " ".join(str(value).split()) for name, value in vars(module).items() if not name.startswith(("_", "name"))
    }


def plain(text: str) -> str:
    """A sentence without Markdown."""
    return text.replace("**", "")


def _facts(study: Study, confirmed: list[Confirmed]) -> dict[str, Any]:
    """Numbers and names that page and sentences put in."""
    lead, limits, base = study.lead, study.constraints, study.base
    assert lead is not None
    fixed, own = study.hardware[:2]
    return {
        **_ladder_facts(study), **_sensitivity_facts(study), **_alternative_facts(study),
        "lead": lead, "base": base, "closing": len(study.found.closing),
        "tried": f"{study.found.tried:,}", "front": len(study.found.front), "tapes": listed(_by_tape(study)),
        "frame_rate": limits.frame_rate_hz(base), "seen": next((c for c in confirmed if c.label == lead.label), None),
        "near_m": limits.ranges_m[0], "far_m": limits.ranges_m[-1], "px_per_bit_min": base.requirement.px_per_bit_min,
        "largest_cm": 100 * limits.marker_over_face_max * base.target.face_m, "tilt": limits.tilt_deg,
        "first_phase": limits.phases_deg[0], "last_phase": limits.phases_deg[-1],
        "own_lens": f"{base.camera.focal_length_m * 1e3:.4g} mm F/{base.camera.f_number:g}", "plain": own,
        "plain_where": _where(own), "fixed_where": _where(fixed), "fixed_misses": f"it misses {_misses(fixed)}",
        "frontal_m": own.reach_m / np.cos(np.radians(limits.tilt_deg)), "minimal": study.minimal,
        "confirmed": len(confirmed), "good": sum(c.confirmed for c in confirmed), "trials": limits.confirm.trials,
        "unconfirmed": [c for c in confirmed if not c.confirmed],
        "views": listed([_view(v, limits.ranges_m) for v in limits.confirm.views]),
        "glint_limit": limits.glint_over_well_max, "blur_limit": limits.blur_bits_max,
        "phase_difference": PHASE_DIFFERENCE,
        "fine_difference": FINE_DIFFERENCE,
    }  # fmt: skip


def _alternative_facts(study: Study) -> dict[str, Any]:
    own, best = study.alternatives[0], study.best
    assert best is not None
    none = [a.name for a in study.alternatives[1:] if a.lead is None]
    roomiest = max(study.alternatives, key=lambda a: len(a.found.closing) / a.found.tried if a.found.tried else 0.0)
    return {
        "own_light": own.light_margin,
        "best_hardware": best,
        "roomiest": roomiest,
        "without": f"None closes with {listed(none)}" if none else "Each of them has sets that close",
    }


def _view(view: ConfirmView, ranges_m: tuple[float, ...]) -> str:
    return f"{view.label} ({len(view.ranges_m or ranges_m)} ranges)"


def _by_tape(study: Study) -> list[str]:
    return [
        f"{tape_name(tape)} {number(1e3 * p.power_w)} mW" if p else f"{tape_name(tape)} none"
        for tape, p in study.by_tape.items()
    ]


def tape_name(material: str) -> str:
    """'Type XI' of 'tape_type_xi'."""
    name = material.removeprefix("tape_").removeprefix("type_")
    return f"Type {name.upper()}" if material.startswith("tape_type_") else name.replace("_", " ")


def _ladder_facts(study: Study) -> dict[str, Any]:
    lead, rungs = study.lead, {(r.life, r.illumination, r.range_m): r for r in study.rungs}
    assert lead is not None
    worn = _worn(study)
    ranges = study.constraints.ranges_m
    brighter = max(rungs[(worn, "eclipse", r)].energy_j / rungs[("new", "eclipse", r)].energy_j for r in ranges)
    sun = max(rungs[(s, "eclipse", r)].pulse_s / rungs[(s, "sunlit", r)].pulse_s for r in ranges for s in ("new", worn))
    pulses = [r.pulse_s for r in study.rungs]
    fewer = [r for r in ranges if any(x.leds < lead.led_count for x in study.rungs if x.range_m == r)]
    bright = int(np.argmax(study.form.sun_tape.sum(axis=0)[study.form.tapes.index(lead.tape)]))
    return {
        "shortest": seconds_text(study.base.auto_exposure.shortest_s), "fewer": ranges_text(ranges, fewer) if fewer else "",
        "brightest_phase": float(study.form.phases_deg[bright]), "sun_factor": sun, "new_factor": brighter,
        "open_new_well": study.base.auto_exposure.full_well_fraction * brighter, "span": max(pulses) / min(pulses),
    }  # fmt: skip


def _worn(study: Study) -> str:
    """State of the materials that the search was made for."""
    return "worn" if any(r.life == "worn" for r in study.rungs) else "new"


def _sensitivity_facts(study: Study) -> dict[str, Any]:
    tornado, first = study.tornado, study.probabilities[0]
    assert tornado is not None
    facts: dict[str, Any] = {
        "tornado": tornado, "first": first, "best": max(study.probabilities, key=lambda p: p.following),
        "draws": f"{first.draws:,}",
    }  # fmt: skip
    for short, attribute in (("follow", "following"), ("frozen", "frozen")):
        ends = [(getattr(b, attribute), b) for b in tornado.bars]
        failing = [b.name for pair, b in ends if min(pair) < 1]
        alone = f"below 1 it is taken by {listed(failing)} alone" if failing else "no assumption alone takes it below 1"
        facts[short] = max(ends, key=lambda e: abs(np.log(e[0][1] / e[0][0])))[1] if ends else None
        facts[f"fail_{short}"] = alone
    return facts


def as_json(study: Study, confirmed: list[Confirmed]) -> dict[str, Any]:
    """Sets, ladder, sensitivity, probabilities and hardware as plain data."""
    return {
        "headline": headline(study, confirmed), "tried": study.found.tried, "closing": len(study.found.closing),
        "proposed": [asdict(p) for p in study.proposed], "front": [asdict(p) for p in study.found.front],
        "alternatives": [
            {"name": a.name, "closing": len(a.found.closing), "tried": a.found.tried, "lead": asdict(a.lead) if a.lead else None}
            for a in study.alternatives
        ],
        "by_tape": {tape: asdict(p) if p else None for tape, p in study.by_tape.items()},
        "ladder": [asdict(r) for r in study.rungs], "tornado": asdict(study.tornado) if study.tornado else None,
        "probabilities": [asdict(p) for p in study.probabilities], "hardware": [asdict(c) for c in study.hardware],
        "confirmed": [{**asdict(c), "confirmed": c.confirmed} for c in confirmed],
    }  # fmt: skip


def page(study: Study, confirmed: list[Confirmed]) -> str:
    """docs/closure.md."""
    shown = tuple(r for r in study.form.ranges_m if r in (1, 2, 3, 5, 7, 10, 12, 15, 18, 20)) or None
    tables = {
        "proposed": proposed_rows(study, confirmed), "criteria": criteria_rows(study), "ladder": ladder_rows(study, shown),
        "probability": probability_rows(study), "hardware": hardware_rows(study),
        "confirmation": confirmation_rows(confirmed), "alternatives": alternative_rows(study),
    }  # fmt: skip
    text = (
        _environment()
        .from_string(_template("page.md"))
        .render(
            _facts(study, confirmed),
            words=words(study, confirmed),
            tables={name: _markdown(rows) for name, rows in tables.items()},
        )
    )
    # Numbers change the length of lines; paragraphs are filled anew.
    blocks = [
        b if b.startswith(("#", "|", "`", "-", "!")) else fill(b, 130, **_WRAP) for b in text.strip().split("\n\n")
    ]
    return "\n\n".join(blocks) + "\n"


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True)
    environment.filters.update(n=number, p=percent, tape=tape_name)
    return environment


def _template(name: str) -> str:
    return (files("experiments") / "studies" / "close" / name).read_text(encoding="utf-8")


def _markdown(rows: Rows) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])
