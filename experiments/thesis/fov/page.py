"""What the field-of-view study says: printed, reproduced, right and measured; tables, figures and the page."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from detector.elements.blobs import MAX_CUT_FRACTION
from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.page import Page
from experiments.thesis.claims import Claim, claims_section
from experiments.thesis.fov import closed_form, figures
from experiments.thesis.fov.study import FovResult
from radiometry import field_of_view as fov
from scenes.marker import ELEMENT_NAMES

Row = tuple[str, ...]

NAN = float("nan")
#: Share of a cell's frames that counts as found.
FOUND = 0.99
#: Angles between sight line and normal for which the share of directions is told [deg].
TILTS_DEG = (30.0, 40.0, 45.0, 50.0, 60.0)


def tilt_deg(data: xr.Dataset) -> xr.DataArray:
    """Angle between the marker's normal and the line of sight over the map's grid [deg]."""
    return np.degrees(np.arccos(np.cos(np.radians(data.pitch_deg)) * np.cos(np.radians(data.yaw_deg))))


def cone_rows(data: xr.Dataset) -> list[Row]:
    """Heading, then for each range and tilt the share of the grid's directions up to it with each kind of feature."""
    headings = (
        "range [m]",
        "tilt up to [deg]",
        "directions",
        "corners [%]",
        "virtual point [%]",
        "pose [%]",
        "attitude error, largest median [deg]",
    )
    rows: list[Row] = [headings]
    tilt = tilt_deg(data)
    for range_m in data.range_m.values:
        at = data.sel(range_m=range_m)
        for limit in TILTS_DEG:
            inside = tilt <= limit + 1e-9
            shares = [100 * float((at[n] >= FOUND).where(inside).mean()) for n in ("corners", "virtual", "pose")]
            worst = float(at.attitude_deg.where(inside).max())
            cells = (f"{v:.1f}" for v in shares)
            rows.append((f"{range_m:g}", f"{limit:g}", str(int(inside.sum())), *cells, f"{worst:.3g}"))
    return rows


def map_rows(data: xr.Dataset) -> list[Row]:
    """Heading, then one row a range, pitch and yaw."""
    elements = [str(name) for name in data.element.values]
    rows: list[Row] = [("range_m", "pitch_deg", "yaw_deg", "corners", "virtual", "pose", *elements, "attitude_deg")]
    for range_m in data.range_m.values:
        for pitch in data.pitch_deg.values:
            for yaw in data.yaw_deg.values:
                at = data.sel(range_m=range_m, pitch_deg=pitch, yaw_deg=yaw)
                shares = (at.corners, at.virtual, at.pose, *at.blob.values)
                cells = [f"{float(v):g}" for v in shares]
                rows.append((f"{range_m:g}", f"{pitch:g}", f"{yaw:g}", *cells, f"{float(at.attitude_deg):.4g}"))
    return rows


def cut_rows(data: xr.Dataset) -> list[Row]:
    """Heading, then one row a yaw and element."""
    rows: list[Row] = [("yaw_deg", "element", "light", "centroid_error_mm", "found")]
    for yaw in data.yaw_deg.values:
        for name in data.element.values:
            at = data.sel(yaw_deg=yaw, element=name)
            light, centroid_mm, found = (float(v) for v in (at.light, 1e3 * at.centroid_m, at.found))
            rows.append((f"{yaw:g}", str(name), f"{light:.4f}", f"{centroid_mm:.4f}", f"{found:g}"))
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
            seen = {name: closed_form.seen(limits, name, a * angles, b * angles) for name in ELEMENT_NAMES}
            everywhere &= (seen["top"] | seen["bottom"]) & (seen["right"] | seen["left"])
    first = int(np.argmin(everywhere)) if not everywhere.all() else len(angles)
    return float(np.degrees(angles[first - 1])) if first else 0.0


def claims(result: FovResult) -> list[Claim]:
    """Section 5.6 equation by equation, and what section 8.1 makes of it."""
    return [*_element_claims(result), *_marker_claims(result), *_lateral_claims(result), *_diagonal_claims(result)]


def _degrees(angle_rad: float) -> float:
    return float(np.degrees(angle_rad))


def _claim(where: str, what: str, printed: str, reproduced_rad: float, right_rad: float, remark: str = "") -> Claim:
    """A claim about an angle, told in degrees."""
    return Claim(where, what, "deg", printed, _degrees(reproduced_rad), _degrees(right_rad), remark=remark)


def _element_claims(result: FovResult) -> Iterator[Claim]:
    """Equations 5.17 and 5.18 with the margin that a blob needs."""
    marker = result.scenario.marker
    found, measured = closed_form.limits(marker), measured_sides(result.cut)
    sides, margin = found.sides, closed_form.THESIS_MARGIN_RAD
    length, depth = 1.0, marker.virtual_depth_fraction
    yield _claim(
        "eq. 5.17",
        "field of an element with its line in the middle",
        "",
        fov.one_sided_field(length, depth),
        fov.centred_field(length, depth),
        remark="as printed it is the field with the line under one end",
    )
    yield _claim("eq. 5.18", "field of an element, near side", "26.6", sides.near, sides.near)
    yield _claim("eq. 5.18", "field of an element, far side", "56.3", sides.far, sides.far)
    yield _claim("eq. 5.18", "field of an element", "82.9", sum(sides), sum(sides))
    yield _claim(
        "section 5.6",
        "margin on the near side",
        "18",
        margin,
        sides.near - found.found.near,
        remark="a blob needs one margin in length; in angle it differs from side to side",
    )
    yield _claim(
        "section 5.6",
        "margin on the far side",
        "18",
        margin,
        sides.far - found.found.far,
        remark=f"{found.margin_share:.2g} of the element's length: {100 * MAX_CUT_FRACTION:g} % of the blob beyond the end",
    )
    yield _claim("section 5.6", "field of an element with margin", "46.9", sum(found.thesis), sum(found.found))
    yield _claim(
        "section 5.6",
        "the same, in rendered frames",
        "46.9",
        sum(found.thesis),
        sum(measured),
        remark="steps of 1 deg",
    )


def _marker_claims(result: FovResult) -> Iterator[Claim]:
    """Equation 5.19: two opposite elements together."""
    found, measured = closed_form.limits(result.scenario.marker), measured_sides(result.cut)
    yield _claim(
        "section 5.6",
        "overlap of two opposite elements",
        "17.2",
        2 * found.thesis.near,
        2 * found.found.near,
        remark="17.2 is made from 8.6, rounded",
    )
    yield _claim(
        "eq. 5.19",
        "longitudinal field of the marker",
        "76.6",
        found.printed_marker,
        found.marker,
        remark=f"printed: ±38.3 deg, less than SYS-REQ-1 asks; right: ±{_degrees(found.marker) / 2:.1f} deg",
    )
    yield _claim(
        "eq. 5.19",
        "the same, in rendered frames",
        "76.6",
        found.printed_marker,
        fov.combined_field(measured),
        remark="steps of 1 deg",
    )


def _lateral_claims(result: FovResult) -> Iterator[Claim]:
    """The field across an element."""
    found, across_deg = closed_form.limits(result.scenario.marker), min(_reach(result.cut, "right"))
    yield _claim(
        "section 5.6",
        "lateral field of an element",
        "100",
        NAN,
        2 * found.lateral,
        remark="straight walls, a tenth of the floor's width left; the thesis estimates, for walls cut away",
    )
    yield Claim(
        "section 5.6", "the same, in rendered frames", "deg", "100", NAN, 2 * across_deg, remark="steps of 1 deg"
    )


def _diagonal_claims(result: FovResult) -> Iterator[Claim]:
    """Equation 5.20 and test 7 of section 8.1: pitch and yaw together."""
    found, data = closed_form.limits(result.scenario.marker), result.map
    lateral, along = closed_form.THESIS_LATERAL_RAD, found.thesis.far
    yield _claim(
        "eq. 5.20",
        "equal pitch and yaw on the ellipse, far side",
        "",
        fov.equal_angles(lateral, along),
        fov.equal_angles(lateral / 2, along),
        remark="its lateral semi-axis is a full field; right here: half of it",
    )
    yield _claim(
        "section 8.1, test 7",
        "equal pitch and yaw to which a virtual point exists",
        "35",
        fov.equal_angles(lateral, along),
        np.radians(_diagonal_here(found)),
        remark="a rectangle in slopes, no ellipse in angles",
    )
    for range_m in (float(data.range_m[0]), float(data.range_m[-1])):
        yield Claim(
            "section 8.1, test 7",
            f"the same, found in noisy frames at {range_m:g} m",
            "deg",
            "35",
            NAN,
            equal_reach(data.virtual, range_m),
            remark="by this project's detector; steps of 5 deg",
        )


def findings(result: FovResult) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    found = closed_form.limits(result.scenario.marker)
    half, printed = np.degrees(found.marker) / 2, np.degrees(found.printed_marker) / 2
    far = np.degrees(found.sides.far - found.found.far)
    rows = {(row[0], row[1]): row for row in cone_rows(result.map)[1:]}
    rendered = []
    for range_m in result.map.range_m.values:
        at = rows[f"{range_m:g}", "45"]
        rendered.append(
            f"At {range_m:g} m corners are found in {at[3]} % and a virtual point in {at[4]} % of all directions up to 45 deg "
            f"off the normal; the largest median attitude error there is {at[6]} deg."
        )
    return (
        f"Along an element the marker sees ±{half:.1f} deg, not ±{printed:.1f} deg. The thesis takes 18 deg off either side, but "
        f"a blob needs the same length on both, and that is {far:.1f} deg on the far side.",
        "Over pitch and yaw together the field is no ellipse: one limit holds for the slope along an element and another for "
        "the slope across it, so the field is a rectangle in tangents.",
        *rendered,
    )


def page(result: FovResult, command: str) -> Page:
    """The page of the study."""
    cone = cone_rows(result.map)
    least = min(float(row[4]) for row in cone[1:] if row[1] == "45")
    met = least >= 100.0
    where = "everywhere" if met else f"in {least:.0f} % of the directions at the worst range"
    tables = (
        text_table(cone, "Share of directions with features, by the angle off the normal", key="cone", terminal=True),
        text_table(
            map_rows(result.map), "Share of frames with each feature over pitch and yaw", key="map", inline=False
        ),
        text_table(cut_rows(result.cut), "One cut over yaw, no pitch", key="cut", inline=False),
    )
    return Page(
        study="fov",
        title="Field of view of element and marker",
        headline=f"Up to 45 deg off the normal a virtual point is found {where}.",
        passed=met,
        command=command,
        sections=(
            claims_section(claims(result)),
            Section("figures", "Figures", _plots(result)),
            Section("tables", "Tables", tables, wordy=True),
        ),
        findings=findings(result),
        about=ABOUT,
        limits=LIMITS,
        scenario=result.scenario,
        data=result.data,
    )


def _plots(result: FovResult) -> tuple[Plots, ...]:
    marker, ring_m = result.scenario.marker, result.scenario.leds.ring_radius_m
    drawn = {
        "marker": figures.marker_maps(result.map, marker),
        "element": figures.element_map(result.map, marker),
        "cut": figures.cut(result.cut, marker, float(result.map.range_m[0]), ring_m),
    }
    return tuple(Plots((Plot(key, plot, figures.CAPTIONS[key]),)) for key, plot in drawn.items())


ABOUT = (
    "Section 5.6 of the thesis gives the field of view of an encoding element and of the marker in equations 5.17 to 5.20, with "
    "margins that it estimates. This page recomputes them, derives what they should be for a blob of finite width, and holds "
    "both against rendered frames over pitch and yaw.",
    "An element of length w has its virtual line at a depth V behind the face and at a distance d from the near end. The blob "
    "lies at V·tan θ from the line's foot, so every limit is one of slope: `radiometry/field_of_view.py`.",
)
LIMITS = (
    "The thesis's element has side walls cut to an anvil's profile, whose dimensions are not given. Here they are straight, so "
    "the lateral field found here is a lower bound for the thesis's design.",
    "LEDs alone, automatic exposure at every tilt, tape of Type XI with its entrance-angle fall-off as far as its table goes.",
    "There are four noise draws a cell. Where all four succeed, a single cell's share is at least 47 % with 95 % confidence, and "
    "no more can be said of it; the cells of a region say it together.",
    "Roll turns the picture and not the marker's field of view; it is zero here.",
)
