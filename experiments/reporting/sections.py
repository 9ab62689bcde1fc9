"""What every report ends with: definitions and assumptions with their sources, and how to make it again."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator, Mapping
from importlib.metadata import version

from pydantic import BaseModel

from experiments.reporting.blocks import Block, Bullets, Cell, Code, Details, Download, Table, Text
from experiments.scenario import Scenario
from experiments.scenario.toml import toml_text
from materials import library


def assumptions(scenario: Scenario) -> Iterator[Block]:
    """What SNR and CNR mean, the materials with their sources, and every value of the scenario."""
    yield Text(
        (
            "SNR = S / √(S + D + σ²) and CNR = (S − B) / √((S + D + σ²) + (B + D + σ²)): S and B are the mean electrons of a "
            "bright bit's pixels and of the dark cells beside it, D the dark electrons, σ the read noise with quantisation. "
            "The closed form evaluates both from the source, the material, the lens and the sensor; the rendered figures are "
            "statistics of the noise draws of ray-traced frames.",
        )
    )
    rows = list(_parameters(scenario))
    assumed = [row for row in rows if row[3].style]
    yield Text(
        (
            f"{len(assumed)} of the scenario's {len(rows)} values are assumptions, and so are the materials marked below.",
        )
    )
    materials = {
        role: library.load(getattr(scenario.target, f"{role}_material")) for role in ("tape", "absorber", "face")
    }
    yield Table(
        ("role", "material", "source", "uncertainty", "status"),
        tuple(
            (Cell(role), Cell(m.title), Cell(f"{m.source} ({m.date})"), Cell(m.uncertainty), _status(m.assumption))
            for role, m in materials.items()
        ),
        "Materials",
    )
    headings = ("key", "value", "what it is", "status")
    yield Table(headings, tuple(assumed), "Values that are assumptions")
    yield Details("Every value of the scenario", (Table(headings, tuple(rows), "Scenario"),), printed=True)


def _parameters(model: BaseModel, prefix: str = "") -> Iterator[tuple[Cell, Cell, Cell, Cell]]:
    """Key, value, description and status of every field, nested models unfolded."""
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _parameters(value, f"{prefix}{name}.")
            continue
        description = field.description or ""
        assumed = "assumption" in description.lower()
        yield Cell(f"{prefix}{name}"), Cell(_value(value)), Cell(description), _status(assumed)


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _status(assumed: bool) -> Cell:
    """A highlighted word where a value is an assumption, nothing elsewhere."""
    return Cell("assumption", style="flagged") if assumed else Cell("")


def reproduction(scenario: Scenario, attributes: Mapping[str, object], command: str) -> Iterator[Block]:
    """How to make a dataset of a scenario again (its `attributes`, see `chain.provenance`), and the scenario as a file."""
    hashes = {"Scenario": str(attributes["scenario_hash"])}
    versions = f"{attributes['software']}, {attributes['versions']}"
    yield from made_by(command, scenario.seed, hashes, versions, str(attributes.get("history", "")))
    toml = toml_text(scenario.model_dump(mode="json"))
    yield Text(
        ("The whole scenario, every default written out, for ‘mantis budget scenario.toml’ and the other verbs:",)
    )
    yield Download("Save scenario.toml", "scenario.toml", toml)
    yield Details("The scenario as TOML", (Code(toml),))


def made_by(command: str, seed: int | None, hashes: Mapping[str, str], versions: str, run: str = "") -> Iterator[Block]:
    """How to make something again.

    Args:
        command: the command line.
        seed: of its random numbers; None where nothing is random.
        hashes: by what they are of, say the input file or the data; see `digest`.
        versions: of this project and what it stands on; see `versions_text`.
        run: when it was made.
    """
    yield Code(command)
    lines = [
        "Nothing in it is random." if seed is None else f"Seed {seed}; the same input and seed give the same figures."
    ]
    lines += [f"{what}: hash {value}." for what, value in hashes.items()]
    lines += [f"Versions: {versions}.", *([f"Run: {run}."] if run else [])]
    yield Bullets(tuple(lines))


def versions_text(*packages: str) -> str:
    """Versions of this project, of some packages and of Python, as `chain.provenance` writes them."""
    names = ("mantis-radiometry", *packages)
    return ", ".join([*(f"{name} {version(name)}" for name in names), f"python {platform.python_version()}"])


def digest(data: str | bytes) -> str:
    """SHA-256 of a text or of bytes, its first 16 hexadecimal digits."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()[:16]


def footer(attributes: Mapping[str, object]) -> str:
    """One line: software, scenario and run of a dataset."""
    parts = (attributes["software"], f"scenario {attributes['scenario_hash']}", attributes.get("history"))
    return " · ".join(str(part) for part in parts if part)
