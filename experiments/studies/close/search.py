"""Parameter sets that close a whole range in closed form: criteria with margins, grid search and Pareto front."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.close.constraints import Constraints, at_life
from experiments.studies.close.form import ClosedForm, Sets
from radiometry import link
from radiometry.geometry import FloatArray

#: Criteria of a set, and what each is about. Those of `closure.CRITERIA` that need no frame come first.
CRITERIA_TEXT = {
    "saturation": "bright bits over full well",
    "cnr": "contrast-to-noise ratio",
    "sampling": "pixels per bit at the farthest range, tilted",
    "smear": "motion during the pulse",
    "frame": "marker in the frame at the nearest range",
    "focus": "defocus disc at the nearest range",
    "sun": "LED light over sunlight on the tape",
    "glint": "foil facet that mirrors the Sun over full well",
    "energy": "electrical energy of a pulse",
    "power": "mean electrical power",
}
#: Of these, what the light decides; the rest is geometry.
RADIOMETRIC = ("saturation", "cnr", "smear", "sun", "glint", "energy", "power")
#: Sets evaluated at a time.
_CHUNK = 1000


@dataclass(frozen=True)
class OperatingPoint:
    """How sets are operated: LEDs and pulse of every set, illumination and range, and what follows. Arrays (n, lights, ranges).

    Attributes:
        leds: LEDs that are on.
        pulse_s: exposure and LED pulse.
        signal_e, background_e: charge of a bright bit and of a dark cell beside it.
        full_well_fraction, cnr, smear_px: as in `chain.LinkBudget.at`.
        led_over_sun: tape lit by LEDs over tape lit by the Sun; infinite where none shines.
        glint_over_well: foil facet that mirrors the Sun over full well.
        energy_j: electrical energy of the pulse.
    """

    leds: FloatArray
    pulse_s: FloatArray
    signal_e: FloatArray
    background_e: FloatArray
    full_well_fraction: FloatArray
    cnr: FloatArray
    smear_px: FloatArray
    led_over_sun: FloatArray
    glint_over_well: FloatArray
    energy_j: FloatArray


@dataclass(frozen=True)
class ExposureSchedule:
    """LEDs and pulses set beforehand, (lights, ranges), whatever the light turns out to be."""

    leds: FloatArray
    pulse_s: FloatArray


def operate(
    form: ClosedForm, sets: Sets, constraints: Constraints, schedule: ExposureSchedule | None = None
) -> OperatingPoint:
    """Expose every set at every light and range.

    Without a schedule the exposure follows the light: all LEDs of the set, the pulse that brings the bright bits to the wanted
    part of full well, and fewer LEDs where that pulse would be shorter than the shortest.
    """
    scenario = form.scenario
    sensor, auto, rates = scenario.sensor, scenario.auto_exposure, form.rates(sets)
    well = (chain.usable_well_electrons(sensor) * sets.factor("full_well"))[:, None, None]
    if schedule is None:
        wanted, dark = auto.full_well_fraction * well, sensor.dark_rate_electrons_per_s
        most = np.floor((wanted / auto.shortest_s - rates.sun_signal - dark) / rates.led_signal)
        leds = np.clip(most, 1, np.atleast_1d(sets.led_count)[:, None, None])
        longest = min(auto.longest_s, 1 / constraints.frame_rate_hz(scenario))
        pulse = np.clip(wanted / (leds * rates.led_signal + rates.sun_signal + dark), auto.shortest_s, longest)
    else:
        leds, pulse = np.broadcast_arrays(schedule.leds, schedule.pulse_s)
        leds, pulse = leds[None], pulse[None]
    led = leds * rates.led_signal
    signal, background = (led + rates.sun_signal) * pulse, (leds * rates.led_background + rates.sun_background) * pulse
    dark_e, noise = sensor.dark_rate_electrons_per_s * pulse, sensor.total_noise_electrons
    speed = scenario.target.tumble_speed_m_s
    scale = np.atleast_1d(sets.focal_length_m * sets.factor("focal_length")) / scenario.camera.focal_length_m
    smear = link.smear_px(scenario.camera, form.ranges_m, speed, pulse) * scale[:, None, None]
    with np.errstate(divide="ignore"):
        ratio = np.where(rates.sun_signal > 0, led / rates.sun_signal, np.inf)
    return OperatingPoint(
        leds=leds,
        pulse_s=pulse,
        signal_e=signal,
        background_e=background,
        full_well_fraction=(signal + dark_e) / well,
        cnr=link.cnr(signal, background, dark_e, noise),
        smear_px=smear,
        led_over_sun=ratio,
        glint_over_well=rates.foil * pulse / well,
        energy_j=scenario.leds.electrical_power_w * leds * pulse,
    )


def margins(form: ClosedForm, sets: Sets, constraints: Constraints, operating: OperatingPoint) -> dict[str, FloatArray]:
    """Factor by which every criterion is met, (n, lights, ranges) or broadcast against it; below 1 it fails."""
    requirement, c = form.scenario.requirement, constraints
    energy = np.maximum(operating.energy_j, 1e-30)
    geometry = geometry_margins(form, sets, constraints)
    with np.errstate(divide="ignore"):
        illumination = {
            "saturation": requirement.full_well_fraction_max / operating.full_well_fraction,
            "cnr": operating.cnr / requirement.cnr_min,
            "smear": requirement.smear_px_max / operating.smear_px,
            "sun": operating.led_over_sun / c.led_over_sun_min,
            "glint": c.glint_over_well_max / operating.glint_over_well,
            "energy": c.energy_per_frame_j / energy,
            "power": c.average_power_w / (energy * c.frame_rate_hz(form.scenario)),
        }
    merged = illumination | {name: value[:, None, :] for name, value in geometry.items()}
    return {name: merged[name] for name in CRITERIA_TEXT}


def geometry_margins(form: ClosedForm, sets: Sets, constraints: Constraints) -> dict[str, FloatArray]:
    """Margins of sampling, frame and focus, (n, ranges).

    Defocus: a thin lens focused at R₀, here the farthest range, draws a point at R as a disc that in the plane of the marker is
    D (R₀ − R)/R₀ wide, D its entrance pupil.
    """
    camera, requirement, ranges = form.scenario.camera, form.scenario.requirement, form.ranges_m
    focal = sets.focal_length_m * sets.factor("focal_length")
    size = form.sizes_m[sets.size]
    tilted = form.px_per_bit(sets) * np.cos(np.radians(constraints.tilt_deg))
    shorter = min(camera.width_px * camera.pixel_pitch_x_m, camera.height_px * camera.pixel_pitch_y_m)
    share = np.atleast_1d(size * focal / shorter)[:, None] / ranges
    pupil = np.atleast_1d(sets.focal_length_m / sets.f_number)[:, None]
    blur = pupil * (1 - ranges / ranges[-1]) / np.atleast_1d(size * form.bit_fraction)[:, None]
    return {
        "sampling": tilted / requirement.px_per_bit_min,
        "frame": constraints.frame_share_max / share,
        "focus": constraints.blur_bits_max / np.maximum(blur, 1e-9),
    }


@dataclass(frozen=True)
class Point:
    """One closing set.

    Attributes:
        led_count, fewest_leds: LEDs of the ring, and the smallest number of the search that closes as well.
        margins: smallest of each criterion over lights and ranges.
        binding: the criterion with the smallest margin, and its range [m].
        power_w, energy_j: mean electrical power and energy of the pulse where it is largest.
        peak_power_w: electrical power while the LEDs are on.
        hardware: what differs from the scenario's hardware, in words; empty for nothing.
    """

    tape: str
    size_m: float
    focal_length_m: float
    f_number: float
    led_count: int
    fewest_leds: int
    margins: dict[str, float]
    binding: tuple[str, float]
    energy_j: float
    power_w: float
    peak_power_w: float
    hardware: str = ""

    @property
    def margin(self) -> float:
        """The smallest margin of all."""
        return min(self.margins.values())

    def scenario(self, base: Scenario, constraints: Constraints, end: bool) -> Scenario:
        """The base scenario with this set's parameters, focused at the farthest range, new or at the end of the mission."""
        lens = {"focal_length_m": self.focal_length_m, "f_number": self.f_number, "focus_m": constraints.ranges_m[-1]}
        chosen = base.at(
            camera={**base.camera.model_dump(), **lens},
            marker={**base.marker.model_dump(), "size_m": self.size_m},
            leds={**base.leds.model_dump(), "count": self.led_count},
            target={**base.target.model_dump(), "tape_material": self.tape},
        )
        return at_life(chosen, constraints, end)

    @property
    def label(self) -> str:
        """'10 cm, 42.5 mm F/5, 50 LEDs'."""
        lens = f"{1e3 * self.focal_length_m:.4g} mm F/{self.f_number:.3g}"
        leds = f"{self.led_count} LED{'s' if self.led_count > 1 else ''}"
        return ", ".join(part for part in (f"{100 * self.size_m:g} cm", lens, leds, self.hardware) if part)


@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes:
        tried: sets in the grid that the constraints allow.
        focused: of these, sets whose geometry closes: sampling, frame and focus.
        closing: sets that close, each with the most LEDs that do.
        front: of these, none is better in power, marker size and focal length at once; cheapest power first.
    """

    tried: int
    focused: int
    closing: tuple[Point, ...]
    front: tuple[Point, ...]

    def proposed(self) -> tuple[Point, ...]:
        """Of every marker size on the front the set with the largest margin; the one with the largest of all comes first."""
        sizes = sorted({p.size_m for p in self.front}, reverse=True)
        best = [max((p for p in self.front if p.size_m == size), key=_preference) for size in sizes]
        if not best:
            return ()
        first = max(best, key=_preference)
        return (first, *(p for p in best if p != first))


def _preference(point: Point) -> tuple[float, float]:
    return round(point.margin, 4), -point.power_w


def search(form: ClosedForm, constraints: Constraints) -> SearchResult:
    """Every set of the grid that closes, and the Pareto front of power, marker size and focal length."""
    face = form.scenario.target.face_m
    grid = [
        (t, s, f, n)
        for t, s, f, n in product(
            range(len(form.tapes)),
            range(len(form.sizes_m)),
            constraints.focal_lengths_m.values(),
            constraints.f_numbers,
        )
        if form.sizes_m[s] <= constraints.marker_over_face_max * face * (1 + 1e-9)
        and f / n <= constraints.aperture_max_m * (1 + 1e-9)
    ]
    if not grid:
        return SearchResult(0, 0, (), ())
    tape, size, focal, f_number = (np.array(column) for column in zip(*grid, strict=True))
    allowed = Sets(tape, size, focal, f_number, np.ones(len(grid)))
    geometric = np.array([v.min(axis=1) for v in geometry_margins(form, allowed, constraints).values()]).min(axis=0)
    kept = np.nonzero(geometric >= 1)[0]
    best: dict[tuple[float, ...], Point] = {}
    for count in constraints.led_counts:
        for chunk in np.array_split(kept, max(1, len(kept) // _CHUNK)):
            sets = allowed.take(chunk)
            sets = Sets(sets.tape, sets.size, sets.focal_length_m, sets.f_number, np.full(len(chunk), count))
            for point in points(form, sets, constraints):
                key = (point.size_m, point.focal_length_m, point.f_number, form.tapes.index(point.tape))
                if point.margin >= 1:  # counts increase, and more LEDs leave more margin to the light
                    best[key] = replace(point, fewest_leds=best[key].fewest_leds if key in best else count)
    closing = tuple(best.values())
    tried, focused = len(grid) * len(constraints.led_counts), len(kept) * len(constraints.led_counts)
    return SearchResult(tried, focused, closing, pareto(closing))


def points(form: ClosedForm, sets: Sets, constraints: Constraints) -> list[Point]:
    """Every set with the smallest margin of each criterion, whether it closes or not."""
    if np.size(sets.tape) == 0:
        return []
    operating = operate(form, sets, constraints)
    found = margins(form, sets, constraints, operating)
    shape = operating.pulse_s.shape
    full = np.stack([np.broadcast_to(m, shape) for m in found.values()])  # (criteria, n, lights, ranges)
    least = full.min(axis=(2, 3))
    first = np.argmin(least, axis=0)
    energy = operating.energy_j.max(axis=(1, 2))
    rate, each = constraints.frame_rate_hz(form.scenario), form.scenario.leds.electrical_power_w
    names, result = list(found), []
    for i in range(shape[0]):
        at = np.unravel_index(int(np.argmin(full[first[i], i])), shape[1:])[1]
        result.append(
            Point(
                tape=form.tapes[int(sets.tape[i])],
                size_m=float(form.sizes_m[int(sets.size[i])]),
                focal_length_m=float(sets.focal_length_m[i]),
                f_number=float(sets.f_number[i]),
                led_count=int(sets.led_count[i]),
                fewest_leds=int(sets.led_count[i]),
                margins=dict(zip(names, map(float, least[:, i]), strict=True)),
                binding=(names[first[i]], float(form.ranges_m[at])),
                energy_j=float(energy[i]),
                power_w=float(energy[i] * rate),
                peak_power_w=float(sets.led_count[i] * each),
            )
        )
    return result


def pareto(closing: tuple[Point, ...]) -> tuple[Point, ...]:
    """Those that no other beats in one of power, marker size and focal length without losing in another; power first."""
    ordered = sorted(closing, key=lambda p: (p.power_w, p.size_m, p.focal_length_m, p.led_count))
    front: list[Point] = []
    for p in ordered:
        if not any(q.size_m <= p.size_m and q.focal_length_m <= p.focal_length_m for q in front):
            front.append(p)
    return tuple(front)


def sets_of(form: ClosedForm, point: Point, factors: dict[str, FloatArray] | None = None) -> Sets:
    """One set as arrays, with factors on its assumptions."""
    size = int(np.argmin(np.abs(form.sizes_m - point.size_m)))
    return Sets(
        tape=np.array([form.tapes.index(point.tape)]),
        size=np.array([size]),
        focal_length_m=np.array([point.focal_length_m]),
        f_number=np.array([point.f_number]),
        led_count=np.array([point.led_count]),
        factors=factors or {},
    )
