"""The materials: what each returns, at the beginning and at the end of its life."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.studies.materials.plan import Plan
from materials import library
from materials.goniometer import WAVELENGTH_NM, goniometer_scan
from materials.library import END_OF_LIFE, Material

ENTRANCES_DEG = (5.0, 30.0, 60.0)
#: Observation angles over which lobes are drawn and their peak is looked for [deg].
OBSERVATION_DEG = np.unique(np.concatenate([np.geomspace(0.05, 90.0, 100), [10.0, 60.0]]))


@dataclass(frozen=True)
class MaterialRow:
    """One material at one end of its life, at 850 nm.

    Attributes:
        peak_per_sr: the largest BRDF at 5° entrance over 0.05–90° observation angle.
        albedo_0, albedo_30, albedo_60: directional-hemispherical reflectance at 0, 30 and 60° incidence.
    """

    name: str
    title: str
    life: str
    peak_per_sr: float
    albedo_0: float
    albedo_30: float
    albedo_60: float
    assumption: bool
    source: str
    date: str
    uncertainty: str

    @property
    def short_name(self) -> str:
        """The name, or a path's last part."""
        return Path(self.name).name

    @property
    def albedo(self) -> float:
        """The largest albedo."""
        return max(self.albedo_0, self.albedo_30, self.albedo_60)


@dataclass(frozen=True)
class MaterialsResult:
    """Materials by row, and each with its own end of life where both were asked for."""

    rows: tuple[MaterialRow, ...]
    pairs: tuple[tuple[Material, Material | None], ...]


def run(plan: Plan) -> MaterialsResult:
    """Tabulate the materials.

    Raises:
        ValueError: when a material does not exist, its file is wrong, or it would return more light than it receives.
    """
    rows = tuple(_row(library.load(name)) for name in plan.names or library.available())
    return MaterialsResult(rows, tuple(fresh_and_worn([row.name for row in rows])))


def _row(material: Material) -> MaterialRow:
    at_0, at_30, at_60 = (material.albedo(np.radians(angle), WAVELENGTH_NM) for angle in (0.0, 30.0, 60.0))
    return MaterialRow(
        name=material.name,
        title=material.title,
        life="end" if material.name.endswith(END_OF_LIFE) else "beginning",
        peak_per_sr=float(goniometer_scan(material, ENTRANCES_DEG[0], OBSERVATION_DEG).max()),
        albedo_0=at_0,
        albedo_30=at_30,
        albedo_60=at_60,
        assumption=material.assumption,
        source=material.source,
        date=material.date,
        uncertainty=material.uncertainty,
    )


def fresh_and_worn(names: Sequence[str]) -> list[tuple[Material, Material | None]]:
    """Each material with its own end of life, where that was asked for too; one asked for alone stands alone."""
    pairs = []
    for name in names:
        if name.endswith(END_OF_LIFE) and name.removesuffix(END_OF_LIFE) in names:
            continue
        worn = name + END_OF_LIFE
        pairs.append((library.load(name), library.load(worn) if worn in names else None))
    return pairs
