"""The JSON schema of a scenario file, from which editors complete and check it and `keys` reads what there is."""

from __future__ import annotations

from typing import Any

from experiments.scenario.model import MATERIAL_KEYS, Scenario
from experiments.scenario.presets import SECTIONS, presets
from materials import library


def json_schema() -> dict[str, Any]:
    """JSON schema of a scenario file, presets included, for an editor to complete and check."""
    schema = Scenario.model_json_schema()
    for section in SECTIONS:
        reference = schema["properties"][section].get("$ref") or schema["properties"][section]["allOf"][0]["$ref"]
        properties = schema["$defs"][reference.rsplit("/", 1)[1]]["properties"]
        description = "fills this section; keys written beside it win"
        properties["preset"] = {"type": "string", "enum": sorted(presets(section)), "description": description}
    names = {"anyOf": [{"enum": list(library.available())}, {"type": "string", "pattern": r"\.toml(_eol)?$"}]}
    for key in MATERIAL_KEYS:
        told = schema["$defs"]["Target"]["properties"][key]
        told.update(names)
        told.pop("type")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Mantis scenario", **schema}
