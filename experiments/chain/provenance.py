"""What is needed to make a result again, and whether a basis belongs to a scenario."""

from __future__ import annotations

import platform
from importlib.metadata import version

from experiments.scenario import Scenario


def provenance(scenario: Scenario) -> dict[str, str | float]:
    """What is needed to make a result again: scenario, its hash, seed and versions."""
    camera = scenario.camera
    return {
        "scenario": scenario.model_dump_json(),
        "scenario_hash": scenario.digest(),
        "seed": float(scenario.seed),
        "camera": f"{camera.width_px}x{camera.height_px} px, f {camera.focal_length_m:g} m, F/{camera.f_number:g}",
        "software": f"mantis-radiometry {version('mantis-radiometry')}",
        "versions": ", ".join(
            f"{name} {version(name)}" for name in ("mitsuba", "drjit", "numpy", "opencv-python-headless")
        )
        + f", python {platform.python_version()}",
    }
