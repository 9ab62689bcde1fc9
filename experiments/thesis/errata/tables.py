"""Tables of the errata page: the steps, what each of them changes, and the three models case by case."""

from __future__ import annotations

import numpy as np

from experiments.reporting.blocks import Cell, Table, text_table
from experiments.reporting.formatting import seconds_text
from experiments.thesis.errata.study import ErrataResult
from radiometry.corrections import CORRECTIONS

#: Cases of the table of models: illumination and label of the exposure.
_CASES = (
    ("eclipse", "1/30 s"),
    ("eclipse", "1/50 s, 8°"),
    ("eclipse", "1/200 s, 8°"),
    ("eclipse", "auto"),
    ("sunlit", "1 ms"),
    ("sunlit", "auto"),
    ("sun alone", "1 ms"),
)


def digits(value: float) -> str:
    """Exactly three significant digits: '0.0193', '0.250', '91.5', '17 500', '3.47×10⁶'."""
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        rounded = float(f"{value:.3g}")
        text = f"{rounded:.{max(0, 2 - int(np.floor(np.log10(abs(rounded)))))}f}" if rounded else "0"
        return text if rounded < 1e4 else whole(rounded)
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}×10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def whole(value: float) -> str:
    """A whole number, grouped from ten thousand on: '3140', '40 247'."""
    return f"{value:.0f}" if abs(value) < 1e4 else f"{value:,.0f}".replace(",", "\N{NO-BREAK SPACE}")


def _factor(value: float) -> str:
    if value == 1 or abs(value - 1) < 5e-5:
        return "×1"
    return f"×{value:.4f}" if abs(value - 1) < 0.1 else f"×{digits(value)}"


def steps_table(result: ErrataResult) -> Table:
    """Factors of each step on signal and SNR, in eclipse (1/30 s) and of the Sun alone (1 ms)."""
    cases = [(illumination, range_m) for illumination in ("eclipse", "sun alone") for range_m in (8.0, 20.0)]
    values = [result.dataset.sel(illumination=illumination, range_m=range_m) for illumination, range_m in cases]

    def state(name: str, k: int) -> list[str]:
        return [name, *(digits(float(v[variable][k])) for v in values for variable in ("step_signal", "step_snr"))]

    rows = [["step", *(f"{illumination}, {r:g} m: {q}" for illumination, r in cases for q in ("S", "SNR"))]]
    rows.append(state("as printed", 0))
    for k, step in enumerate(result.steps, 1):
        factors = [_factor(float(v[variable][k])) for v in values for variable in ("signal_factor", "snr_factor")]
        rows.append([step.name, *factors])
        if k == len(CORRECTIONS):
            rows.append(state("corrected", k))
    rows.append(state("full model", -1))
    return text_table(rows, "Factor of each step", compact=True, terminal=True)


def sources_table(result: ErrataResult) -> Table:
    """What the thesis prints, what is right, and the source, step by step."""
    rows = [(step.name, step.where, step.printed, step.right, step.source) for step in result.steps]
    return text_table([("step", "where", "printed", "right", "source"), *rows], "What each step changes")


def steps_file(result: ErrataResult) -> Table:
    """Signal and SNR after each step, by illumination and at some ranges, with six significant digits."""
    headings = ("step", "illumination", "range_m", "signal_e", "snr", "signal_factor", "snr_factor")
    rows = []
    for illumination in result.dataset.illumination.values:
        for range_m in result.plan.shown_ranges_m:
            for step in result.dataset.step.values:
                at = result.dataset.sel(step=step, illumination=illumination, range_m=range_m)
                values = (at.step_signal, at.step_snr, at.signal_factor, at.snr_factor)
                numbers = (f"{float(value):.6g}" for value in values)
                texts = (str(step), str(illumination), f"{range_m:g}", *numbers)
                rows.append(tuple(Cell(text, style="left" if k < 2 else "") for k, text in enumerate(texts)))
    return Table(headings, tuple(rows), "Signal and SNR after each step", compact=True, key="", inline=False)


def models_table(result: ErrataResult) -> Table:
    """Signal [e⁻] and SNR of the three models, CNR and well filling of the full one, by case and range."""
    values = (
        "S printed",
        "S corrected",
        "S full",
        "SNR printed",
        "SNR corrected",
        "SNR full",
        "CNR full",
        "S full/well",
    )
    rows: list[tuple[str, ...]] = [("case", "exposure", "range", *values)]
    for illumination, exposure in _CASES:
        for range_m in result.plan.shown_ranges_m:
            at = result.dataset.sel(illumination=illumination, exposure=exposure, range_m=range_m)
            full = at.sel(model="full")
            label = f"auto, {seconds_text(float(full.exposure_s))}" if exposure == "auto" else exposure
            numbers = [*at.signal.values, *at.snr.values, full.cnr, full.full_well_fraction]
            rows.append((illumination, label, f"{range_m:g} m", *(digits(float(v)) for v in numbers)))
    return text_table(rows, "Case by case", compact=True, terminal=True)
