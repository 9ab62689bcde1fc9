"""The page of `mantis risk`: the thesis's places in the matrix beside measured ones, and why they differ."""

from __future__ import annotations

from experiments.reporting.blocks import Plot, Plots, Section
from experiments.reporting.formatting import listed
from experiments.reporting.page import Page
from experiments.thesis.claims import claims_section
from experiments.thesis.risk.figures import matrix
from experiments.thesis.risk.study import MAJOR_DEG, MAJOR_RANGE, RiskResult, modes
from experiments.thesis.risk.tables import claims, percent_text, places_table

ABOUT = (
    "Section 8.3 of the thesis names five failure modes and puts each, by judgement, into a matrix of likelihood (table 8.3) and "
    "severity (table 8.2): figure 8.14 before mitigation, figure 8.17 after. Here the modes are counted on the frames of the "
    "virtual experiment, the emulated physical one and the glare study: before by the thesis's pipeline, after by this project's "
    "detector on the same frames. ‘Part’ is one mitigation alone.",
    "For figure 8.14 ‘right’ is the level counted with the thesis's pipeline. For figure 8.17 it is the level of this project's "
    "detector where it does worst, and ‘reproduced’ is the level of ‘part’.",
)
LIMITS = (
    "Table 8.3 has three levels: below 1 in 10, 1 in 40 and 1 in 100. A more frequent mode has no level and is drawn above. "
    "‘Likelihood at most’ is the level of the interval's upper end: with a few hundred frames no mode can be shown to be rarer "
    "than 1 in 100 with certainty unless there are more than 368 and it never comes.",
    "Intervals are Clopper and Pearson's at 95 %, as if frames were independent; neighbours of a sweep are not quite, so true "
    "intervals are wider.",
    "Severity: no pose is 3, as in table 8.2, and so is a false positive, as the thesis has it. Of a mode that leaves a pose it "
    f"is 2 where its frames' median error is beyond {MAJOR_DEG:g}° or {100 * MAJOR_RANGE:g} % of the range (assumption: this "
    "project's requirement), else 1; where no such frame is there, or the table does not keep errors, it is the thesis's own "
    "level.",
    "Wrong corners before mitigation are those of a search in a window, which figure 8.16 of the thesis shows. The refinement "
    "that its listing names gives other counts: they are in the studies' own tables.",
    "The thesis's mitigations include several markers and a navigation filter. Here they do not: after is one marker and single "
    "frames, or a pair of frames where sunlight comes from the side.",
    "False positives are counted in the frames' middles about the marker; whole frames, with the marker and without, are "
    "searched in the glare and the features study.",
    "Rates hold for the frames of these studies, tilts up to 45° and ranges to where bits fade, and not for a mission's. The "
    "thesis states no other failure modes; total loss of the chaser's navigation, which it mentions, is not rated there and not "
    "here.",
)


def page(result: RiskResult, command: str) -> Page:
    """What the risk study says.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
    """
    caption = (
        "Risk matrix: the thesis's places and measured ones, before (open) and after (filled) mitigation, by mode."
    )
    return Page(
        study="risk",
        title="Failure modes and risk",
        headline=headline(result),
        passed=_improves(result),
        command=command,
        about=ABOUT,
        findings=(*findings(result), *result.missing),
        sections=(
            claims_section(claims(result), terminal=False),
            Section("matrix", "Risk matrix", (Plots((Plot("matrix", matrix(result), caption),)),)),
            Section("places", "Mode by mode", (places_table(result),), wordy=True),
        ),
        limits=LIMITS,
        data=result.dataset,
    )


def _improves(result: RiskResult) -> bool:
    """Whether no mode is more likely after than before anywhere."""
    return all(
        place.rate.value <= result.places[source, "before", mode].rate.value
        for (source, stage, mode), place in result.places.items()
        if stage == "after" and (source, "before", mode) in result.places
    )


def headline(result: RiskResult) -> str:
    """One sentence: how many modes are above the thesis's likelihood, and where mitigation brings them."""
    judged = {mode["name"]: mode["before"][0] for mode in modes()}
    likelier = {
        mode
        for (_, stage, mode), place in result.places.items()
        if stage == "before" and place.likelihood > judged[mode]
    }
    worse = [mode["title"] for mode in modes() if mode["name"] in likelier]
    after = [place for (_, stage, _), place in result.places.items() if stage == "after"]
    down = sum(place.likelihood == 1 for place in after)
    return (
        f"By the thesis's pipeline {listed(worse) if worse else 'no mode'} {'is' if len(worse) == 1 else 'are'} more frequent "
        f"somewhere than the thesis judged; after mitigation {down} of {len(after)} rates are below 1 in 100."
    )


def findings(result: RiskResult) -> list[str]:
    """A sentence a mode."""
    lines = []
    for k, mode in enumerate(modes(), 1):
        parts = []
        for source in result.sources:
            before, after = (result.places.get((source["name"], stage, mode["name"])) for stage in ("before", "after"))
            if before is not None and after is not None:
                parts.append(f"{source['title']} {percent_text(before)} → {percent_text(after)}")
        lines.append(f"{k}, {mode['title']}: {'; '.join(parts) or 'not known'}. After: {mode['here']}.")
    return lines
