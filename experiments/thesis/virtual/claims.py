"""What thesis section 8.1 states, beside what its pipeline and this project's give on the same frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from experiments.reporting.formatting import number
from experiments.thesis.claims import Claim
from experiments.thesis.virtual.summary import FRONTAL_DEG, find, outliers

NAN = float("nan")


def claims(summary: xr.Dataset, frames: xr.Dataset) -> list[Claim]:
    """What section 8.1 states, beside the thesis's pipeline and this project's on the same frames; without what was not run."""
    said = (
        *_against_aruco(summary, frames),
        *_failures(summary, frames),
        *_misplaced(summary, frames),
        *_combined(summary),
    )
    return [s for s in said if not (np.isnan(s.reproduced) and np.isnan(s.right))]


def _value(summary: xr.Dataset, statistic: str, method: str, test: int) -> float:
    here = find(summary, method, test=test)
    return NAN if here is None else float(here[statistic])


def _ratio(summary: xr.Dataset, statistic: str, own: tuple[str, int], other: tuple[str, int]) -> float:
    return _value(summary, statistic, *own) / _value(summary, statistic, *other)


def _agrees(holds: bool) -> str:
    return "agrees" if holds else "disagrees"


def _against_aruco(summary: xr.Dataset, frames: xr.Dataset) -> Iterator[Claim]:
    """Figures 8.2 to 8.5."""

    def ratio(statistic: str, flat_over_mantis: bool) -> tuple[float, float]:
        sign = 1 if flat_over_mantis else -1
        printed = _ratio(summary, statistic, ("aruco_thesis", 2), ("thesis", 1)) ** sign
        return printed, _ratio(summary, statistic, ("aruco", 2), ("mantis", 1)) ** sign

    def beyond(method: str) -> float:
        here = find(frames, method, test=1)
        return NAN if here is None else 100 * float(here.found.where(here.pitch_deg > 38).mean())

    def largest(method: str, test: int) -> float:
        here = find(frames, method, test=test)
        return NAN if here is None else 1e3 * float(np.abs(here.range_error_m).max())

    found = ratio("pitch_rms_deg", True)
    yield Claim(
        "fig. 8.2",
        "pitch rms at 3.3 m, ArUco over Mantis",
        "1",
        "≫ 1",
        *found,
        remark=(
            f"{_agrees(found[0] > 3)}; corners fitted as well as Mantis's, and both minima tried, make a flat square flip less"
        ),
    )
    found = ratio("pitch_frontal_rms_deg", True)
    yield Claim(
        "fig. 8.2",
        "the same within 10° of frontal",
        "1",
        "≫ 1",
        *found,
        remark=f"{_agrees(found[0] > 3)}: frontal, a flat square's attitude changes its image in second order only",
    )
    yield Claim(
        "fig. 8.2",
        "found beyond +38° at 3.3 m",
        "%",
        "0",
        beyond("thesis"),
        beyond("mantis"),
        remark=f"{_agrees(beyond('thesis') < 50)}: OpenCV's decoder ends where bits are below 3 px high",
    )
    found = ratio("range_inlier_rms_m", False)
    yield Claim(
        "fig. 8.3",
        "range rms without outliers at 3.3 m, Mantis over ArUco",
        "1",
        "> 1",
        *found,
        remark=f"{_agrees(found[0] > 1)}: the ArUco inside has half the side",
    )
    yield Claim(
        "fig. 8.4",
        "outliers of test 3 (Mantis, 2.3 m)",
        "frames",
        "a few",
        _value(summary, "outliers", "thesis", 3),
        _value(summary, "outliers", "mantis", 3),
        remark="the thesis's pipeline falls back to four corners and one start where it has no virtual point",
    )
    yield Claim(
        "fig. 8.4",
        "outliers of test 4 (ArUco, 2.3 m)",
        "frames",
        "many",
        _value(summary, "outliers", "aruco_thesis", 4),
        _value(summary, "outliers", "aruco", 4),
        remark=f"{_value(summary, 'outliers', 'aruco_opencv', 4):.0f} with OpenCV's corners and both IPPE poses",
    )
    flat = largest("aruco_thesis", 4)
    yield Claim(
        "fig. 8.5",
        "largest range error at 2.3 m, Mantis over ArUco",
        "1",
        "> 1",
        largest("thesis", 3) / flat,
        largest("mantis", 3) / largest("aruco", 4),
        remark=(
            f"{_agrees(largest('thesis', 3) > flat)}: today's iterative solver often stays at frontal on a flat square; the "
            f"range then is off by up to {number(flat)} mm; the thesis's OpenCV went to the mirrored pose, whose range is right"
        ),
    )


def _failures(summary: xr.Dataset, frames: xr.Dataset) -> Iterator[Claim]:
    """Section 8.3 where it speaks of these tests."""

    def wrong(method: str, test: int) -> float:
        here = find(frames, method, test=test)
        near = None if here is None else here.wrong_corners.where(np.abs(here.pitch_deg) <= FRONTAL_DEG)
        return NAN if near is None else 100 * float(near.mean())

    listed = _value(summary, "wrong_corners", "thesis", 5)
    for test, ring, printed in ((5, "narrow", "many"), (9, "wide", "none")):
        share = wrong("inner_aruco", test)
        remark = f"{_agrees((share > 5) == (test == 5))}, with corners refined in a window (cornerSubPix); "
        remark += (
            f"with AprilTag's, as in the listing, {number(listed)} frames in all: today's OpenCV differs from the thesis's"
            if test == 5
            else "the wider ring keeps the second corner out of the window"
        )
        yield Claim(
            "sec. 8.3",
            f"wrong corners within 10° of frontal, test {test} ({ring} ring)",
            "%",
            printed,
            share,
            wrong("mantis", test),
            remark=remark,
        )
    narrow, wide = (_value(summary, "pitch_rms_deg", "inner_aruco", test) for test in (5, 9))
    yield Claim(
        "sec. 8.1",
        "pitch rms at 1.3 m, test 5 over test 9",
        "1",
        "≫ 1",
        narrow / wide,
        _ratio(summary, "pitch_rms_deg", ("mantis", 5), ("mantis", 9)),
        remark=(
            f"{_agrees(narrow > 3 * wide)}, with the window: besides wrong corners it pulls the others by some 0.7 px. A fit of "
            "the whole pattern knows the ring"
        ),
    )
    for test in (5, 9):
        count = _value(summary, "frames", "thesis", test)
        yield Claim(
            "sec. 8.3",
            f"frames without a virtual point, test {test}",
            "%",
            "below 1 in 40",
            100 * _value(summary, "loss_of_elements", "thesis", test) / count,
            100 * _value(summary, "loss_of_elements", "mantis", test) / count,
            remark=(
                "beyond some 30° the blobs fall below the smallest area that the thesis asks for; its elements' round profile, "
                "which is not modelled here, widened them there"
            ),
        )


def _misplaced(summary: xr.Dataset, frames: xr.Dataset) -> Iterator[Claim]:
    """Figures 8.7 and 8.8: the element that stood a millimetre off."""

    def bias(target: str, method: str, low: float, high: float) -> float:
        here = find(frames, method, target=target)
        if here is None:
            return NAN
        within = (here.pitch_deg >= low) & (here.pitch_deg <= high) & ~outliers(here)
        return float(here.pitch_error_deg.where(within).mean())

    off = find(summary, "thesis", target="misplaced")
    shifted = "" if off is None else f"; with the left element 1 mm off {number(1e3 * float(off.range_bias_m))} mm"
    bias_mm = 1e3 * _value(summary, "range_bias_m", "thesis", 9)
    yield Claim(
        "fig. 8.8",
        "range bias of test 9 (Mantis, 1.3 m)",
        "mm",
        "45",
        bias_mm,
        1e3 * _value(summary, "range_bias_m", "mantis", 9),
        remark=(
            f"{_agrees(abs(bias_mm - 45) < 10)}{shifted}. The thesis has as much at 3.3 m: no error of scale, be it focal length "
            "or size, but likely of the distance that was taken for true. The text does not settle it"
        ),
    )
    for part, low, high, printed in (
        ("it serves", -10.0, 30.0, "visible"),
        ("the right one does", -40.0, -28.0, "none"),
    ):
        found = bias("misplaced", "thesis", low, high)
        yield Claim(
            "fig. 8.7",
            f"pitch bias with the left element 1 mm off, where {part}",
            "°",
            printed,
            found,
            bias("calibrated", "mantis", low, high),
            remark=(
                f"{_agrees((abs(found) > 1) == (printed == 'visible'))}; right: calibrated from nine images; before, "
                f"{bias('misplaced', 'mantis', low, high):+.2f}°. 1 mm over the virtual depth of a 25 mm marker, 6.2 mm, is 9.1°"
            ),
        )


def _combined(summary: xr.Dataset) -> Iterator[Claim]:
    """Figures 8.9 and 8.10: pitch and yaw alike."""

    def ratio(statistic: str, methods: tuple[str, str], tests: tuple[int, int]) -> tuple[float, float]:
        one, other = (_ratio(summary, statistic, (m, tests[0]), (m, tests[1])) for m in methods)
        return one, other

    own, flat = ("thesis", "mantis"), ("aruco_thesis", "aruco")
    yield Claim(
        "fig. 8.9",
        "pitch rms without outliers, test 7 over test 3 (Mantis)",
        "1",
        "1",
        *ratio("pitch_inlier_rms_deg", own, (7, 3)),
        remark="angles to ±35° there, to ±45° in test 3",
    )
    found = ratio("pitch_rms_deg", flat, (8, 4))
    yield Claim(
        "fig. 8.9",
        "pitch rms, test 8 over test 4 (ArUco)",
        "1",
        "< 1",
        *found,
        remark=f"{_agrees(found[0] < 1)}: a combined tilt is larger, and shows more perspective",
    )
    for methods, tests, what in (
        (own, (7, 3), "test 7 over test 3 (Mantis)"),
        (flat, (8, 4), "test 8 over test 4 (ArUco)"),
    ):
        found = ratio("range_inlier_rms_m", methods, tests)
        own_too = "worse too" if found[1] > 1.1 else "as good"
        yield Claim(
            "fig. 8.10",
            f"range rms without outliers, {what}",
            "1",
            "> 1",
            *found,
            remark=f"{_agrees(found[0] > 1)}; by this project's corners and solver {own_too}",
        )
