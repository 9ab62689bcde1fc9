"""The thesis's printed model gives the thesis's printed figures, errors included.

The tables are those of an independent run of listing A.5; each figure must agree to half a unit of its last digit.
"""

from __future__ import annotations

import numpy as np
import pytest

from radiometry.thesis import PrintedModel


def agrees(value: float, printed: str) -> bool:
    decimals = len(printed.split(".")[1]) if "." in printed else 0
    return bool(abs(value - float(printed)) <= 0.5 * 10.0**-decimals * (1 + 1e-9))


def test_the_array_is_printed_as_40_kw_per_sr() -> None:
    assert agrees(PrintedModel().intensity_w_sr / 1000, "40.2")
    assert agrees(PrintedModel().intensity_w_sr, "40247")
    assert agrees(PrintedModel(light_cone_deg=8).intensity_w_sr, "159443")


@pytest.mark.parametrize(
    ("range_m", "signal", "noise", "snr"),
    [
        (1, "17641", "161", "109.6"),
        (5, "17472", "160", "108.9"),
        (6, "17470", "160", "108.9"),
        (8, "17468", "160", "108.9"),
        (10, "17467", "160", "108.9"),
        (15, "17466", "160", "108.9"),
        (20, "17466", "160", "108.9"),
    ],
)
def test_in_the_sun_at_one_millisecond(range_m: float, signal: str, noise: str, snr: str) -> None:
    model = PrintedModel()
    electrons = float(model.signal_e(range_m, 1e-3, sun=True))
    assert agrees(electrons, signal)
    assert agrees(float(model.noise_e(electrons)), noise)
    assert agrees(float(model.snr(range_m, 1e-3, sun=True)), snr)


@pytest.mark.parametrize(
    ("range_m", "signal", "noise", "snr"),
    [
        (1, "5858", "104.7", "55.9"),
        (5, "234", "43.5", "5.39"),
        (6, "163", "41.0", "3.97"),
        (7, "120", "39.1", "3.05"),
        (8, "91.5", "37.8", "2.42"),
        (9, "72.3", "36.7", "1.97"),
        (10, "58.6", "35.9", "1.63"),
        (15, "26.0", "33.3", "0.78"),
        (20, "14.6", "32.0", "0.46"),
    ],
)
def test_in_eclipse_at_a_thirtieth_of_a_second(range_m: float, signal: str, noise: str, snr: str) -> None:
    model = PrintedModel()
    electrons = float(model.signal_e(range_m, 1 / 30, sun=False))
    assert agrees(electrons, signal)
    assert agrees(float(model.noise_e(electrons)), noise)
    assert agrees(float(model.snr(range_m, 1 / 30, sun=False)), snr)


@pytest.mark.parametrize(
    ("exposures_per_s", "printed"),
    [
        (50, "95.2 10.8 8.08 6.31 5.07 4.16 3.48 1.72 1.02"),
        (100, "62.4 6.20 4.59 3.54 2.82 2.29 1.91 0.92 0.54"),
        (150, "48.2 4.44 3.26 2.50 1.98 1.60 1.33 0.63 0.37"),
        (200, "39.9 3.48 2.54 1.94 1.53 1.24 1.02 0.48 0.28"),
    ],
)
def test_in_eclipse_with_a_beam_of_8_deg(exposures_per_s: int, printed: str) -> None:
    ratio = PrintedModel(light_cone_deg=8).snr([1, 5, 6, 7, 8, 9, 10, 15, 20], 1 / exposures_per_s, sun=False)
    assert all(agrees(value, figure) for value, figure in zip(ratio, printed.split(), strict=True)), ratio


def test_a_threshold_of_two_ends_at_8_m_and_one_of_one_at_13_m() -> None:
    ranges = np.arange(1, 21, 0.1)
    ratio = PrintedModel().snr(ranges, 1 / 30, sun=False)
    assert ranges[ratio >= 2][-1] == pytest.approx(8.9, abs=0.051)
    assert ranges[ratio >= 1][-1] == pytest.approx(13.1, abs=0.051)
