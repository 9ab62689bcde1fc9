"""What the field-of-view study says: printed, reproduced, right and measured; tables, figures and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from experiments.reporting.claims import Statement, StudyPage
from experiments.scenario import Scenario
from experiments.thesis.fov import closed_form, figures
from experiments.thesis.fov.study import Progress, run
from radiometry import field_of_view as fov

#: Share of a cell's frames that counts as found.
FOUND = 0.99
#: Angles between sight line and normal for which the share of directions is told [deg].
TILTS_DEG = (30.0, 40.0, 45.0, 50.0, 60.0)


def tilt_deg(data: xr.Dataset) -> xr.DataArray:
    """Angle between the marker's normal and the line of sight over the map's grid [deg]."""
    return np.degrees(np.arccos(np.cos(np.radians(data.pitch_deg)) * np.cos(np.radians(data.yaw_deg))))


def cone_rows(data: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then for each range and tilt the share of the grid's directions up to it with each kind of feature."""
    rows: list[tuple[str, ...]] = [
        ("range [m]", "tilt up to [deg]", "directions", "corners [%]", "virtual point [%]", "pose [%]",
         "attitude error, largest median [deg]"),
    ]  # fmt: skip
    tilt = tilt_deg(data)
    for range_m in data.range_m.values:
        at = data.sel(range_m=range_m)
        for limit in TILTS_DEG:
            inside = tilt <= limit + 1e-9
            shares = [100 * float((at[n] >= FOUND).where(inside).mean()) for n in ("corners", "virtual", "pose")]
            worst = float(at.attitude_deg.where(inside).max())
            rows.append(
                (f"{range_m:g}", f"{limit:g}", str(int(inside.sum())), *(f"{v:.1f}" for v in shares), f"{worst:.3g}")
            )
    return rows


def map_rows(data: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a range, pitch and yaw."""
    elements = [str(name) for name in data.element.values]
    rows: list[tuple[str, ...]] = [
        ("range_m", "pitch_deg", "yaw_deg", "corners", "virtual", "pose", *elements, "attitude_deg")
    ]
    for range_m in data.range_m.values:
        for pitch in data.pitch_deg.values:
            for yaw in data.yaw_deg.values:
                at = data.sel(range_m=range_m, pitch_deg=pitch, yaw_deg=yaw)
                shares = (at.corners, at.virtual, at.pose, *at.blob.values)
                cells = [f"{float(v):g}" for v in shares]
                rows.append((f"{range_m:g}", f"{pitch:g}", f"{yaw:g}", *cells, f"{float(at.attitude_deg):.4g}"))
    return rows


def cut_rows(data: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a yaw and element."""
    rows: list[tuple[str, ...]] = [("yaw_deg", "element", "light", "centroid_error_mm", "found")]
    for yaw in data.yaw_deg.values:
        for name in data.element.values:
            at = data.sel(yaw_deg=yaw, element=name)
            rows.append(
                (
                    f"{yaw:g}",
                    str(name),
                    f"{float(at.light):.4f}",
                    f"{1e3 * float(at.centroid_m):.4f}",
                    f"{float(at.found):g}",
                )
            )
    return rows


def measured_sides(cut: xr.Dataset) -> fov.Sides:
    """Sides of the top element in the frames of the cut: last yaw either way up to which every frame has its blob [rad]."""
    return fov.Sides(*(np.radians(v) for v in _reach(cut, "top")))


def _reach(cut: xr.Dataset, element: str) -> tuple[float, float]:
    """Last yaw [deg] towards minus and plus up to which a blob is found in every frame, both positive."""
    yaw, found = cut.yaw_deg.values, cut.found.sel(element=element).values >= FOUND
    reach = []
    for sign in (-1.0, 1.0):
        steps = np.sort(sign * yaw[sign * yaw >= 0])
        last = float("nan")
        for step in steps:
            if not found[np.argmin(np.abs(yaw - sign * step))]:
                break
            last = float(step)
        reach.append(last)
    return reach[0], reach[1]


def equal_reach(virtual: xr.DataArray, range_m: float) -> float:
    """Largest |pitch| = |yaw| up to which a map has a virtual point on all four diagonals [deg]."""
    at, last = virtual.sel(range_m=range_m), float("nan")
    for step in virtual.pitch_deg.values[virtual.pitch_deg.values >= 0]:
        corners = [float(at.sel(pitch_deg=a * step, yaw_deg=b * step)) for a in (-1, 1) for b in (-1, 1)]
        if min(corners) < FOUND:
            break
        last = float(step)
    return last


def _diagonal_here(limits: closed_form.Limits) -> float:
    """Largest |pitch| = |yaw| with a virtual point on all four diagonals, by the closed form [deg]."""
    angles = np.radians(np.arange(0.0, 79.0, 0.01))
    everywhere = np.ones(len(angles), bool)
    for a in (-1, 1):
        for b in (-1, 1):
            seen = [
                closed_form.seen(limits, name, a * angles, b * angles) for name in ("top", "right", "bottom", "left")
            ]
            everywhere &= (seen[0] | seen[2]) & (seen[1] | seen[3])
    first = int(np.argmin(everywhere)) if not everywhere.all() else len(angles)
    return float(np.degrees(angles[first - 1])) if first else 0.0


def statements(tree: xr.DataTree, scenario: Scenario) -> list[Statement]:
    """Section 5.6, statement by statement."""
    marker = scenario.marker
    found = closed_form.limits(marker)
    data, cut = tree["map"].to_dataset(), tree["cut"].to_dataset()
    length, depth = 1.0, marker.virtual_depth_fraction
    sides, measured = found.sides, measured_sides(cut)
    across = min(_reach(cut, "right"))
    nan = float("nan")
    near, far = float(data.range_m[0]), float(data.range_m[-1])
    lateral, axis = closed_form.THESIS_LATERAL_RAD, found.thesis.far

    def deg(value: float) -> float:
        return float(np.degrees(value))

    return [
        Statement("eq. 5.17", "field of an element with its line in the middle", "deg", "", deg(fov.one_sided_field(length, depth)),
                  deg(fov.centred_field(length, depth)), "as printed it is the field with the line under one end"),
        Statement("eq. 5.18", "field of an element, near side", "deg", "26.6", deg(sides.near), deg(sides.near)),
        Statement("eq. 5.18", "field of an element, far side", "deg", "56.3", deg(sides.far), deg(sides.far)),
        Statement("eq. 5.18", "field of an element", "deg", "82.9", deg(sum(sides)), deg(sum(sides))),
        Statement("section 5.6", "margin on the near side", "deg", "18", 18.0, deg(sides.near - found.found.near),
                  "a blob needs one margin in length; in angle it differs from side to side"),
        Statement("section 5.6", "margin on the far side", "deg", "18", 18.0, deg(sides.far - found.found.far),
                  "0.11 of the element's length: 5 % of the blob beyond the end"),
        Statement("section 5.6", "field of an element with margin", "deg", "46.9", deg(sum(found.thesis)), deg(sum(found.found))),
        Statement("section 5.6", "the same, in rendered frames", "deg", "46.9", deg(sum(found.thesis)), deg(sum(measured)),
                  "steps of 1 deg"),
        Statement("section 5.6", "overlap of two opposite elements", "deg", "17.2", deg(2 * found.thesis.near),
                  deg(2 * found.found.near), "17.2 is made from 8.6, rounded"),
        Statement("eq. 5.19", "longitudinal field of the marker", "deg", "76.6", deg(found.printed_marker), deg(found.marker),
                  "printed: ±38.3 deg, less than SYS-REQ-1 asks; right: ±52 deg"),
        Statement("eq. 5.19", "the same, in rendered frames", "deg", "76.6", deg(found.printed_marker),
                  deg(fov.combined_field(measured)), "steps of 1 deg"),
        Statement("section 5.6", "lateral field of an element", "deg", "100", nan, deg(2 * found.lateral),
                  "straight walls, a tenth of the floor's width left; the thesis estimates, for walls cut away"),
        Statement("section 5.6", "the same, in rendered frames", "deg", "100", nan, 2 * across, "steps of 1 deg"),
        Statement("eq. 5.20", "equal pitch and yaw on the ellipse, far side", "deg", "", deg(fov.equal_angles(lateral, axis)),
                  deg(fov.equal_angles(lateral / 2, axis)), "its lateral semi-axis is a full field; right here: half of it"),
        Statement("section 8.1, test 7", "equal pitch and yaw to which a virtual point exists", "deg", "35",
                  deg(fov.equal_angles(lateral, axis)), _diagonal_here(found), "a rectangle in slopes, no ellipse in angles"),
        Statement("section 8.1, test 7", f"the same, found in noisy frames at {near:g} m", "deg", "35", nan,
                  equal_reach(data.virtual, near), "by this project's detector; steps of 5 deg"),
        Statement("section 8.1, test 7", f"the same, found in noisy frames at {far:g} m", "deg", "35", nan,
                  equal_reach(data.virtual, far), "by this project's detector; steps of 5 deg"),
    ]  # fmt: skip


def answers(tree: xr.DataTree, scenario: Scenario) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    found, data = closed_form.limits(scenario.marker), tree["map"].to_dataset()
    rows = {(r[0], r[1]): r for r in cone_rows(data)[1:]}
    said = []
    for range_m in data.range_m.values:
        at = rows[f"{range_m:g}", "45"]
        said.append(
            f"{range_m:g} m: corners are found in {at[3]} % and a virtual point in {at[4]} % of all "
            f"directions up to 45 deg "
            f"off the normal; the largest median attitude error there is {at[6]} deg."
        )
    half, printed = np.degrees(found.marker) / 2, np.degrees(found.printed_marker) / 2
    far = np.degrees(found.sides.far - found.found.far)
    return (
        f"Along: the marker sees ±{half:.1f} deg, not ±{printed:.1f} deg. The thesis takes 18 deg off either side, but a blob "
        f"needs the same length on both, and that is {far:.1f} deg on the far side.",
        "Combined: the field is no ellipse. Along an element a slope is limited, across it another: a rectangle in tangents.",
        *said,
    )


def page(tree: xr.DataTree, scenario: Scenario, command: str) -> StudyPage:
    """Everything that is written."""
    data, cut = tree["map"].to_dataset(), tree["cut"].to_dataset()
    cone = cone_rows(data)
    limit = {row[0]: float(row[4]) for row in cone[1:] if row[1] == "45"}
    met = min(limit.values()) >= 100.0
    where = "everywhere" if met else f"in {min(limit.values()):.0f} % of the directions at the worst range"
    return StudyPage(
        name="fov",
        title="Field of view of element and marker",
        headline=f"Up to 45 deg off the normal a virtual point is found {where}.",
        passed=met,
        answers=answers(tree, scenario),
        statements=statements(tree, scenario),
        tables={"cone": cone, "map": map_rows(data), "cut": cut_rows(cut)},
        table_captions={
            "cone": "Share of directions with features, by the angle off the normal",
            "map": "Share of frames with each feature over pitch and yaw",
            "cut": "One cut over yaw, no pitch",
        },
        plots={
            "marker": figures.marker_maps(data, scenario.marker),
            "element": figures.element_map(data, scenario.marker),
            "cut": figures.cut(cut, scenario.marker, float(data.range_m[0]), scenario.leds.ring_radius_m),
        },
        captions=figures.CAPTIONS,
        about=ABOUT,
        short=("cone",),
        limits=LIMITS,
        command=command,
        scenario=scenario,
    )


ABOUT = (
    "Section 5.6 of the thesis gives the field of view of an encoding element and of the marker in equations 5.17 "
    "to 5.20, with "
    "margins that it estimates. This page recomputes them, derives what they should be for a blob of finite width, "
    "and holds "
    "both against rendered frames over pitch and yaw.",
    "An element of length w has its virtual line a depth V behind the face, at d from the near end. The blob lies "
    "at V·tan θ from the "
    "line's foot, so every limit is one of slope: `radiometry/field_of_view.py`.",
)
LIMITS = (
    "The thesis's element has side walls cut to an anvil's profile, whose dimensions are not given; here they are "
    "straight, so its "
    "lateral field is the thesis's design's lower bound.",
    "LEDs alone, automatic exposure of every tilt, tape of Type XI with its entrance-angle fall-off as far as its "
    "table goes.",
    "Four noise draws a cell: a share of one says no more than at least 47 % with 95 % confidence for a single "
    "cell; the cells "
    "of a region say it together.",
    "Roll turns the picture and not the marker's field of view; it is zero here.",
)


def study(
    scenario: Scenario, out: Path, command: str, quick: bool = False, progress: Progress | None = None
) -> StudyPage:
    """Run and write fov.nc (groups map and cut), report.html, data/fov*.csv and figures/fov-*.svg into a folder."""
    tree = run(scenario, quick, progress)
    result = page(tree, scenario, command)
    result.write(out, tree)
    return result
