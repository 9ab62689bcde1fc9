"""Numbers, factors and ranges in words, the same in terminal, report and figures."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

ILLUMINATION_NAMES = {"eclipse": "eclipse", "sunlit": "sunlight"}


def number(value: float) -> str:
    """Three significant digits, grouped from a thousand on: '0.525', '36.9', '31,700', '2.2×10⁸'; '–' for NaN."""
    if np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞"
    rounded = float(f"{value:.3g}")
    if rounded and not 1e-4 <= abs(rounded) < 1e6:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}×10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    return f"{rounded:,.0f}" if abs(rounded) >= 1000 else f"{rounded:.3g}"


def percent(value: float) -> str:
    """A share as a percentage, '69 %'."""
    return "–" if np.isnan(value) else f"{number(100 * value)}\N{NO-BREAK SPACE}%"


def factor(value: float) -> str:
    """A factor above one, never rounded to one: '×1.05', '×1.9', '×45,000'."""
    if value < 1.1:
        return f"×{1 + float(f'{value - 1:.1g}'):.10g}"
    return f"×{number(float(f'{value:.2g}'))}"


def listed(parts: Sequence[str]) -> str:
    """'a, b and c'."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def ranges_text(grid_m: Sequence[float], chosen_m: Collection[float]) -> str:
    """Some ranges of a grid, neighbours joined: '1–8 and 10 m'; 'no range' for none."""
    runs: list[list[float]] = []
    previous = False
    for range_m in grid_m:
        chosen = range_m in chosen_m
        if chosen and previous:
            runs[-1].append(range_m)
        elif chosen:
            runs.append([range_m])
        previous = chosen
    if not runs:
        return "no range"
    parts = [f"{run[0]:g}" if len(run) == 1 else f"{run[0]:g}–{run[-1]:g}" for run in runs]
    return f"{listed(parts)}\N{NO-BREAK SPACE}m"


def seconds_text(seconds: float) -> str:
    """'1.52 µs'."""
    if np.isinf(seconds):
        return "any time"
    scale, unit = next(((s, u) for s, u in ((1, "s"), (1e-3, "ms"), (1e-6, "µs")) if seconds >= s), (1e-9, "ns"))
    return f"{number(seconds / scale)}\N{NO-BREAK SPACE}{unit}"
