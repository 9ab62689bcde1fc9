"""What can be moved on the page, which values it can take, and the scenario that a state of it stands for.

A state is the values of all controls. Those that change transport stand on a grid, for each of their combinations has to be
rendered; *live* ones, applied after rendering, take any value. A state travels as the query of an address: a link holds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    return (*_geometry_controls(base), *_light_controls(base), *_camera_controls(base), *_marker_controls(base))


def _geometry_controls(base: Scenario) -> list[Control]:
    tilts = range(-60, 61, 10)
    return [
        _slider(base, "range_m", "Range", "m", base.budget.ranges_m, group="Geometry"),
        _slider(base, "target.yaw_deg", "Tilt about the vertical axis (yaw)", "°", tilts, group="Geometry"),
        _slider(base, "target.pitch_deg", "Tilt about the horizontal axis (pitch)", "°", tilts, group="Geometry"),
    ]


def _light_controls(base: Scenario) -> list[Control]:
    illuminations = {"eclipse": "off: eclipse", "sunlit": "on"}
    phases = (10, 20, 30, 45, 60, 75, 90, 120, 150)
    drives = [float(f"{v:.3g}") for v in np.geomspace(0.01, 4, 53)]
    current = Control(
        key="drive",
        label="LED current, the scenario's",
        unit="×",
        kind="slider",
        values=tuple(drives),
        texts=tuple(f"× {v:g}" for v in drives),
        start=1.0,
        live=True,
        group="Light",
        about="Intensity and electrical power in proportion to the current; droop is left out",
    )
    return [
        _choice("illumination", "Sun", illuminations, base.illumination, group="Light", live=True),
        _slider(base, "sun.phase_deg", "Phase angle, Sun–target–camera", "°", phases, group="Light"),
        current,
        _slider(base, "leds.count", "LEDs", "", (10, 20, 50, 100, 200), group="Light"),
        _slider(base, "leds.ring_radius_m", "Ring radius", "m", (0.02, 0.03, 0.05, 0.08, 0.12), group="Light"),
    ]


def _camera_controls(base: Scenario) -> list[Control]:
    automatic = base.exposure_s == "auto"
    longest = min(max(base.auto_exposure.longest_s, 1e-6), base.leds.longest_pulse_s)
    decades = np.log10(longest / base.auto_exposure.shortest_s)
    spread = np.geomspace(base.auto_exposure.shortest_s, longest, round(20 * decades) + 1)
    exposures = [float(f"{v:.3g}") for v in spread]
    stops = _with(exposures, base.exposure_s)
    exposure = Control(
        key="exposure_s",
        label="Exposure and LED pulse",
        unit="s",
        kind="slider",
        values=stops,
        texts=tuple(seconds_text(float(v)) for v in stops),
        start=exposures[len(exposures) // 3] if automatic else base.exposure_s,
        live=True,
        group="Camera",
    )
    modes = {"auto": "automatic", "fixed": "as set below"}
    pair = _choice(
        "pair",
        "Frames",
        {False: "one, LEDs on", True: "pair: LEDs on minus off"},
        False,
        group="Camera",
        live=True,
        about="Both frames with the target at rest; `mantis glare` moves it between them",
    )
    return [
        _choice("exposure", "Exposure", modes, "auto" if automatic else "fixed", group="Camera", live=True),
        exposure,
        pair,
        _preset("filter", "Filter"),
        _preset("sensor", "Sensor"),
    ]


def _marker_controls(base: Scenario) -> list[Control]:
    own = base.marker.dictionary
    patterns = {name: name for name in ("4X4_50", "5X5_50", "6X6_50", own)}
    return [
        _slider(base, "marker.size_m", "Marker side", "m", (0.05, 0.075, 0.10, 0.15, 0.20), group="Marker"),
        _choice("marker.dictionary", "Pattern", patterns, own, group="Marker"),
    ]


def _with(values: Iterable[float], own: float | str) -> tuple[Value, ...]:
    numbers = {float(v) for v in values} | ({float(own)} if own != "auto" else set())
    return tuple(sorted(numbers))


def _slider(base: Scenario, key: str, label: str, unit: str, values: Iterable[float], *, group: str) -> Control:
    """A slider over a grid of a scenario key's values, its own among them."""
    own: Any = base
    for part in key.split("."):
        own = getattr(own, part)
    grid = _with(values, own)
    texts = tuple(f"{v:g}{'' if unit in ('', '°') else ' '}{unit}" for v in grid)
    return Control(
        key=key,
        label=label,
        unit=unit,
        kind="slider",
        values=grid,
        texts=texts,
        start=float(own),
        live=False,
        group=group,
    )


def _choice(
    key: str,
    label: str,
    texts: Mapping[Any, str],
    start: Value,
    *,
    group: str,
    live: bool = False,
    about: str = "",
) -> Control:
    """A choice between values, each with its text; of two it is a switch."""
    return Control(
        key=key,
        label=label,
        unit="",
        kind="switch" if len(texts) == 2 else "choice",
        values=tuple(texts),
        texts=tuple(texts.values()),
        start=start,
        live=live,
        group=group,
        about=about,
    )


def _preset(section: str, label: str) -> Control:
    texts = {OWN: "as in the scenario", **{name: name for name in presets(section)}}
    about = (
        f"Of more than {WINDOW_PX[0]} × {WINDOW_PX[1]} px the middle is read out"
        if section == "sensor"
        else "see `mantis presets`"
    )
    return _choice(f"{section}.preset", label, texts, OWN, group="Camera", about=about)


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
