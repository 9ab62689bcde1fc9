"""How far the thesis's own hardware closes, and the smallest change that takes it to every range."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from experiments.scenario import Scenario
from experiments.studies.close.constraints import Constraints
from experiments.studies.close.form import ClosedForm, Sets, closed_form
from experiments.studies.close.search import ExposureSchedule, Point, margins, operate, points

#: The thesis's exposures (section 6.2) in eclipse and in sunlight [s].
THESIS_EXPOSURE_S = (1 / 30, 1e-3)


@dataclass(frozen=True)
class Change:
    """A piece of hardware and how far it closes.

    Attributes:
        factor: by which one parameter was changed; 1 for none.
        allowed: whether the constraints allow it.
        point: the set, where a search's constraints can express it.
        closing_m, ranges_m: ranges at which all criteria are met, of those judged.
        failing: criteria that fail, with the smallest margin of each.
        reach_m: farthest range that the sampling criterion allows.
    """

    name: str
    factor: float = 1.0
    allowed: bool = True
    point: Point | None = None
    closing_m: tuple[float, ...] = ()
    ranges_m: tuple[float, ...] = ()
    failing: dict[str, float] = field(default_factory=dict)
    reach_m: float = 0.0

    @property
    def closes(self) -> bool:
        """True where every range closes."""
        return len(self.closing_m) == len(self.ranges_m)

    def judged(
        self, form: ClosedForm, sets: Sets, constraints: Constraints, schedule: ExposureSchedule | None = None
    ) -> Change:
        """The change with what the criteria say of its one set; without a schedule the exposure follows the light."""
        found = margins(form, sets, constraints, operate(form, sets, constraints, schedule))
        least = {n: np.broadcast_to(m, (1, *m.shape[1:])).min(axis=(0, 1)) for n, m in found.items()}
        met = np.min(list(np.broadcast_arrays(*least.values())), axis=0) >= 1
        ranges = tuple(float(r) for r in form.ranges_m)
        return replace(
            self,
            closing_m=tuple(r for r, closes in zip(ranges, met, strict=True) if closes),
            ranges_m=ranges,
            failing={n: float(m.min()) for n, m in least.items() if m.min() < 1},
            reach_m=float(form.ranges_m[-1] * found["sampling"][..., -1].min()),
        )


def hardware_changes(constraints: Constraints, base: Scenario) -> tuple[tuple[Change, ...], Change | None]:
    """The base scenario's own hardware with the thesis's exposures, with one that follows the light, then changed in one thing.

    Returns:
        The pieces of hardware, and the smallest allowed change that closes every range; None where none does.
    """
    tape, size, camera = base.target.tape_material, base.marker.size_m, base.camera
    form = closed_form(base, constraints, constraints.end_of_life, (tape,), (size,))
    own = Sets(
        tape=np.array([0]),
        size=np.array([0]),
        focal_length_m=np.array([camera.focal_length_m]),
        f_number=np.array([camera.f_number]),
        led_count=np.array([base.leds.count]),
    )
    eclipse, sun = THESIS_EXPOSURE_S
    shape = (1 + len(form.phases_deg), len(form.ranges_m))
    thesis = ExposureSchedule(
        np.full(shape, float(base.leds.count)),
        np.where(np.arange(shape[0])[:, None] == 0, eclipse, sun) + np.zeros(shape),
    )
    fixed = Change("as the thesis exposes it, 1/30 s and 1 ms").judged(form, own, constraints, thesis)
    following = Change("exposure that follows the light").judged(form, own, constraints)
    k = float(np.ceil(100 * form.ranges_m[-1] / following.reach_m - 1e-9) / 100)
    changes = [fixed, following]
    if k > 1:
        longer = replace(own, focal_length_m=own.focal_length_m * k)
        stopped = replace(longer, f_number=longer.f_number * k)
        end = constraints.end_of_life
        wide = closed_form(base, constraints, end, (tape,), (size * k,))
        finer = closed_form(_finer(base, k), constraints, end, (tape,), (size,))
        allowed = size * k <= constraints.marker_over_face_max * base.target.face_m * (1 + 1e-9)
        [point] = points(form, stopped, constraints)
        focal_mm, pitch_um = 1e3 * camera.focal_length_m * k, 1e6 * camera.pixel_pitch_x_m / k
        changes += [
            Change(f"lens of {focal_mm:.1f} mm, same F-number", k).judged(form, longer, constraints),
            Change(f"lens of {focal_mm:.1f} mm, same pupil", k, point=point).judged(form, stopped, constraints),
            Change(f"marker of {100 * size * k:.1f} cm", k, allowed).judged(wide, own, constraints),
            Change(f"pixels of {pitch_um:.1f} µm, same detector area and lens", k).judged(finer, own, constraints),
        ]
    closing = [c for c in changes if c.closes and c.allowed]
    return tuple(changes), min(closing, key=lambda c: c.factor, default=None)


def _finer(base: Scenario, k: float) -> Scenario:
    """The base scenario with pixels k times finer on the same area; the lens's point spread stays as wide in micrometres."""
    camera = base.camera
    finer = {
        "width_px": round(camera.width_px * k),
        "height_px": round(camera.height_px * k),
        "pixel_pitch_x_m": camera.pixel_pitch_x_m / k,
        "pixel_pitch_y_m": camera.pixel_pitch_y_m / k,
        "psf_sigma_px": camera.psf_sigma_px * k,
    }
    return base.at(camera={**camera.model_dump(), **finer})
