"""What the errata study walks through: the thesis's ranges and exposures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

#: Full angle of the beam of figure 6.3 and of the text of section 6.2 [deg].
BEAM_DEG = 16.0


@dataclass(frozen=True)
class Plan:
    """Ranges, exposures, and where the steps from the printed to the full model are taken.

    Attributes:
        ranges_m: ranges [m].
        exposures: label -> full beam angle [deg] and exposure [s], those of the thesis's figures 6.3 and 6.4; 'auto' is each
            model's own.
        step_exposure: the exposure at which the steps are taken, by illumination.
        shown_ranges_m: the ranges of the page's tables, which must be among `ranges_m`.
    """

    ranges_m: tuple[float, ...] = tuple(float(r) for r in range(1, 21))
    exposures: Mapping[str, tuple[float, float | str]] = field(
        default_factory=lambda: MappingProxyType(
            {
                "1/30 s": (BEAM_DEG, 1 / 30),
                "1 ms": (BEAM_DEG, 1e-3),
                **{f"1/{n} s, 8°": (8.0, 1 / n) for n in (50, 100, 150, 200)},
                "auto": (BEAM_DEG, "auto"),
            }
        )
    )
    step_exposure: Mapping[str, str] = field(
        default_factory=lambda: MappingProxyType({"eclipse": "1/30 s", "sunlit": "1 ms", "sun alone": "1 ms"})
    )
    shown_ranges_m: tuple[float, ...] = (1.0, 8.0, 20.0)


FULL = Plan()
#: Nothing here takes long: the closed form is evaluated at twenty ranges.
QUICK = FULL
