"""The requirements of `catalogue.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

Verdict = Literal["met", "not met", "not verifiable here"]

#: What the thesis's words come to. Its 'partially' is no fulfilment.
PRINTED: dict[str, Verdict] = {"Yes": "met", "Partially": "not met", "T.B.C.": "not verifiable here"}


@dataclass(frozen=True)
class Requirement:
    """One requirement in our own words.

    Attributes:
        identity: such as 'SYS-REQ-1'.
        where: section of the thesis.
        text: what is asked.
        parent, criticality, method: of a system requirement; empty for a stakeholder's.
        children: system requirements from which a stakeholder's follows.
        printed, printed_why: verdict and reason in the thesis's tables 8.4 and 8.5.
        differs: why this project comes to another verdict or reason.
        other_reason: the verdict may be the same, the reason is not.
    """

    identity: str
    where: str
    text: str
    printed: str
    printed_why: str
    differs: str
    parent: str = ""
    criticality: str = ""
    method: str = ""
    children: tuple[str, ...] = ()
    other_reason: bool = False

    def agrees(self, verdict: Verdict) -> bool:
        """Whether the thesis comes to the same verdict."""
        return PRINTED[self.printed] == verdict

    def remark(self, verdict: Verdict) -> str:
        """Why verdict or reason differ from the thesis's; empty where neither does."""
        return self.differs if self.other_reason or not self.agrees(verdict) else ""


def catalogue() -> tuple[Requirement, ...]:
    """Every requirement, system requirements first.

    Raises:
        ValueError: for a verdict that is none of the thesis's words, or a child that does not exist.
    """
    text = (files("experiments") / "thesis" / "requirements" / "catalogue.toml").read_text(encoding="utf-8")
    found = []
    for entry in tomllib.loads(text)["requirement"]:
        children = tuple(entry.pop("children", ()))
        found.append(Requirement(identity=entry.pop("id"), children=children, **entry))
    known = {r.identity for r in found}
    for r in found:
        if r.printed not in PRINTED:
            raise ValueError(f"{r.identity}.printed: {r.printed!r}, expected one of {', '.join(PRINTED)}")
        if not set(r.children) <= known:
            raise ValueError(f"{r.identity}.children: {', '.join(sorted(set(r.children) - known))} unknown")
    return tuple(found)
