"""The failure modes of thesis section 8.3 as columns that the studies' tables share: how often each comes, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray

#: Headings of the counts, by name of the mode.
MODES = {
    "loss_of_aruco": "1 loss of ArUco",
    "false_positive": "2 false positive",
    "loss_of_elements": "3 loss of elements",
    "wrong_corners": "4 wrong corners",
    "no_blob": "5 no blob",
}
#: Modes whose frames still have a pose.
POSED = ("loss_of_elements", "wrong_corners", "no_blob")
#: Headings of the median errors: without any failure, then with each of `POSED`.
ATTITUDE, RANGE = (
    {"": f"{what} without any {unit}", **{name: f"{what} with {MODES[name][0]} {unit}" for name in POSED}}
    for what, unit in (("attitude error", "[°]"), ("range error", "[%]"))
)
HEADINGS = (*MODES.values(), *ATTITUDE.values(), *RANGE.values())


def cells(
    failed: Mapping[str, NDArray[np.bool_] | None], attitude_deg: FloatArray, range_error: FloatArray
) -> tuple[str, ...]:
    """Texts under `HEADINGS`: frames with each mode, and median errors of frames with none, and with each.

    Args:
        failed: by name of the mode, which frames have it; None where a method cannot have it, told as '–'.
        attitude_deg: attitude error of the same frames, NaN without a pose.
        range_error: range error over range, of either sign, likewise.
    """
    known = {name: which for name, which in failed.items() if which is not None}
    counts = [str(int(known[name].sum())) if name in known else "–" for name in MODES]
    any_of = np.any(list(known.values()), axis=0)
    chosen = (~any_of, *(known.get(name, np.zeros_like(any_of)) for name in POSED))
    errors = [_median(error[which]) for error in (attitude_deg, 100 * np.abs(range_error)) for which in chosen]
    return (*counts, *("–" if np.isnan(e) else f"{e:.3g}" for e in errors))


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
