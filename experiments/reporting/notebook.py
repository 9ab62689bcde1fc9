"""How results look in a Jupyter notebook: small HTML tables and pictures, legible on light and dark pages.

The types know nothing of this: `register` tells a running IPython which function shows which type.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.reporting.formatting import ILLUMINATION_NAMES, number, seconds_text

if TYPE_CHECKING:
    from experiments.chain import DetectedImage, Detection, LinkBudget
    from experiments.chain.shoot import Exposure
    from experiments.scenario import Scenario

_CELL = 'style="text-align:left;padding:1px 10px 1px 0"'


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """An HTML table of text; cells are escaped."""
    heading = f"<tr>{''.join(f'<th {_CELL}>{escape(h)}</th>' for h in head)}</tr>" if head else ""
    body = "".join(f"<tr>{''.join(f'<td {_CELL}>{escape(str(c))}</td>' for c in row)}</tr>" for row in rows)
    return f"<table>{heading}{body}</table>"


def scenario_html(scenario: Scenario) -> str:
    """What differs from the defaults, then every key by section behind a click."""
    from experiments.scenario.keys import scenario_keys

    data = scenario.model_dump(mode="json")
    changed, by_section = [], dict[str, list[list[str]]]()
    for key in scenario_keys():
        holder = data[key.section] if key.section else data
        if holder is None:
            continue
        value = holder[key.name]
        row = [key.dotted, _value(value), key.unit, key.meaning]
        by_section.setdefault(key.section or "top", []).append(row)
        if value != key.default and key.name != "title":
            changed.append([*row[:3], _value(key.default)])
    shown = table(changed, ("changed", "value", "unit", "default")) if changed else "<p>All at the defaults.</p>"
    folded = "".join(
        f"<details><summary>{escape(name)}</summary>{table(rows, ('key', 'value', 'unit', 'meaning'))}</details>"
        for name, rows in by_section.items()
    )
    return f"<b>{escape(scenario.title)}</b> <code>{scenario.digest()}</code>{shown}{folded}"


def budget_html(budget: LinkBudget) -> str:
    """Rates, sampling, and the exposures at which noise and the well limit."""
    rows = [
        ("signal of a bright bit", number(budget.signal_rate), "e⁻/s"),
        ("background of a dark cell", number(budget.background_rate), "e⁻/s"),
        ("tape that fills its pixels", number(budget.tape_rate), "e⁻/s"),
        ("reflective share of a bright bit", number(budget.fill), ""),
        ("sampling", number(budget.px_per_bit), "px per bit"),
        ("smear", number(budget.smear_px_per_s), "px/s"),
    ]
    return table(rows, ("closed form", "value", "unit"))


def detection_html(seen: Detection) -> str:
    """Whether the marker was found, its corners and blobs, and its pose with one standard deviation."""
    from experiments.reporting.detection import describe

    return f"<p>{'<br>'.join(escape(line) for line in describe(seen))}</p>"


def detected_image_html(seen: DetectedImage) -> str:
    """The image about the marker with the detection drawn in it, or the whole image where none was found; then its text."""
    from experiments.reporting.pictures import legend, marker_picture

    corners = seen.features.corners_px
    if corners is None:
        height, width = seen.image.shape
        centre, side = np.array([(width - 1) / 2, (height - 1) / 2]), float(max(width, height))
    else:
        centre = corners.mean(axis=0)
        side = 1.2 / seen.scenario.marker.aruco_fraction * float(np.ptp(corners, axis=0).max())
    unknown = np.empty((0, 2))  # where the marker truly is, nobody knows of an image from elsewhere
    picture = marker_picture(seen.image, seen.features, centre, side, unknown)
    return f"{picture.svg}<p>{legend()}</p>{detection_html(seen)}"


def _value(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, list):
        text = ", ".join(_value(v) for v in value)
        return f"[{text}]" if len(text) < 60 else f"{len(value)} values, {_value(value[0])} to {_value(value[-1])}"
    return f"{value:g}" if isinstance(value, float) and np.isfinite(value) else str(value)


def exposure_html(shot: Exposure) -> str:
    """The frame about the marker with the detections drawn, the detection, and the errors against the scenario."""
    from experiments.chain import view
    from experiments.reporting.pictures import legend, marker_picture

    seen = view(shot.scenario)
    outline = seen.to_image(seen.marker.corners_m)
    side = 1.2 / seen.marker.aruco_fraction * float(np.ptp(outline, axis=0).max())
    centre = outline.mean(axis=0)
    picture = marker_picture(shot.frame, shot.detection.features, centre, side, outline)
    errors = [
        (
            "taken",
            f"at {shot.scenario.range_m:g} m, {ILLUMINATION_NAMES[shot.scenario.illumination]}, {seconds_text(shot.exposure_s)}",
        ),
        ("error", f"attitude {number(np.degrees(shot.attitude_error_rad))}°, range {number(100 * shot.range_error)} %"),
    ]
    return f"{picture.svg}<p>{legend()}</p>{table(errors)}{detection_html(shot.detection)}"


#: Type by module and name, so that nothing is imported before it is shown -> what shows it.
DISPLAYS: dict[tuple[str, str], Callable[[Any], str]] = {
    ("experiments.scenario.model", "Scenario"): scenario_html,
    ("experiments.chain.link_budget", "LinkBudget"): budget_html,
    ("detector.detect", "Detection"): detection_html,
    ("experiments.chain.detection", "DetectedImage"): detected_image_html,
    ("experiments.chain.shoot", "Exposure"): exposure_html,
}


def register() -> None:
    """Have a running IPython show this project's types as HTML; nothing where none runs."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython

    shell = get_ipython()
    if shell is not None and shell.display_formatter is not None:
        formatter = shell.display_formatter.formatters["text/html"]
        for (module, name), show in DISPLAYS.items():
            formatter.for_type_by_name(module, name, show)
