"""What the layout study says: printed, reproduced, right; tables, figures and the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from experiments import chain
from experiments.reporting.claims import Statement, StudyPage
from experiments.reporting.formatting import listed, ranges_text
from experiments.scenario import Scenario
from experiments.thesis.layout import figures
from experiments.thesis.layout.placement import (
    AREA_SHARE_MAX,
    FARTHEST_M,
    LAYOUTS,
    SIDE_SHARE_MAX,
    TEXT_AREA_M2,
    THESIS_LAYOUTS,
    THICKNESS_MAX_M,
    Kind,
    layout,
    most_markers,
    seen_share,
    smallest_face_m,
)
from experiments.thesis.layout.study import Progress, exposure, posed, run
from scenes.face import render_face
from scenes.render.transport import Quality

#: Frames that are shown: layout, side of its face and range [m], pitch, yaw and roll [deg].
_SHOWN: tuple[tuple[Kind, float, float, tuple[float, float, float]], ...] = (
    ("wide", 1.0, 1.0, (10.0, -15.0, 5.0)),
    ("wide", 1.0, 5.0, (20.0, -15.0, 30.0)),
    ("narrow", 1.0, 5.0, (20.0, -15.0, 30.0)),
    ("nested", 2.0, 5.0, (20.0, -15.0, 30.0)),
)


def views(scenario: Scenario, rays: int, shown: slice = slice(None)) -> list[tuple[str, NDArray[np.uint16]]]:
    """Rendered frames with noise, LEDs alone, with their titles."""
    frames = []
    for kind, face_m, range_m, angles_deg in _SHOWN[shown]:
        lay = layout(kind, face_m, "scaled", scenario.marker)
        here = posed(scenario, lay, range_m, np.radians(angles_deg))
        basis = render_face(chain.view(here), lay.placed, Quality(scenario.render.frame_samples, rays, scenario.seed))
        rate = chain.electron_rate(here, basis, "eclipse")
        frame = chain.expose(here, rate, "eclipse", exposure(here, lay)).dn
        frames.append((f"{kind}, {face_m:g} m face, {range_m:g} m", frame))
    return frames


def footprint_rows(scenario: Scenario, faces_m: tuple[float, ...]) -> list[tuple[str, ...]]:
    """Heading, then one row a layout and face: markers, largest side, areas, both rules, thickness against SYS-REQ-14."""
    rows: list[tuple[str, ...]] = [
        ("layout", "face [m]", "markers", "largest [m]", "over face [%]", "SYS-REQ-6", "area [m²]", "area over face [%]",
         "SYS-REQ-7", "thickness [mm]", "SYS-REQ-14 (10 ± 5 mm)"),
    ]  # fmt: skip
    for name, (kind, sizing) in LAYOUTS.items():
        for face_m in faces_m:
            lay = layout(kind, face_m, sizing, scenario.marker)
            thick = 1e3 * max(p.design.thickness_m for p in lay.placed)
            rules = (lay.side_share <= SIDE_SHARE_MAX * (1 + 1e-9), lay.area_share <= AREA_SHARE_MAX * (1 + 1e-9),
                     thick <= 1e3 * THICKNESS_MAX_M)  # fmt: skip
            six, seven, fourteen = ("met" if rule else "not met" for rule in rules)
            largest = max(p.design.size_m for p in lay.placed)
            rows.append(
                (name, f"{face_m:g}", str(len(lay.placed)), f"{largest:.3g}", f"{100 * lay.side_share:.3g}", six,
                 f"{lay.area_m2:.3g}", f"{100 * lay.area_share:.3g}", seven, f"{thick:.3g}", fourteen)
            )  # fmt: skip
    return rows


def count_rows(counts: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a layout, face and range."""
    rows: list[tuple[str, ...]] = [
        ("layout", "face_m", "range_m", "whole_squarely", "usable_squarely", "whole_mean", "usable_mean", "usable_least",
         "attitudes_without_percent"),
    ]  # fmt: skip
    for name in counts.layout.values:
        for face_m in counts.face_m.values:
            for range_m in counts.range_m.values:
                at = counts.sel(layout=name, face_m=face_m, range_m=range_m)
                cells = (at.whole, at.usable, at.whole_mean, at.usable_mean, at.usable_least, 100 * at.none)
                rows.append((str(name), f"{face_m:g}", f"{range_m:g}", *(f"{float(v):.4g}" for v in cells)))
    return rows


def pose_rows(rendered: xr.Dataset) -> list[tuple[str, ...]]:
    """Heading, then one row a case and range: frames, found, and median errors of one marker and of all, with the gain."""
    rows: list[tuple[str, ...]] = [
        ("layout", "range [m]", "frames", "usable", "found", "frames with a pose",
         "attitude, one [deg]", "attitude, all [deg]", "gain", "range, one [mm]", "range, all [mm]", "lateral, one [mm]",
         "lateral, all [mm]", "error over predicted, all"),
    ]  # fmt: skip
    for name, here in figures.cases(rendered):
        for range_m in np.unique(here.range_m.values):
            at = here.isel(frame=np.flatnonzero(here.range_m.values == range_m))
            solved = np.isfinite(at.attitude_deg.sel(solver="all markers").values)
            medians = {
                key: [float(at[key].sel(solver=s).median()) if solved.any() else np.nan for s in at.solver.values]
                for key in ("attitude_deg", "range_error_m", "lateral_error_m")
            }
            one, every = medians["attitude_deg"]
            every_at = at.sel(solver="all markers")
            square = (every_at.attitude_deg**2).mean() / (every_at.attitude_predicted_deg**2).mean()
            millimetres = [_number(1e3 * v) for key in ("range_error_m", "lateral_error_m") for v in medians[key]]
            rows.append(
                (name, f"{range_m:g}", str(at.sizes["frame"]), f"{float(at.usable.mean()):.2g}", f"{float(at.found.mean()):.2g}",
                 str(int(solved.sum())), _number(one), _number(every), f"×{one / every:.2g}" if every > 0 else "–", *millimetres,
                 _number(float(np.sqrt(square))))
            )  # fmt: skip
    return rows


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"


def _always_usable_m(counts: xr.Dataset, name: str, face_m: float) -> str:
    """Ranges at which every attitude has a usable marker, as text."""
    at = counts.sel(layout=name, face_m=face_m)
    grid = [float(r) for r in at.range_m.values]
    return ranges_text(grid, [r for r in grid if float(at.none.sel(range_m=r)) == 0])


def statements(tree: xr.DataTree, scenario: Scenario) -> list[Statement]:
    """Section 6.1 and what 8.4 makes of it."""
    counts = tree["counts"].to_dataset()
    lay = layout("wide", 1.0, "scaled", scenario.marker)
    px = scenario.requirement.px_per_bit_min
    one = counts.sel(layout="wide scaled", face_m=1.0)
    first, last = one.isel(range_m=0), one.isel(range_m=-1)
    bit = lay.placed[0].design.bit_m
    reach = bit * min(scenario.camera.focal_px) / px
    largest = counts.sel(layout="wide scaled", face_m=counts.face_m[-1])
    ranges = largest.range_m.values
    always = ranges[largest.none.values == 0]
    nan, farthest = float("nan"), float(counts.face_m[-1])
    return [
        Statement("section 6.1", "largest marker on a 1 m face, SYS-REQ-6", "m", "0.1", SIDE_SHARE_MAX, SIDE_SHARE_MAX),
        Statement("section 6.1", "area of all markers on it, SYS-REQ-7", "m²", "0.025", TEXT_AREA_M2, AREA_SHARE_MAX,
                  "5 % of 1 m² is 0.05 m²; the text halves it"),
        Statement("section 6.1", "area of the wide and of the narrow layout", "m²", "", lay.area_m2, lay.area_m2,
                  "exactly SYS-REQ-7's limit, twice the text's"),
        Statement("section 6.1", "markers of 10 cm that the area allows", "", "", most_markers(SIDE_SHARE_MAX, TEXT_AREA_M2),
                  most_markers(SIDE_SHARE_MAX), "reproduced with the text's area"),
        Statement("section 6.1", "markers wholly in view at 1 m, seen squarely", "", "", nan, float(first.whole),
                  "‘enough points at short range’: right"),
        Statement("section 6.1", "the same, fewest over ±45° and any roll", "", "", nan, float(first.usable_least)),
        Statement("section 8.4", "markers used at 20 m on a 1 m face", "", "8", float(len(lay.placed)), float(last.usable),
                  f"a bit of the 10 cm marker has {bit * min(scenario.camera.focal_px) / 20:.2g} px there, {px:g} "
                  f"are needed"),
        Statement("section 8.4", "range to which a 10 cm marker is resolved, seen squarely", "m", "20", 20.0, reach),
        Statement("SYS-REQ-6", "smallest face whose marker is resolved at 20 m", "m", "", nan,
                  smallest_face_m(20.0, scenario.camera, scenario.marker, px), "the thesis: 1 m"),
        Statement("SYS-REQ-11", f"nearest range with a usable marker at every attitude, scaled to {farthest:g} m",
                  "m", "1", nan, float(always.min()) if len(always) else nan, "the scaled inner markers leave the frame"),
        Statement("SYS-REQ-14", f"thickness of the marker scaled to a {farthest:g} m face", "mm", "", nan,
                  1e3 * largest_thickness(scenario, farthest), "10 ± 5 mm are allowed: at most 2.7 m faces"),
        Statement("section 6.1", "directions within 45° of a marked face, four faces of a cube", "%", "", nan,
                  100 * seen_share(4),
                  "two faces 29 %, all six 88 %"),
    ]  # fmt: skip


def largest_thickness(scenario: Scenario, face_m: float) -> float:
    """Thickness of the largest marker of the scaled layout [m]."""
    return max(p.design.thickness_m for p in layout("wide", face_m, "scaled", scenario.marker).placed)


def answers(tree: xr.DataTree) -> tuple[str, ...]:
    """What the study finds, a sentence each."""
    counts, rendered = tree["counts"].to_dataset(), tree["rendered"].to_dataset()
    faces = counts.face_m.values
    said = [
        "The text's 0.025 m² contradicts SYS-REQ-7, which allows 0.05 m² on 1 m: both of the thesis's layouts use "
        "exactly 0.05 m².",
        "Every attitude within ±45° has a usable marker: "
        + "; ".join(
            f"{name} on {f:g} m at {_always_usable_m(counts, name, f)}"
            for name, f in (
                ("wide scaled", faces[0]),
                ("wide scaled", faces[-1]),
                ("nested", faces[0]),
                ("nested", faces[-1]),
            )
        )
        + ".",
    ]
    rows = pose_rows(rendered)[1:]
    posed = {}
    for row in rows:
        if row[2] == row[5]:
            posed[row[0]] = f"{float(row[1]):g}"
    if posed:
        ends = listed([f"{name}: {range_m} m" for name, range_m in posed.items()])
        said.append(
            f"Every rendered frame gives a pose up to {ends}, of the ranges tried: this detector needs somewhat less than the "
            "two pixels a bit by which markers are counted."
        )
    gains = [float(r[8][1:]) for r in rows if r[8] != "–" and float(r[4]) >= 2]
    if gains:
        said.append(
            f"The pose from all markers has {min(gains):.2g} to {max(gains):.2g} times less attitude error than the "
            "surest marker alone (medians, case by case, where at least two are found on average)."
        )
    return tuple(said)


def page(tree: xr.DataTree, scenario: Scenario, shown: list[tuple[str, NDArray[np.uint16]]], command: str) -> StudyPage:
    """Everything that is written."""
    counts, rendered = tree["counts"].to_dataset(), tree["rendered"].to_dataset()
    faces = tuple(float(f) for f in counts.face_m.values)
    missing = counts.none.sel(range_m=counts.range_m[counts.range_m <= FARTHEST_M]).max("range_m")
    covered = [f for f in faces if float(missing.sel(layout="nested", face_m=f)) == 0]
    ok = bool((missing.sel(layout=list(THESIS_LAYOUTS)) == 0).any())
    which = "A" if ok else "No"
    headline = f"{which} layout of the thesis has a usable marker at every attitude from 1 to {FARTHEST_M:g} m"
    if covered:
        headline += f"; a ladder of rings has, on faces of {listed([f'{f:g}' for f in covered])} m"
    return StudyPage(
        name="layout",
        title="System layout: several markers on one face",
        headline=headline + ".",
        passed=ok,
        answers=answers(tree),
        statements=statements(tree, scenario),
        tables={
            "footprint": footprint_rows(scenario, faces),
            "pose": pose_rows(rendered),
            "counts": count_rows(counts),
        },
        table_captions={
            "footprint": "Footprint of every layout",
            "pose": "Pose of the face by rendering: medians over attitudes and noise draws",
            "counts": "Markers in view: squarely, and over attitudes within ±45°, any roll",
        },
        plots={
            "placement": figures.placement([layout("wide", 1.0), layout("narrow", 1.0), layout("nested", 2.0)]),
            "cover": figures.cover(counts),
            "views": figures.views(shown),
            "pose": figures.pose(rendered),
        },
        captions=figures.CAPTIONS,
        about=ABOUT,
        short=("footprint", "pose"),
        limits=LIMITS,
        command=command,
        scenario=scenario,
    )


ABOUT = (
    "Section 6.1 of the thesis puts eight markers on a 1 m face, four of 10 cm and four of 5 cm, widely or narrowly "
    "spread, and "
    "section 8.4 takes it that all 44 features are seen at every range. This page checks the footprint rules, "
    "counts what a camera "
    "sees and resolves from 1 to 20 m on faces of 1 to 10 m, and measures the pose of the whole face from rendered "
    "frames.",
    "A layout is *scaled* (all of it grows with the face), *fixed* (the 1 m face's markers, outer ones moved out) "
    "or *graded* (outer "
    "markers grow, inner ones stay). *Nested* is this project's: rings of markers, each twice the one inside it, "
    "the largest as large as SYS-REQ-6 and SYS-REQ-14 allow.",
)
LIMITS = (
    "Figure 6.1 gives no figures: the narrow layout's outer markers stand at ±0.2 of the face (assumption), the "
    "wide one's where listing "
    "A.4 has them.",
    "The face's centre is on the optical axis, as the thesis has it; the approach to a marker off the centre is "
    "another study.",
    "A marker is usable when it is wholly in the frame and a bit has two pixels along its shorter side; whether its "
    "blobs are in "
    "their field of view is `mantis fov`. Where one is decoded, the known layout could guide the search for others; "
    "it does not here.",
    "Each marker is rendered by itself and put into the frame: front planes are coplanar, so nothing shades "
    "another; light "
    "reflected from one to another is left out.",
    "The layout is known exactly; how well markers are placed on a real face is not modelled.",
)


def study(
    scenario: Scenario, out: Path, command: str, quick: bool = False, progress: Progress | None = None
) -> StudyPage:
    """Run and write layout.nc (groups counts, rendered), report.html, data/layout*.csv and figures/layout-*.svg into a folder."""
    tree = run(scenario, quick, progress)
    shown = views(scenario, 60_000 if quick else 500_000, slice(1, 2) if quick else slice(None))
    result = page(tree, scenario, shown, command)
    result.write(out, tree)
    return result
