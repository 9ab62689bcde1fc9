"""The page of `mantis requirements`: which requirements are met, and where the thesis says otherwise."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.reporting.blocks import Plot, Plots, Section, Table, text_table
from experiments.reporting.page import Page
from experiments.thesis.requirements.figures import margins
from experiments.thesis.requirements.study import RequirementsResult, Verified

ABOUT = (
    "The thesis states 14 system requirements (section 3.6) and 9 stakeholder requirements (section 3.4), and verifies them in "
    "tables 8.4 and 8.5. Here each has a verification function that reads this project's own results and answers met, not met, "
    "or not verifiable here. What is verified is the thesis's system; what would meet a requirement that it misses is said "
    "beside it.",
)
LIMITS = (
    "The subject is the thesis's system: its largest marker and layouts on a 1 m face, its camera and its LEDs.",
    "Texts of the requirements are ours; the thesis's wording is in its sections 3.4 and 3.6.",
    "A stakeholder requirement counts as met when its system requirements are; whether they cover it is the thesis's matter.",
    "Figure 3.6, to which SYS-REQ-4 refers, is not in print as numbers: its curves are those of the Monte Carlo recomputed.",
    "SYS-REQ-5 has no number: 5° between frames is taken. The processing time is this machine's.",
)


def page(result: RequirementsResult, command: str) -> Page:
    """What the verification says.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
    """
    system = result.of_the_system
    count = {verdict: sum(v.finding.verdict == verdict for v in system) for verdict in ("met", "not met")}
    failing = [v for v in system if v.finding.verdict == "not met"]
    differing = [v.requirement.identity for v in result.verified if not v.agrees]
    headline = (
        f"Of {len(system)} system requirements {count['met']} are met, {count['not met']} not met and "
        f"{len(system) - count['met'] - count['not met']} not verifiable here."
    )
    plot = Plot("margins", margins(result.verified), "Margins of the requirements that have a number.")
    return Page(
        study="requirements",
        title="Requirements of the thesis, verified",
        headline=headline,
        passed=not failing,
        command=command,
        about=ABOUT,
        findings=(
            f"Not met: {', '.join(v.requirement.identity for v in failing) or 'none'}.",
            f"The thesis says otherwise of {', '.join(differing) or 'none'}.",
            *(f"{v.requirement.identity}: {v.finding.figure}." for v in failing),
        ),
        sections=(
            Section("margins", "Margins", (Plots((plot,)),)),
            Section("requirements", "Requirement by requirement", (requirements_table(result.verified),), wordy=True),
        ),
        limits=LIMITS,
        data=result.dataset,
        unmet={"met": headline} if failing else {},
    )


def requirements_table(verified: Sequence[Verified]) -> Table:
    """Every requirement: what the thesis says, and what is found here."""
    heading = ("requirement", "asks", "thesis", "here", "figure", "command", "would meet it", "why the thesis differs")
    rows = [heading]
    for v in verified:
        asked, found = v.requirement, v.finding
        verdicts = (asked.identity, asked.text, asked.printed, found.verdict)
        rows.append((*verdicts, found.figure, found.command, found.remedy, v.remark))
    return text_table(
        rows,
        "Every requirement: what the thesis says, and what is found here",
        key="requirements",
        terminal=True,
        terminal_columns=(0, 2, 3, 4),
    )
