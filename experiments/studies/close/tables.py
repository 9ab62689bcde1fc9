"""Rows of the closure page's tables, headings first, and of its data files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from experiments.reporting.formatting import listed, number, percent, ranges_text, seconds_text
from experiments.studies.close.confirm import Confirmed
from experiments.studies.close.facts import searched_life
from experiments.studies.close.hardware import Change
from experiments.studies.close.search import CRITERIA_TEXT
from experiments.studies.close.sensitivity import Probability
from experiments.studies.close.study import ClosureResult

Rows = list[tuple[str, ...]]

PROPOSED_HEADINGS = (
    "marker",
    "lens",
    "pupil",
    "LEDs (fewest)",
    "a pulse",
    "mean",
    "peak",
    "smallest margin",
    "binds",
    "rendered",
)


def proposed_rows(result: ClosureResult) -> Rows:
    """The proposed sets, the recommended one first."""
    rows: Rows = [PROPOSED_HEADINGS]
    confirmed = {c.label: c for c in result.confirmed}
    for p in result.proposed:
        seen = confirmed.get(p.label)
        verdict = "–" if seen is None else f"{'✓' if seen.confirmed else '✗'} {seen.closing} of {seen.cases} cases"
        rows.append(
            (
                f"{100 * p.size_m:g} cm",
                f"{1e3 * p.focal_length_m:.4g} mm F/{p.f_number:.3g}",
                f"{1e3 * p.focal_length_m / p.f_number:.2g} mm",
                f"{p.led_count} ({p.fewest_leds})",
                f"{number(1e3 * p.energy_j)} mJ",
                f"{number(1e3 * p.power_w)} mW",
                f"{number(p.peak_power_w)} W",
                f"{p.margin:.3f}",
                f"{p.binding[0]} at {p.binding[1]:g} m",
                verdict,
            )
        )
    return rows


def criteria_rows(result: ClosureResult) -> Rows:
    """Every criterion of the recommended set with its margin."""
    assert result.recommended is not None
    c, r = result.constraints, result.base.requirement
    limits = {
        "saturation": f"≤ {r.full_well_fraction_max:g} full well",
        "cnr": f"≥ {r.cnr_min:g}",
        "sampling": f"≥ {r.px_per_bit_min:g} px/bit at {c.tilt_deg:g}° tilt",
        "smear": f"≤ {r.smear_px_max:g} px",
        "frame": f"≤ {c.frame_share_max:g} of the shorter side",
        "focus": f"≤ {c.blur_bits_max:g} bit",
        "sun": f"≥ {c.led_over_sun_min:g}",
        "glint": f"≤ {c.glint_over_well_max:g}",
        "energy": f"≤ {c.energy_per_frame_j:g} J",
        "power": f"≤ {c.average_power_w:g} W",
    }
    body = [(n, CRITERIA_TEXT[n], limits[n], number(m)) for n, m in result.recommended.margins.items()]
    return [("criterion", "is about", "limit", "margin"), *body]


def schedule_rows(result: ClosureResult) -> Rows:
    """Pulse and energy at each range, in eclipse and Sun, new and worn."""
    rows: Rows = [("range", "LEDs", "eclipse, worn", "Sun, worn", "eclipse, new", "Sun, new", "a pulse, eclipse, worn")]
    for range_m in result.form.ranges_m:
        here = {(e.life, e.illumination): e for e in result.schedule if e.range_m == range_m}
        lives = (searched_life(result), "new")
        exposures = [here[life, illumination] for life in lives for illumination in ("eclipse", "sunlit")]
        counts = sorted({e.leds for e in exposures})
        leds = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]}–{counts[-1]}"
        pulses = [seconds_text(e.pulse_s) for e in exposures]
        rows.append((f"{range_m:g} m", leds, *pulses, f"{number(1e3 * exposures[0].energy_j)} mJ"))
    return rows


def tornado_rows(result: ClosureResult) -> Rows:
    """Smallest margins at both ends of every assumption."""
    assert result.tornado is not None
    rows: Rows = [("assumption", "factor", "margin, exposure follows", "margin, exposure set beforehand", "source")]
    sources = {u.name: u.source for u in result.constraints.uncertainties}
    for bar in result.tornado.bars:
        ends = [f"{number(pair[0])} to {number(pair[1])}" for pair in (bar.following, bar.fixed)]
        rows.append((bar.name, f"×{bar.low:.3g} to ×{bar.high:.3g}", *ends, sources[bar.name]))
    return rows


def probability_rows(result: ClosureResult) -> Rows:
    """Probability of closure of every variant, and what fails."""
    rows: Rows = [
        ("hardware", "closes, exposure follows", "closes, exposure set beforehand", "fails most, exposure follows")
    ]
    for p in result.probabilities:
        rows.append((p.label, _share(p.following, p.following_ci95), _share(p.fixed, p.fixed_ci95), _worst(p)))
    return rows


def _share(share: float, ends: tuple[float, float]) -> str:
    return f"{100 * share:.1f} % ({100 * ends[0]:.1f}–{100 * ends[1]:.1f})"


def _worst(p: Probability) -> str:
    failing = sorted(((s[0], n) for n, s in p.failing.items() if s[0] > 0), reverse=True)[:2]
    return listed([f"{name} ({100 * share:.1f} %)" for share, name in failing]) if failing else "nothing"


def alternative_rows(result: ClosureResult) -> Rows:
    """The search around other hardware: the scenario's own, one thing changed, and the best of each kind together."""
    rows: Rows = [("hardware", "sets that close", "recommended", "mean", "margin of light", "smallest margin, binds")]
    for a in result.alternatives:
        name = f"{a.name} (best)" if a is result.best else a.name
        count = f"{len(a.found.closing):,} of {a.found.tried:,}"
        if a.recommended is None:
            rows.append((name, count, "–", "–", "–", "–"))
            continue
        p = replace(a.recommended, hardware="")
        binds = f"{p.margin:.3f}, {p.binding[0]} at {p.binding[1]:g} m"
        rows.append((name, count, p.label, f"{number(1e3 * p.power_w)} mW", number(a.light_margin), binds))
    return rows


def hardware_rows(result: ClosureResult) -> Rows:
    """The thesis's hardware as it was operated and with one change at a time."""
    rows: Rows = [("hardware", "change", "closes at", "fails, by the factor missed", "allowed")]
    for c in result.hardware:
        change = "none" if c.factor == 1 else f"×{c.factor:.2f}"
        rows.append((c.name, change, closing_ranges(c), misses(c), "yes" if c.allowed else "no"))
    return rows


def closing_ranges(change: Change) -> str:
    """'1–9 m', 'every range' or 'no range'."""
    return "every range" if change.closes else ranges_text(change.ranges_m, change.closing_m)


def misses(change: Change) -> str:
    """'sampling ×2.07, smear ×8.07': criteria that fail and the factor by which they are missed."""
    return ", ".join(f"{n} ×{number(1 / m)}" for n, m in change.failing.items()) or "nothing"


def confirmation_rows(confirmed: list[Confirmed]) -> Rows:
    """What the frames say of every set."""
    rows: Rows = [
        ("set", "cases that close", "frames with the marker", "attitude", "range", "CNR, least", "signal, form")
    ]
    for c in confirmed:
        rows.append(
            (
                c.label,
                f"{c.closing} of {c.cases}",
                f"{c.found} of {c.frames} (> {100 * c.found_low:.1f} %)",
                f"{number(c.attitude_deg)}°",
                percent(c.range_error),
                number(c.cnr),
                f"within {100 * max(c.signal_difference, 1e-4):.2f} %",
            )
        )
    return rows


def data_columns(result: ClosureResult) -> dict[str, dict[str, list[Any]]]:
    """Columns of the data files: every closing set, the exposures of the recommended one, and the rendered cases."""
    front, proposed = set(map(id, result.found.front)), set(map(id, result.proposed))
    sets = (
        {
            "tape": p.tape,
            "size_m": p.size_m,
            "focal_length_m": p.focal_length_m,
            "f_number": p.f_number,
            "leds": p.led_count,
            "power_w": p.power_w,
            "energy_j": p.energy_j,
            "on_front": id(p) in front,
            "proposed": id(p) in proposed,
            **{f"margin_{name}": p.margins[name] for name in CRITERIA_TEXT},
        }
        for p in result.found.closing
    )
    exposures = (
        {
            "range_m": e.range_m,
            "illumination": e.illumination,
            "life": e.life,
            "leds": e.leds,
            "pulse_s": e.pulse_s,
            "energy_j": e.energy_j,
        }
        for e in result.schedule
    )
    parts = {"sets": _columns(sets), "exposures": _columns(exposures), "confirmation": _columns(result.records)}
    return {name: columns for name, columns in parts.items() if columns}


def _columns(records: Iterable[dict[str, Any]]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {}
    for record in records:
        for key, value in record.items():
            columns.setdefault(key, []).append(value)
    return columns
