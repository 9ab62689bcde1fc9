"""Scenes that several benchmarks render."""

from __future__ import annotations

import numpy as np

from experiments import chain
from experiments.scenario import Scenario, load_scenario
from scenes.render.transport import View


def scenario(*overrides: str) -> Scenario:
    """The default scenario with changes."""
    return load_scenario(overrides=overrides)


def poses(base: Scenario, count: int, seed: int = 1) -> list[View]:
    """Views of a scenario in random attitudes: pitch and yaw within 30 deg, any roll."""
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(count):
        pitch, yaw = rng.uniform(-30, 30, 2)
        attitude = {"pitch_deg": float(pitch), "yaw_deg": float(yaw), "roll_deg": float(rng.uniform(-180, 180))}
        views.append(chain.view(base.model_copy(update={"target": base.target.model_copy(update=attitude)})))
    return views
