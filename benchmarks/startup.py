"""How long the command line takes to start."""

from __future__ import annotations

import subprocess
import sys

from benchmarks.rows import Row, best_seconds

TITLE = "Starting"
TEXT = "`mantis --help` from start to end, the shortest of ten; in brackets what an empty Python takes."


def run(quick: bool) -> list[Row]:
    """Seconds of a whole process."""
    repeats = 3 if quick else 10

    def process(*arguments: str) -> float:
        command = [sys.executable, *arguments]
        return best_seconds(lambda: subprocess.run(command, check=True, capture_output=True), repeats)

    help_s = process("-c", "import sys; from experiments.cli.main import main; sys.exit(main(['--help']))")
    return [Row("mantis --help", help_s, "s", "≤ 0.3"), Row("python -c pass", process("-c", "pass"), "s")]
