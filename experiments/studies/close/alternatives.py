"""The same search around other hardware: sensors, filters and ring radii of the constraints, one at a time and together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from experiments.scenario import Scenario, set_key, validate
from experiments.studies.close.constraints import Constraints
from experiments.studies.close.form import ClosedForm, closed_form
from experiments.studies.close.search import Point, SearchResult, search

#: Criteria that light decides beyond the exposure's own choice of saturation: by these hardware is ranked.
LIGHT_MARGINS = ("cnr", "sun", "glint", "energy", "power", "smear")


@dataclass(frozen=True)
class Alternative:
    """Hardware that the search does not walk through, and what the search found around it.

    Attributes:
        name: what differs from the scenario's, in words.
        changes: how many things differ.
        base: the scenario with that hardware, as new.
    """

    name: str
    changes: int
    base: Scenario
    form: ClosedForm
    found: SearchResult

    @property
    def recommended(self) -> Point | None:
        """The recommended set, with the hardware in its label; None where none closes."""
        proposed = self.found.proposed()
        return replace(proposed[0], hardware=self.name if self.changes else "") if proposed else None

    @property
    def light_margin(self) -> float:
        """Smallest margin of the recommended set that light decides; 0 where none closes."""
        return min(self.recommended.margins[n] for n in LIGHT_MARGINS) if self.recommended else 0.0


def alternatives(constraints: Constraints, base: Scenario) -> tuple[Alternative, ...]:
    """The scenario's own hardware, then one thing changed at a time, then the best sensor, filter and ring together.

    What differs from the scenario's own is searched with the best tape alone.
    """
    own = _searched(constraints, base, {})
    tape = own.recommended.tape if own.recommended else base.target.tape_material
    narrowed = constraints.model_copy(update={"tapes": (tape,)})
    kinds = {"sensor": constraints.sensors, "filter": constraints.filters, "ring_radius_m": constraints.ring_radii_m}
    found, chosen = [own], {}
    for kind, values in kinds.items():
        tried = [_searched(narrowed, base, {kind: value}) for value in values]
        found += tried
        leading = best((own, *tried))
        if leading is not own:
            chosen[kind] = values[tried.index(leading)]
    if len(chosen) > 1:
        found.append(_searched(narrowed, base, chosen))
    return tuple(found)


def _searched(constraints: Constraints, base: Scenario, changes: dict[str, Any]) -> Alternative:
    words = {"sensor": "sensor {}", "filter": "filter {}", "ring_radius_m": "ring of {:g} cm"}
    names = [words[kind].format(100 * v if kind == "ring_radius_m" else v) for kind, v in changes.items()]
    changed = _with(base, changes)
    form = closed_form(changed, constraints, constraints.end_of_life)
    name = ", ".join(names) or "the scenario's own"
    return Alternative(name, len(changes), changed, form, search(form, constraints))


def best(found: tuple[Alternative, ...]) -> Alternative:
    """The hardware whose recommended set has the largest margin that light decides; the fewest changes among equals."""
    return max(found, key=lambda a: (round(a.light_margin, 3), -a.changes))


def _with(base: Scenario, changes: dict[str, Any]) -> Scenario:
    data = base.model_dump()
    if "sensor" in changes:
        set_key(data, "sensor.preset", changes["sensor"])
    if "filter" in changes:
        data["filter"] = {"preset": changes["filter"]}
    if "ring_radius_m" in changes:
        data["leds"]["ring_radius_m"] = changes["ring_radius_m"]
    changed = validate(data)
    if "sensor" not in changes:
        return changed
    # The lens's point spread stays as wide in micrometres, whatever the pixel.
    scale = (base.camera.pixel_area_m2 / changed.camera.pixel_area_m2) ** 0.5
    return changed.at(camera={**changed.camera.model_dump(), "psf_sigma_px": base.camera.psf_sigma_px * scale})
