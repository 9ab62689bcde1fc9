"""Every requirement verified, beside the thesis's tables 8.4 and 8.5, with each disagreement explained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments.reporting.claims import StudyPage
from experiments.reporting.figures import BLACK, BLUE, VERMILION, new_figure
from experiments.scenario import Scenario
from experiments.thesis.requirements.catalogue import Requirement, Verdict, catalogue
from experiments.thesis.requirements.checks import CHECKS, Finding
from experiments.thesis.requirements.evidence import Evidence, Missing


@dataclass(frozen=True)
class Verified:
    """A requirement and what its verification came to."""

    requirement: Requirement
    finding: Finding

    @property
    def agrees(self) -> bool:
        """Whether the thesis comes to the same verdict; a finding without its results contradicts nothing."""
        return self.finding.missing or self.requirement.agrees(self.finding.verdict)

    @property
    def remark(self) -> str:
        """Why verdict or reason differ from the thesis's."""
        return "" if self.finding.missing else self.requirement.remark(self.finding.verdict)


def verify(evidence: Evidence) -> list[Verified]:
    """Every requirement of the catalogue: system requirements by their own functions, stakeholders' from their children."""
    done: dict[str, Finding] = {}
    result = []
    for requirement in catalogue():
        if requirement.children:
            finding = follows(requirement, done)
        else:
            try:
                finding = CHECKS[requirement.identity](evidence)
            except Missing as missing:
                finding = Finding("not verifiable here", str(missing), "", missing=True)
        done[requirement.identity] = finding
        result.append(Verified(requirement, finding))
    return result


def follows(requirement: Requirement, done: Mapping[str, Finding]) -> Finding:
    """A stakeholder requirement from its system requirements: not met where one is not, met where all are."""
    groups: dict[Verdict, list[str]] = {"not met": [], "not verifiable here": [], "met": []}
    for child in requirement.children:
        groups[done[child].verdict].append(child)
    verdict: Verdict = next(v for v, names in groups.items() if names)
    figure = "; ".join(f"{v}: {', '.join(names)}" for v, names in groups.items() if names)
    missing = verdict == "not verifiable here" and any(done[child].missing for child in requirement.children)
    return Finding(verdict, figure, "mantis requirements", missing=missing)


def rows(verified: list[Verified]) -> list[tuple[str, ...]]:
    """Heading, then one row a requirement."""
    heading = ("requirement", "asks", "thesis", "here", "figure", "command", "would meet it", "why the thesis differs")
    lines: list[tuple[str, ...]] = [heading]
    for v in verified:
        r, f = v.requirement, v.finding
        lines.append((r.identity, r.text, r.printed, f.verdict, f.figure, f.command, f.remedy, v.remark))
    return lines


def dataset(verified: list[Verified]) -> xr.Dataset:
    """Verdicts, margins and agreement by requirement."""
    names = [v.requirement.identity for v in verified]
    texts = {
        "verdict": [v.finding.verdict for v in verified],
        "printed": [v.requirement.printed for v in verified],
        "figure": [v.finding.figure for v in verified],
        "command": [v.finding.command for v in verified],
    }
    data: dict[str, Any] = {key: ("requirement", np.array(values, dtype=str)) for key, values in texts.items()}
    about = {"units": "1", "long_name": "factor by which it is met"}
    data["margin"] = ("requirement", [v.finding.margin for v in verified], about)
    data["agrees"] = ("requirement", [v.agrees for v in verified])
    return xr.Dataset(data, {"requirement": names})


def margins(verified: list[Verified]) -> Any:
    """Margins of the requirements that have one."""
    having = [v for v in verified if np.isfinite(v.finding.margin)]
    figure, axes = new_figure(size_in=(6.4, 0.9 + 0.36 * max(len(having), 1)))
    axis = axes[0, 0]
    for k, v in enumerate(having):
        colour = BLUE if v.finding.verdict == "met" else VERMILION
        axis.plot([1, v.finding.margin], [k, k], color=colour, lw=3, solid_capstyle="butt")
        axis.plot(v.finding.margin, k, "o", color=colour, ms=6)
        left = v.finding.margin < 1
        axis.annotate(
            f"×{v.finding.margin:.3g}, {v.finding.verdict}", (v.finding.margin, k), xytext=(-7 if left else 7, -3),
            textcoords="offset points", fontsize=8, ha="right" if left else "left",
        )  # fmt: skip
    axis.axvline(1, color=BLACK, lw=0.8)
    axis.set_yticks(range(len(having)), [v.requirement.identity for v in having])
    axis.set(xscale="log", xlabel="margin: factor by which the figure meets the requirement", xlim=(0.05, 40))
    axis.set_ylim(len(having) - 0.5, -0.6)
    axis.grid(axis="y", visible=False)
    return figure


def page(verified: list[Verified], command: str) -> StudyPage:
    """Everything that is written."""
    system = [v for v in verified if not v.requirement.children]
    count = {
        verdict: sum(v.finding.verdict == verdict for v in system)
        for verdict in ("met", "not met", "not verifiable here")
    }
    failing = [v.requirement.identity for v in system if v.finding.verdict == "not met"]
    differing = [v.requirement.identity for v in verified if not v.agrees]
    headline = (
        f"Of 14 system requirements {count['met']} are met, {count['not met']} not met and "
        f"{count['not verifiable here']} not "
        "verifiable here."
    )
    answers = [
        f"Not met: {', '.join(failing) or 'none'}.",
        f"The thesis says otherwise of {', '.join(differing) or 'none'}.",
    ]
    answers += [f"{v.requirement.identity}: {v.finding.figure}." for v in system if v.finding.verdict == "not met"]
    return StudyPage(
        name="requirements",
        title="Requirements of the thesis, verified",
        headline=headline,
        passed=not failing,
        answers=answers,
        statements=[],
        tables={"requirements": rows(verified)},
        table_captions={"requirements": "Every requirement: what the thesis says, and what is found here"},
        plots={"margins": margins(verified)},
        captions={"margins": "Margins of the requirements that have a number"},
        about=ABOUT,
        short=("requirements",),
        limits=LIMITS,
        command=command,
    )


ABOUT = (
    "The thesis states 14 system requirements (section 3.6) and 9 stakeholder requirements (section 3.4), and "
    "verifies them in tables "
    "8.4 and 8.5. Here each has a verification function that reads this project's own results and answers met, not "
    "met, or not "
    "verifiable here. What is verified is the thesis's system; what would meet a requirement that it misses is said "
    "beside it.",
)
LIMITS = (
    "The subject is the thesis's system: its largest marker and layouts on a 1 m face, its camera and its LEDs.",
    "Texts of the requirements are ours; the thesis's wording is in its sections 3.4 and 3.6.",
    "A stakeholder requirement counts as met when its system requirements are; whether they cover it is the "
    "thesis's matter.",
    "Figure 3.6, to which SYS-REQ-4 refers, is not in print as numbers: its curves are those of the Monte Carlo "
    "recomputed.",
    "SYS-REQ-5 has no number: 5° between frames is taken. The processing time is this machine's.",
)


def study(scenario: Scenario, results: Path, out: Path, command: str) -> StudyPage:
    """Verify and write requirements.nc, report.html, data/requirements-*.csv and the figure into a folder."""
    verified = verify(Evidence(results, scenario))
    result = page(verified, command)
    result.write(out, dataset(verified))
    return result
