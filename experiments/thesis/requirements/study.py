"""Every requirement verified, beside the thesis's tables 8.4 and 8.5, with each disagreement explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario
from experiments.thesis.requirements.catalogue import Requirement, Verdict, catalogue
from experiments.thesis.requirements.checks import CHECKS, Finding
from experiments.thesis.requirements.evidence import Evidence, Missing
from experiments.thesis.requirements.plan import FULL, Plan


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


@dataclass(frozen=True)
class RequirementsResult:
    """Every requirement with its verdict.

    Attributes:
        verified: system requirements first, as in the catalogue.
        dataset: verdicts, margins and agreement by requirement.
    """

    verified: tuple[Verified, ...]
    dataset: xr.Dataset

    @property
    def of_the_system(self) -> tuple[Verified, ...]:
        """The system requirements, each with a verification of its own."""
        return tuple(v for v in self.verified if not v.requirement.children)


def run(scenario: Scenario, plan: Plan = FULL, progress: Progress | None = None) -> RequirementsResult:
    """Verify every requirement from the results in a folder.

    Args:
        scenario: the system that is verified: camera, marker, LEDs and requirement.
        plan: where the results are.
        progress: not used; the work takes seconds.

    Raises:
        ValueError: when there is no such folder.
    """
    if not plan.results.is_dir():
        raise ValueError(f"--results {plan.results}: no such folder; expected one with tables, as docs/data")
    verified = verify(Evidence(plan.results, scenario))
    return RequirementsResult(verified, _dataset(verified, scenario))


def verify(evidence: Evidence) -> tuple[Verified, ...]:
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
    return tuple(result)


def follows(requirement: Requirement, done: Mapping[str, Finding]) -> Finding:
    """A stakeholder requirement from its system requirements: not met where one is not, met where all are."""
    groups: dict[Verdict, list[str]] = {"not met": [], "not verifiable here": [], "met": []}
    for child in requirement.children:
        groups[done[child].verdict].append(child)
    verdict: Verdict = next(v for v, names in groups.items() if names)
    figure = "; ".join(f"{v}: {', '.join(names)}" for v, names in groups.items() if names)
    missing = verdict == "not verifiable here" and any(done[child].missing for child in requirement.children)
    return Finding(verdict, figure, "mantis requirements", missing=missing)


def _dataset(verified: Sequence[Verified], scenario: Scenario) -> xr.Dataset:
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
    return xr.Dataset(data, {"requirement": names}, chain.provenance(scenario))
