"""The decision problem of a command line: a file of the user's, or the thesis's chapter 4."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from experiments.thesis.tradeoff.ahp import DecisionProblem, load_problem

THESIS_PROBLEM = Path(__file__).parent / "thesis.toml"


@dataclass(frozen=True)
class ProblemFile:
    """A decision problem, the text of its file, and whether it is the thesis's own."""

    problem: DecisionProblem
    text: str
    is_thesis: bool


def load(source: str | None = None, overrides: tuple[str, ...] = (), seed: int | None = None) -> ProblemFile:
    """Read a decision problem. It has no keys to override, and nothing in it is random.

    Args:
        source: path of a TOML file; None for the thesis's problem.
        overrides: not used.
        seed: not used.

    Raises:
        ValueError: one line that names the key, where the file is not a valid problem.
        OSError: where it cannot be read.
    """
    path = THESIS_PROBLEM if source is None else Path(source)
    return ProblemFile(load_problem(path), path.read_text(encoding="utf-8"), source is None)
