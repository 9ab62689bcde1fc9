"""What the layout study says: printed, reproduced, right; tables, figures and the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from experiments.reporting.blocks import Plot, Plots, Section, text_table
from experiments.reporting.formatting import listed, ranges_text
from experiments.reporting.page import Page
from experiments.scenario import Scenario
from experiments.thesis.claims import Claim, claims_section
from experiments.thesis.layout import figures
from experiments.thesis.layout.placement import (
    AREA_SHARE_MAX,
    FARTHEST_M,
    LAYOUTS,
    SIDE_SHARE_MAX,
    TEXT_AREA_M2,
    THESIS_LAYOUTS,
    THICKNESS_MAX_M,
    layout,
    most_markers,
    seen_share,
    smallest_face_m,
)
from experiments.thesis.layout.study import SOLVERS, LayoutResult

Row = tuple[str, ...]

NAN = float("nan")
_MEDIANS = ("attitude_deg", "range_error_m", "lateral_error_m")


@dataclass(frozen=True)
class PoseSummary:
    """Rendered frames of one layout at one range.

    Attributes:
        name: of the layout and its face.
        range_m: of the frames.
        frames: their number.
        usable, found: mean number of markers that are counted as usable, and that are found.
        solved: frames with a pose.
        one, all: medians of attitude error [deg], range error and lateral error [m], of the surest marker alone and of all.
        over_predicted: attitude error from all markers over its predicted deviation, both rms.
    """

    name: str
    range_m: float
    frames: int
    usable: float
    found: float
    solved: int
    one: tuple[float, ...]
    all: tuple[float, ...]
    over_predicted: float

    @property
    def gain(self) -> float:
        """Attitude error of the surest marker over that of all; NaN where there is none."""
        return self.one[0] / self.all[0] if self.all[0] > 0 else NAN

    @property
    def cells(self) -> Row:
        """Cells under `POSE_HEADINGS`."""
        millimetres = [1e3 * values[k] for k in (1, 2) for values in (self.one, self.all)]
        return (
            self.name,
            f"{self.range_m:g}",
            str(self.frames),
            f"{self.usable:.2g}",
            f"{self.found:.2g}",
            str(self.solved),
            _number(self.one[0]),
            _number(self.all[0]),
            f"×{self.gain:.2g}" if np.isfinite(self.gain) else "–",
            *map(_number, millimetres),
            _number(self.over_predicted),
        )


POSE_HEADINGS: Row = (
    "layout",
    "range [m]",
    "frames",
    "usable",
    "found",
    "frames with a pose",
    "attitude, one [deg]",
    "attitude, all [deg]",
    "gain",
    "range, one [mm]",
    "range, all [mm]",
    "lateral, one [mm]",
    "lateral, all [mm]",
    "error over predicted, all",
)


def pose_summaries(rendered: xr.Dataset) -> list[PoseSummary]:
    """One summary for each rendered layout and range."""
    return [
        _summary(name, float(range_m), here.isel(frame=np.flatnonzero(here.range_m.values == range_m)))
        for name, here in figures.cases(rendered)
        for range_m in np.unique(here.range_m.values)
    ]


def _summary(name: str, range_m: float, at: xr.Dataset) -> PoseSummary:
    from_all = at.sel(solver="all markers")
    solved = np.isfinite(from_all.attitude_deg.values)
    one, every = (
        tuple(float(at[key].sel(solver=s).median()) if solved.any() else NAN for key in _MEDIANS) for s in SOLVERS
    )
    square = (from_all.attitude_deg**2).mean() / (from_all.attitude_predicted_deg**2).mean()
    return PoseSummary(
        name=name,
        range_m=range_m,
        frames=at.sizes["frame"],
        usable=float(at.usable.mean()),
        found=float(at.found.mean()),
        solved=int(solved.sum()),
        one=one,
        all=every,
        over_predicted=float(np.sqrt(square)),
    )


def pose_rows(rendered: xr.Dataset) -> list[Row]:
    """Heading, then one row a case and range: frames, found, and median errors of one marker and of all, with the gain."""
    return [POSE_HEADINGS, *(summary.cells for summary in pose_summaries(rendered))]


def footprint_rows(scenario: Scenario, faces_m: tuple[float, ...]) -> list[Row]:
    """Heading, then one row a layout and face: markers, largest side, areas, both rules, thickness against SYS-REQ-14."""
    headings = (
        "layout",
        "face [m]",
        "markers",
        "largest [m]",
        "over face [%]",
        "SYS-REQ-6",
        "area [m²]",
        "area over face [%]",
        "SYS-REQ-7",
        "thickness [mm]",
        "SYS-REQ-14 (10 ± 5 mm)",
    )
    rows: list[Row] = [headings]
    for name, (kind, sizing) in LAYOUTS.items():
        for face_m in faces_m:
            lay = layout(kind, face_m, sizing, scenario.marker)
            thick_mm = 1e3 * max(p.design.thickness_m for p in lay.placed)
            rows.append(
                (
                    name,
                    f"{face_m:g}",
                    str(len(lay.placed)),
                    f"{max(p.design.size_m for p in lay.placed):.3g}",
                    f"{100 * lay.side_share:.3g}",
                    _met(lay.side_share <= SIDE_SHARE_MAX * (1 + 1e-9)),
                    f"{lay.area_m2:.3g}",
                    f"{100 * lay.area_share:.3g}",
                    _met(lay.area_share <= AREA_SHARE_MAX * (1 + 1e-9)),
                    f"{thick_mm:.3g}",
                    _met(thick_mm <= 1e3 * THICKNESS_MAX_M),
                )
            )
    return rows


def _met(rule: bool) -> str:
    return "met" if rule else "not met"


def count_rows(counts: xr.Dataset) -> list[Row]:
    """Heading, then one row a layout, face and range."""
    headings = (
        "layout",
        "face_m",
        "range_m",
        "whole_squarely",
        "usable_squarely",
        "whole_mean",
        "usable_mean",
        "usable_least",
        "attitudes_without_percent",
    )
    rows: list[Row] = [headings]
    for name in counts.layout.values:
        for face_m in counts.face_m.values:
            for range_m in counts.range_m.values:
                at = counts.sel(layout=name, face_m=face_m, range_m=range_m)
                cells = (at.whole, at.usable, at.whole_mean, at.usable_mean, at.usable_least, 100 * at.none)
                rows.append((str(name), f"{face_m:g}", f"{range_m:g}", *(f"{float(v):.4g}" for v in cells)))
    return rows


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"


def claims(result: LayoutResult) -> list[Claim]:
    """Section 6.1, and what section 8.4 and the requirements make of it."""
    return [*_footprint_claims(result), *_view_claims(result)]


def _footprint_claims(result: LayoutResult) -> list[Claim]:
    area_m2 = layout("wide", 1.0, "scaled", result.scenario.marker).area_m2
    within_text = most_markers(SIDE_SHARE_MAX, TEXT_AREA_M2)
    return [
        Claim("section 6.1", "largest marker on a 1 m face, SYS-REQ-6", "m", "0.1", SIDE_SHARE_MAX, SIDE_SHARE_MAX),
        Claim(
            where="section 6.1",
            what="area of all markers on it, SYS-REQ-7",
            unit="m²",
            printed="0.025",
            reproduced=TEXT_AREA_M2,
            right=AREA_SHARE_MAX,
            remark="5 % of 1 m² is 0.05 m²; the text halves it",
        ),
        Claim(
            where="section 6.1",
            what="area of the wide and of the narrow layout",
            unit="m²",
            printed="",
            reproduced=area_m2,
            right=area_m2,
            remark="exactly SYS-REQ-7's limit, twice the text's",
        ),
        Claim(
            where="section 6.1",
            what="markers of 10 cm that the area allows",
            unit="",
            printed="",
            reproduced=within_text,
            right=most_markers(SIDE_SHARE_MAX),
            remark="reproduced with the text's area",
        ),
    ]


def _view_claims(result: LayoutResult) -> list[Claim]:
    scenario, counts = result.scenario, result.counts
    lay, px = layout("wide", 1.0, "scaled", scenario.marker), scenario.requirement.px_per_bit_min
    bit_m, focal_px = lay.placed[0].design.bit_m, min(scenario.camera.focal_px)
    one = counts.sel(layout="wide scaled", face_m=1.0)
    first, last = one.isel(range_m=0), one.isel(range_m=-1)
    farthest = float(counts.face_m[-1])
    largest = counts.sel(layout="wide scaled", face_m=farthest)
    always = largest.range_m.values[largest.none.values == 0]
    return [
        Claim(
            where="section 6.1",
            what="markers wholly in view at 1 m, seen squarely",
            unit="",
            printed="",
            reproduced=NAN,
            right=float(first.whole),
            remark="‘enough points at short range’: right",
        ),
        Claim("section 6.1", "the same, fewest over ±45° and any roll", "", "", NAN, float(first.usable_least)),
        Claim(
            where="section 8.4",
            what="markers used at 20 m on a 1 m face",
            unit="",
            printed="8",
            reproduced=float(len(lay.placed)),
            right=float(last.usable),
            remark=f"a bit of the 10 cm marker has {bit_m * focal_px / 20:.2g} px there, {px:g} are needed",
        ),
        Claim(
            where="section 8.4",
            what="range to which a 10 cm marker is resolved, seen squarely",
            unit="m",
            printed="20",
            reproduced=20.0,
            right=bit_m * focal_px / px,
        ),
        Claim(
            where="SYS-REQ-6",
            what="smallest face whose marker is resolved at 20 m",
            unit="m",
            printed="",
            reproduced=NAN,
            right=smallest_face_m(20.0, scenario.camera, scenario.marker, px),
            remark="the thesis: 1 m",
        ),
        Claim(
            where="SYS-REQ-11",
            what=f"nearest range with a usable marker at every attitude, scaled to {farthest:g} m",
            unit="m",
            printed="1",
            reproduced=NAN,
            right=float(always.min()) if len(always) else NAN,
            remark="the scaled inner markers leave the frame",
        ),
        Claim(
            where="SYS-REQ-14",
            what=f"thickness of the marker scaled to a {farthest:g} m face",
            unit="mm",
            printed="",
            reproduced=NAN,
            right=1e3 * max(p.design.thickness_m for p in layout("wide", farthest, "scaled", scenario.marker).placed),
            remark="10 ± 5 mm are allowed: at most 2.7 m faces",
        ),
        Claim(
            where="section 6.1",
            what="directions within 45° of a marked face, four faces of a cube",
            unit="%",
            printed="",
            reproduced=NAN,
            right=100 * seen_share(4),
            remark="two faces 29 %, all six 88 %",
        ),
    ]


def findings(result: LayoutResult) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    faces = result.counts.face_m.values
    shown = [(name, float(faces[k])) for name in ("wide scaled", "nested") for k in (0, -1)]
    always = [f"{name} on {face_m:g} m at {_always_usable_m(result.counts, name, face_m)}" for name, face_m in shown]
    found = [
        "The text's 0.025 m² contradicts SYS-REQ-7, which allows 0.05 m² on 1 m: both of the thesis's layouts use "
        "exactly 0.05 m².",
        f"Every attitude within ±45° has a usable marker: {'; '.join(always)}.",
    ]
    summaries = pose_summaries(result.rendered)
    farthest_m = {s.name: s.range_m for s in summaries if s.solved == s.frames}
    if farthest_m:
        ends = listed([f"{range_m:g} m ({name})" for name, range_m in farthest_m.items()])
        found.append(
            f"Of the ranges tried, every rendered frame gives a pose up to {ends}: this detector needs somewhat less than the "
            f"{result.scenario.requirement.px_per_bit_min:g} pixels a bit by which markers are counted as usable."
        )
    gains = [s.gain for s in summaries if np.isfinite(s.gain) and s.found >= 2]
    if gains:
        low, high = f"{min(gains):.2g}", f"{max(gains):.2g}"
        found.append(
            f"The pose from all markers has {low if low == high else f'{low} to {high}'} times less attitude error than the "
            "surest marker alone (medians, case by case, where at least two are found on average)."
        )
    return tuple(found)


def _always_usable_m(counts: xr.Dataset, name: str, face_m: float) -> str:
    """Ranges at which every attitude has a usable marker, as text."""
    at = counts.sel(layout=name, face_m=face_m)
    grid = [float(r) for r in at.range_m.values]
    return ranges_text(grid, [r for r in grid if float(at.none.sel(range_m=r)) == 0])


def page(result: LayoutResult, command: str) -> Page:
    """The page of the study."""
    scenario, counts = result.scenario, result.counts
    faces = tuple(float(f) for f in counts.face_m.values)
    missing = counts.none.sel(range_m=counts.range_m[counts.range_m <= FARTHEST_M]).max("range_m")
    covered = [f"{f:g}" for f in faces if float(missing.sel(layout="nested", face_m=f)) == 0]
    thesis_covers = bool((missing.sel(layout=list(THESIS_LAYOUTS)) == 0).any())
    which = "A" if thesis_covers else "No"
    headline = f"{which} layout of the thesis has a usable marker at every attitude from 1 to {FARTHEST_M:g} m"
    if covered:
        headline += f"; nested rings of markers have one on faces of {listed(covered)} m"
    tables = (
        text_table(footprint_rows(scenario, faces), "Footprint of every layout", key="footprint"),
        text_table(
            pose_rows(result.rendered),
            "Pose of the face by rendering: medians over attitudes and noise draws",
            key="pose",
        ),
        text_table(
            count_rows(counts),
            "Markers in view: squarely, and over attitudes within ±45°, any roll",
            key="counts",
            inline=False,
        ),
    )
    return Page(
        study="layout",
        title="System layout: several markers on one face",
        headline=headline + ".",
        passed=thesis_covers,
        command=command,
        sections=(
            claims_section(claims(result)),
            Section("figures", "Figures", _plots(result)),
            Section("tables", "Tables", tables, wordy=True),
        ),
        findings=findings(result),
        about=ABOUT,
        limits=LIMITS,
        scenario=scenario,
        data=result.data,
    )


def _plots(result: LayoutResult) -> tuple[Plots, ...]:
    placed = [layout("wide", 1.0), layout("narrow", 1.0), layout("nested", 2.0)]
    drawn = {
        "placement": figures.placement(placed),
        "cover": figures.cover(result.counts),
        "views": figures.views(result.frames),
        "pose": figures.pose(result.rendered),
    }
    return tuple(Plots((Plot(key, plot, figures.CAPTIONS[key]),)) for key, plot in drawn.items())


ABOUT = (
    "Section 6.1 of the thesis puts eight markers on a 1 m face, four of 10 cm and four of 5 cm, widely or narrowly spread. "
    "Section 8.4 takes it that all 44 features are seen at every range. This page checks the footprint rules, counts what a "
    "camera sees and resolves from 1 to 20 m on faces of 1 to 10 m, and measures the pose of the whole face from rendered "
    "frames.",
    "A layout is *scaled* (all of it grows with the face), *fixed* (the markers of the 1 m face, the outer ones moved out) or "
    "*graded* (the outer markers grow, the inner ones stay). *Nested* is this project's own layout: rings of markers, each twice "
    "as large as the one inside it, the largest as large as SYS-REQ-6 and SYS-REQ-14 allow.",
)
LIMITS = (
    "Figure 6.1 gives no numbers: the narrow layout's outer markers stand at ±0.2 of the face (assumption), the wide one's "
    "where listing A.4 has them.",
    "The face's centre is on the optical axis, as the thesis has it; the approach to a marker off the centre is another study.",
    "A marker is usable when it is wholly in the frame and a bit has two pixels along its shorter side. Whether its blobs are in "
    "their field of view is the subject of `mantis fov`. Where one marker is decoded, the known layout could guide the "
    "search for others; that is not done here.",
    "Each marker is rendered by itself and put into the frame: the front planes are coplanar, so none shades another. Light "
    "reflected from one marker to another is left out.",
    "The layout is known exactly; how well markers are placed on a real face is not modelled.",
)
