"""The scenario: one validated description of camera, lights, target, sensor and study, and its files."""

from experiments.scenario.model import (
    MATERIAL_KEYS,
    KeyValue,
    Range,
    Scenario,
    ScenarioError,
    apply_override,
    describe,
    explain,
    load_data,
    load_scenario,
    overridden,
    set_key,
    shipped_scenarios,
    validate,
)
from experiments.scenario.schema import json_schema

__all__ = [
    "MATERIAL_KEYS",
    "KeyValue",
    "Range",
    "Scenario",
    "ScenarioError",
    "apply_override",
    "describe",
    "explain",
    "json_schema",
    "load_data",
    "load_scenario",
    "overridden",
    "set_key",
    "shipped_scenarios",
    "validate",
]
