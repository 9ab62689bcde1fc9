"""Runs peers in processes of their own: in the interpreter of MANTIS_PEERS_PYTHON, else of `.venv-peers`, else in this one.

Their packages (the extra `bench`) bring hundreds of megabytes and scores of others along, so they may live apart:
``python3.11 -m venv .venv-peers && .venv-peers/bin/pip install bpy pyxel-sim galsim prysm``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.rows import ROOT


@cache
def interpreter() -> str:
    """Path of the Python that has the peers."""
    apart = ROOT / ".venv-peers" / "bin" / "python"
    return os.environ.get("MANTIS_PEERS_PYTHON") or (str(apart) if apart.is_file() else sys.executable)


@cache
def version(distribution: str) -> str | None:
    """Version of a peer's distribution, or None where it is not installed."""
    code = f"from importlib.metadata import version; print(version({distribution!r}))"
    done = subprocess.run([interpreter(), "-c", code], capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else None


def run_script(script: str, request: dict[str, Any], timeout_s: float = 300) -> Any:
    """Answer of a script of this folder to a request, both as JSON: the last line that it prints.

    Raises:
        RuntimeError: with the script's last words, when it fails.
    """
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [interpreter(), "-P", str(Path(__file__).with_name(script))],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env={**os.environ, **single, "PYTHONPATH": ""},
    )
    if done.returncode != 0:
        lines = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        raise RuntimeError(lines[-1])
    return json.loads(done.stdout.strip().splitlines()[-1])
