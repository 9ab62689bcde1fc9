"""What can be moved on the page, which values it can take, and the scenario that a state of it stands for.

A state is the values of all controls. Those that change transport stand on a grid, for each of their combinations has to be
rendered; *live* ones, applied after rendering, take any value. A state travels as the query of an address: a link holds it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import parse_qsl, urlencode

import numpy as np

from experiments.reporting.formatting import seconds_text
from experiments.scenario import Scenario, ScenarioError
from experiments.scenario.presets import presets

Value = float | str | bool
State = dict[str, Value]

#: A detector of more pixels is read out in a window about the optical axis: a larger one could not follow a slider.
WINDOW_PX = (752, 580)
#: Choice that leaves a section as the scenario file has it.
OWN = "scenario"


@dataclass(frozen=True)
class Control:
    """One thing to move.

    Attributes:
        key: in the state: a scenario key, or `drive` and `pair`, which no file has.
        label, unit: for people.
        kind: how it is moved.
        values: its grid, or all its choices, in order; a live slider's are where its handle stops.
        texts: of the values, with the unit.
        start: value of the scenario that was opened.
        live: True where nothing is rendered for a new value.
        group: heading under which it stands.
        about: one line that says what it does.
    """

    key: str
    label: str
    unit: str
    kind: Literal["slider", "choice", "switch"]
    values: tuple[Value, ...]
    texts: tuple[str, ...]
    start: Value
    live: bool
    group: str
    about: str = ""


def controls(base: Scenario) -> tuple[Control, ...]:
    """The controls of a scenario; its own values are on every grid."""
    shortest, longest = (
        base.auto_exposure.shortest_s,
        min(max(base.auto_exposure.longest_s, 1e-6), base.leds.longest_pulse_s),
    )
    decades = np.log10(longest / shortest)
    exposures = [float(f"{v:.3g}") for v in np.geomspace(shortest, longest, round(20 * decades) + 1)]
    drives = [float(f"{v:.3g}") for v in np.geomspace(0.01, 4, 53)]
    tilts = range(-60, 61, 10)
    found = [
        _slider(base, "range_m", "Range", "m", base.budget.ranges_m, "Geometry"),
        _slider(base, "target.yaw_deg", "Tilt about the vertical axis (yaw)", "°", tilts, "Geometry"),
        _slider(base, "target.pitch_deg", "Tilt about the horizontal axis (pitch)", "°", tilts, "Geometry"),
        _choice(base, "illumination", "Sun", ("eclipse", "sunlit"), ("off: eclipse", "on"), base.illumination, "Light", live=True),
        _slider(base, "sun.phase_deg", "Phase angle, Sun–target–camera", "°", (10, 20, 30, 45, 60, 75, 90, 120, 150), "Light"),
        Control(
            "drive", "LED current, the scenario's", "×", "slider", tuple(drives), tuple(f"× {v:g}" for v in drives), 1.0, True,
            "Light", "Intensity and electrical power in proportion to the current; droop is left out",
        ),
        _slider(base, "leds.count", "LEDs", "", (10, 20, 50, 100, 200), "Light"),
        _slider(base, "leds.ring_radius_m", "Ring radius", "m", (0.02, 0.03, 0.05, 0.08, 0.12), "Light"),
        _choice(
            base, "exposure", "Exposure", ("auto", "fixed"), ("automatic", "as set below"),
            "auto" if base.exposure_s == "auto" else "fixed", "Camera", live=True,
        ),
        Control(
            "exposure_s", "Exposure and LED pulse", "s", "slider",
            _with(exposures, base.exposure_s), tuple(seconds_text(float(v)) for v in _with(exposures, base.exposure_s)),
            base.exposure_s if base.exposure_s != "auto" else exposures[len(exposures) // 3], True, "Camera",
        ),
        _choice(
            base, "pair", "Frames", (False, True), ("one, LEDs on", "pair: LEDs on minus off"), False, "Camera", live=True,
            about="Both frames with the target at rest; `mantis glare` moves it between them",
        ),
        _preset(base, "filter", "Filter"),
        _preset(base, "sensor", "Sensor"),
        _slider(base, "marker.size_m", "Marker side", "m", (0.05, 0.075, 0.10, 0.15, 0.20), "Marker"),
        _choice(
            base, "marker.dictionary", "Pattern", *_twice(_unique(("4X4_50", "5X5_50", "6X6_50"), base.marker.dictionary)),
            base.marker.dictionary, "Marker",
        ),
    ]  # fmt: skip
    return tuple(found)


def _with(values: Any, own: Any) -> tuple[Value, ...]:
    numbers = {float(v) for v in values} | ({float(own)} if own != "auto" else set())
    return tuple(sorted(numbers))


def _unique(values: tuple[str, ...], own: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*values, own)))


def _twice(values: tuple[str, ...]) -> tuple[tuple[Value, ...], tuple[str, ...]]:
    return values, values


def _slider(base: Scenario, key: str, label: str, unit: str, values: Any, group: str) -> Control:
    """A slider over a grid of a scenario key's values, its own among them."""
    own: Any = base
    for part in key.split("."):
        own = getattr(own, part)
    grid = _with(values, own)
    texts = tuple(f"{v:g}{'' if unit in ('', '°') else ' '}{unit}" for v in grid)
    return Control(key, label, unit, "slider", grid, texts, float(own), False, group)


def _choice(
    base: Scenario, key: str, label: str, values: tuple[Value, ...], texts: tuple[str, ...], start: Value, group: str, *,
    live: bool = False, about: str = "",
) -> Control:  # fmt: skip
    kind: Literal["choice", "switch"] = "switch" if len(values) == 2 else "choice"
    return Control(key, label, "", kind, values, texts, start, live, group, about)


def _preset(base: Scenario, section: str, label: str) -> Control:
    names = tuple(presets(section))
    texts = ("as in the scenario", *names)
    about = (
        f"Of more than {WINDOW_PX[0]} × {WINDOW_PX[1]} px the middle is read out"
        if section == "sensor"
        else "see `mantis presets`"
    )
    return Control(f"{section}.preset", label, "", "choice", (OWN, *names), texts, OWN, False, "Camera", about)


def read_state(query: str, known: tuple[Control, ...]) -> State:
    """The state that a query says, what it leaves out as at the start; values of transport snap to their grid.

    Raises:
        ScenarioError: one line about the first key or value that is none of the page's.
    """
    state: State = {control.key: control.start for control in known}
    by_key = {control.key: control for control in known}
    for key, text in parse_qsl(query, keep_blank_values=True):
        if key not in by_key:
            raise ScenarioError(f"{key}: not a control of the page; there are {', '.join(by_key)}")
        state[key] = _read(by_key[key], text)
    return state


def _read(control: Control, text: str) -> Value:
    if control.kind != "slider":
        for value in control.values:
            if text == write_value(value):
                return value
        choices = ", ".join(map(write_value, control.values))
        raise ScenarioError(f"{control.key}: {text!r}, expected one of {choices}")
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise ScenarioError(f"{control.key}: {text!r}, expected a number [{control.unit or '1'}]")
    low, high = float(control.values[0]), float(control.values[-1])
    if not low <= number <= high:
        raise ScenarioError(f"{control.key}: {text}, expected {low:g} to {high:g} [{control.unit or '1'}]")
    return number if control.live else min(control.values, key=lambda v: abs(float(v) - number))


def write_value(value: Value) -> str:
    """A value as it stands in a query."""
    return (
        ("1" if value else "0") if isinstance(value, bool) else f"{value:.10g}" if isinstance(value, float) else value
    )


def write_state(state: Mapping[str, Value], known: tuple[Control, ...]) -> str:
    """The query of a state: what differs from the start."""
    return urlencode({c.key: write_value(state[c.key]) for c in known if state[c.key] != c.start})


def scenario_of(base: Scenario, state: Mapping[str, Value]) -> Scenario:
    """The scenario that a state stands for; the same numbers come from it on the command line.

    Raises:
        ScenarioError: one line about what does not fit together.
    """
    lit = geometry_of(base, state)
    drive = float(state["drive"])
    leds = {
        "leds.intensity_w_sr": lit.leds.intensity_w_sr * drive,
        "leds.electrical_power_w": lit.leds.electrical_power_w * drive,
    }
    exposure = "auto" if state["exposure"] == "auto" else float(state["exposure_s"])
    return lit.with_values(
        {**(leds if drive != 1 else {}), "illumination": state["illumination"], "exposure_s": exposure}
    )


def geometry_of(base: Scenario, state: Mapping[str, Value]) -> Scenario:
    """The same with the live controls as in the scenario that was opened: what is rendered.

    Raises:
        ScenarioError: as `scenario_of`.
    """
    chosen = [f"{s}.preset={state[f'{s}.preset']}" for s in ("filter", "sensor") if state[f"{s}.preset"] != OWN]
    scenario = base.changed(*chosen)
    values: dict[str, Any] = {
        key: value
        for key, value in state.items()
        if key not in ("illumination", "drive", "exposure", "exposure_s", "pair", "filter.preset", "sensor.preset")
    }
    values["leds.count"] = round(float(values["leds.count"]))
    return scenario.with_values({**values, **_window(scenario)})


def _window(scenario: Scenario) -> dict[str, int]:
    """Fewer pixels about the optical axis, where there are more than `WINDOW_PX`; counts keep their parity, and so the axis."""
    camera = scenario.camera
    return {
        f"camera.{key}": most - (most - getattr(camera, key)) % 2
        for key, most in zip(("width_px", "height_px"), WINDOW_PX, strict=True)
        if getattr(camera, key) > most
    }
