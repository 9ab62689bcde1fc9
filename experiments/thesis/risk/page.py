"""The risk matrix told: thesis's places, measured ones before and after mitigation, and why they differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Plot

from experiments.reporting.claims import Statement, StudyPage
from experiments.reporting.figures import BLACK, BLUE, VERMILION, new_figure
from experiments.reporting.formatting import listed, number
from experiments.studies.shared.failures import MODES
from experiments.thesis.risk.study import (
    MAJOR_DEG,
    MAJOR_RANGE,
    STAGES,
    Place,
    Places,
    catalogue,
    dataset,
    level,
    places,
)

NAN = float("nan")
#: Levels of likelihood drawn: the thesis's three, and what is beyond.
_LEVELS = 4
_ROWS = {1: "1: < 1 in 100", 2: "2: < 1 in 40", 3: "3: < 1 in 10", 4: "more often:\nno level"}

CAPTION = "Risk matrix: the thesis's places and measured ones, before (open) and after (filled) mitigation, by mode"
ABOUT = (
    "Section 8.3 of the thesis names five failure modes and puts each, by judgement, into a matrix of likelihood (table 8.3) and "
    "severity (table 8.2): figure 8.14 before mitigation, figure 8.17 after. Here the modes are counted on the frames of the "
    "virtual experiment, the emulated physical one and the glare study: before by the thesis's pipeline, after by this project's "
    "detector on the same frames. *Part* is one mitigation alone.",
    "Of figure 8.14 *right* is the level counted with the thesis's pipeline; of figure 8.17 it is this project's "
    "where it does worst, "
    "and *reproduced* is *part*.",
)
HEADINGS = (
    "failure", "frames", "stage", "failed", "of", "rate [%]", "95 % [%]", "likelihood", "likelihood at most", "severity",
    "error [°]", "range error [%]", "thesis: likelihood, severity", "against the thesis",
)  # fmt: skip


def study(folders: Sequence[Path], out: Path, command: str) -> StudyPage:
    """Read the tables, place the modes, and write risk.nc, risk.md, report.html, data/risk*.csv and figures/risk-matrix.svg.

    Raises:
        ValueError: when no table is there, or one cannot be read.
    """
    found, missing = places(folders)
    page = study_page(found, missing, command)
    page.write(out, dataset(found))
    return page


def study_page(found: Places, missing: Sequence[str], command: str) -> StudyPage:
    """The page as data."""
    return StudyPage(
        "risk", "Failure modes and risk", headline(found), _improves(found), [*answers(found), *missing], statements(found),
        {"places": rows(found)}, {"places": "Every failure mode over every study's frames"}, {"matrix": matrix(found)},
        {"matrix": CAPTION},
        limits(), command, about=ABOUT, short=("places",),
    )  # fmt: skip


def _modes() -> list[dict[str, Any]]:
    return list(catalogue()["mode"])


def _sources(found: Places) -> list[dict[str, Any]]:
    """Sources that are there."""
    return [source for source in catalogue()["source"] if any(key[0] == source["name"] for key in found)]


def _improves(found: Places) -> bool:
    """Whether no mode is more likely after than before anywhere."""
    return all(
        place.rate.value <= found[source, "before", mode].rate.value
        for (source, stage, mode), place in found.items()
        if stage == "after" and (source, "before", mode) in found
    )


def headline(found: Places) -> str:
    """One sentence: how many modes are above the thesis's likelihood, and where mitigation brings them."""
    sources = _sources(found)
    worse = [
        mode["title"]
        for mode in _modes()
        if any(
            (here := found.get((s["name"], "before", mode["name"]))) is not None and here.likelihood > mode["before"][0]
            for s in sources
        )
    ]
    lowest = [place for (_, stage, _), place in found.items() if stage == "after"]
    down = sum(place.likelihood == 1 for place in lowest)
    return (
        f"By the thesis's pipeline {listed(worse) if worse else 'no mode'} {'is' if len(worse) == 1 else 'are'} more frequent "
        f"somewhere than the thesis judged; after mitigation {down} of {len(lowest)} rates are below 1 in 100."
    )


def answers(found: Places) -> list[str]:
    """A sentence a mode."""
    lines = []
    for k, mode in enumerate(_modes(), 1):
        parts = [
            f"{source['title']} {_percent(before)} → {_percent(after)}"
            for source in _sources(found)
            if (before := found.get((source["name"], "before", mode["name"]))) is not None
            and (after := found.get((source["name"], "after", mode["name"]))) is not None
        ]
        lines.append(f"{k}, {mode['title']}: {'; '.join(parts) or 'not told'}. After: {mode['here']}.")
    return lines


def _percent(place: Place) -> str:
    value = place.rate.value
    return f"{number(100 * value)} %" if value else f"0 (at most {number(100 * place.rate.interval[1])} %)"


def statements(found: Places) -> list[Statement]:
    """Likelihood levels of figure 8.14 beside the thesis's pipeline on every study's frames, and of figure 8.17 beside this
    project's detector where it does worst; there, reproduced is one mitigation alone."""
    said = []
    for k, mode in enumerate(_modes(), 1):
        for source in _sources(found):
            before = found.get((source["name"], "before", mode["name"]))
            if before is not None:
                what = f"likelihood level of {mode['title']}, {source['title']}"
                said.append(
                    Statement(
                        f"fig. 8.14, {k}",
                        what,
                        "level",
                        str(mode["before"][0]),
                        NAN,
                        before.likelihood,
                        _against(before, mode, "before", source),
                    )
                )
    for k, mode in enumerate(_modes(), 1):
        worst = [found[key] for key in found if key[1] == "after" and key[2] == mode["name"]]
        part = [found[key] for key in found if key[1] == "part" and key[2] == mode["name"]]
        if worst:
            highest = max(worst, key=lambda place: (place.rate.value, place.rate.interval[1]))
            said.append(
                Statement(
                    f"fig. 8.17, {k}",
                    f"likelihood level of {mode['title']}, worst of all",
                    "level",
                    str(mode["after"][0]),
                    max((p.likelihood for p in part), default=NAN),
                    highest.likelihood,
                    f"thesis: {mode['mitigation']}; here: {mode['here']}. {_percent(highest)} of the frames at worst, "
                    f"95 % surely level {_level(highest.proven)} or less",
                )
            )
    return said


def _against(place: Place, mode: dict[str, Any], stage: str, source: dict[str, Any]) -> str:
    """How a measured place stands to the thesis's, and why."""
    printed = mode["before" if stage == "before" else "after"]
    if stage == "part":
        return source.get("part_title", "")
    words = []
    if place.likelihood > printed[0]:
        why = mode["higher"] if stage == "before" else source.get("after_why", f"{_percent(place)} of the frames")
        words.append(f"likelier: {why}")
    elif place.likelihood < printed[0]:
        words.append("rarer" + (f": {mode['lower']}" if stage == "before" and mode["lower"] else ""))
    if not np.isnan(place.error_deg) and place.severity != printed[1] and stage == "before":
        words.append(
            f"severity {place.severity}: its frames are off by {number(place.error_deg)}° and "
            f"{number(100 * place.range_error)} % of "
            f"the range; major is beyond {MAJOR_DEG:g}° or {100 * MAJOR_RANGE:g} %"
        )
    return "; ".join(words) or "agrees"


def rows(found: Places) -> list[tuple[str, ...]]:
    """`HEADINGS`, then one row a mode, source and stage."""
    lines: list[tuple[str, ...]] = [HEADINGS]
    for k, mode in enumerate(_modes(), 1):
        for source in _sources(found):
            for stage in STAGES:
                place = found.get((source["name"], stage, mode["name"]))
                if place is None:
                    continue
                low, high = (number(100 * end) for end in place.rate.interval)
                printed = {"before": mode["before"], "after": mode["after"]}.get(stage)
                lines.append(
                    (
                        f"{k} {mode['title']}",
                        source["title"],
                        stage,
                        str(place.rate.failed),
                        str(place.rate.frames),
                        number(100 * place.rate.value),
                        f"{low}–{high}",
                        _level(place.likelihood),
                        _level(place.proven),
                        str(place.severity),
                        number(place.error_deg),
                        number(100 * place.range_error),
                        "–" if printed is None else f"{printed[0]}, {printed[1]}",
                        _against(place, mode, stage, source),
                    )
                )
    return lines


def _level(value: int) -> str:
    return str(value) if value < _LEVELS else "above 3"


def matrix(found: Places) -> Plot:
    """The thesis's matrix and one of each study's frames, every mode from before to after."""
    sources = _sources(found)
    panels: list[tuple[str, dict[str, dict[str, tuple[int, int]]]]] = [
        (
            "the thesis's judgement (figures 8.14, 8.17)",
            {m["name"]: {stage: tuple(m[stage]) for stage in ("before", "after")} for m in _modes()},
        )
    ]
    for source in sources:
        measured = {
            mode: {
                stage: (place.likelihood, place.severity)
                for stage in ("before", "after")
                if (place := found.get((source["name"], stage, mode))) is not None
            }
            for mode in MODES
        }
        panels.append((source["title"], measured))
    columns = 3
    plot, axes = new_figure(-(-len(panels) // columns), columns, (9.6, 3.4 * -(-len(panels) // columns)))
    for axis, (title, placed) in zip(axes.ravel(), panels, strict=False):
        _panel(axis, title, placed)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    last = axes.ravel()[0]
    handles = [
        last.plot([], [], "o", ms=9, mfc="white", mec=VERMILION, label="before: the thesis's pipeline")[0],
        last.plot([], [], "o", ms=9, mfc=BLUE, mec=BLUE, label="after: this project's detector (thesis: as proposed)")[
            0
        ],
    ]
    names = [f"{k} {mode['title']}" for k, mode in enumerate(_modes(), 1)]
    handles += [last.plot([], [], ls="none", label=name)[0] for name in names]
    plot.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8)
    return plot


def _panel(axis: Any, title: str, placed: dict[str, dict[str, tuple[int, int]]]) -> None:
    shade = np.add.outer(np.arange(_LEVELS), np.arange(3))
    axis.imshow(
        shade, cmap="Greys", vmin=-1, vmax=14, origin="lower", extent=(0.5, 3.5, 0.5, _LEVELS + 0.5), aspect="auto"
    )
    for k, mode in enumerate(MODES):
        # A slot of its own in every cell, so that modes and stages do not lie on each other.
        across = -0.4 + 0.2 * k
        spots = {
            stage: (at[1] + across, at[0] + (0.2 if stage == "before" else -0.2)) for stage, at in placed[mode].items()
        }
        if len(spots) == 2:
            arrow = {"arrowstyle": "->", "color": BLACK, "lw": 0.7, "shrinkA": 6, "shrinkB": 6}
            axis.annotate("", spots["after"], spots["before"], arrowprops=arrow, zorder=1)
        for stage, (x, y) in spots.items():
            filled = stage == "after"
            axis.plot(x, y, "o", ms=10, mfc=BLUE if filled else "white", mec=BLUE if filled else VERMILION, mew=1.3)
            axis.text(
                x, y, str(k + 1), color="white" if filled else BLACK, fontsize=7.5, ha="center", va="center_baseline"
            )
    axis.set(xlim=(0.5, 3.5), ylim=(0.5, _LEVELS + 0.5), xlabel="severity level", xticks=[1, 2, 3])
    axis.set_yticks(range(1, _LEVELS + 1), [_ROWS[k] for k in range(1, _LEVELS + 1)], fontsize=7.5)
    axis.hlines(np.arange(1.5, _LEVELS + 0.5), 0.5, 3.5, color="white", lw=1)
    axis.vlines([1.5, 2.5], 0.5, _LEVELS + 0.5, color="white", lw=1)
    axis.grid(visible=False)
    axis.set_title(title, fontsize=8)


def limits() -> list[str]:
    """How levels are read, and what the rates are rates of."""
    assert level(0.5) == _LEVELS
    return [
        "Table 8.3 has three levels: below 1 in 10, 1 in 40 and 1 in 100. A more frequent mode has no level in it; "
        "it is drawn above. "
        "*Likelihood at most* is the level of the interval's upper end: with a few hundred frames no mode can be "
        "shown to be rarer "
        "than 1 in 100 with certainty unless there are more than 368 and it never comes.",
        "Intervals are Clopper and Pearson's at 95 %, as if frames were independent; neighbours of a sweep are not "
        "quite, so true "
        "intervals are wider.",
        "Severity: no pose is 3, as in table 8.2, and so is a false positive, as the thesis has it. Of a mode that "
        "leaves a pose it is 2 "
        f"where its frames' median error is beyond {MAJOR_DEG:g}° or {100 * MAJOR_RANGE:g} % of the range "
        "(assumption: this project's "
        "requirement), else 1; where no such frame is there, or the table does not keep errors, it is the thesis's own level.",
        "Wrong corners before mitigation are those of a search in a window, which figure 8.16 of the thesis shows. "
        "The refinement that "
        "its listing names gives other counts: they are in the studies' own tables.",
        "The thesis's mitigations include several markers and a navigation filter. Here they do not: after is one "
        "marker and single "
        "frames, or a pair of frames in sunlight from aside.",
        "False positives are counted in the frames' middles about the marker; whole frames, with the marker and "
        "without, are searched in "
        "the glare and the features study.",
        "Rates hold for the frames of these studies, tilts up to 45° and ranges to where bits fade, and not for a "
        "mission's. The thesis "
        "states no other failure modes; total loss of the chaser's navigation, which it mentions, is not rated "
        "there and not here.",
    ]
