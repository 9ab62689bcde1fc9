"""Named materials, read from data files that state source, date, unit and uncertainty."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from materials.brdf import Lobes, RetroTable, chord_squared
from radiometry.geometry import FloatArray
from radiometry.spectrum import Spectrum


@dataclass(frozen=True)
class Material:
    """A reflective surface: the shape of its lobes, the spectrum of each, and where the figures come from."""

    name: str
    title: str
    source: str
    date: str
    uncertainty: str
    assumption: bool
    lobes: Lobes
    diffuse: Spectrum
    gloss: Spectrum
    retro: Spectrum

    def brdf(
        self, normal: ArrayLike, to_source: ArrayLike, to_viewer: ArrayLike, wavelength_nm: ArrayLike
    ) -> FloatArray:
        """f [sr⁻¹] for unit vectors (..., 3) that leave the surface, and wavelengths broadcast against them [nm].

        Zero where source or viewer stand behind the surface.
        """
        normal, to_source, to_viewer = (np.asarray(v, float) for v in (normal, to_source, to_viewer))
        cos_i, cos_o = np.sum(normal * to_source, axis=-1), np.sum(normal * to_viewer, axis=-1)
        lit = (cos_i > 0) & (cos_o > 0)
        value = self.lobes.evaluate(
            np, np.where(lit, cos_i, 1.0), np.where(lit, cos_o, 1.0), np.minimum(chord_squared(to_source, to_viewer), 4.0),
            self.diffuse(wavelength_nm), self.gloss(wavelength_nm), self.retro(wavelength_nm),
        )  # fmt: skip
        return np.where(lit, value, 0.0)

    def albedo(self, entrance_rad: float, wavelength_nm: float, samples: int = 400) -> float:
        """Directional-hemispherical reflectance ∫ f cosθ_o dω_o of light that arrives at an angle from the normal.

        Midpoint rule over a polar grid about the direction back to the source, spaced in the logarithm of the chord so that a
        retro lobe of a tenth of a degree and a Lambertian floor are both resolved.
        """
        source = np.array([np.sin(entrance_rad), 0.0, np.cos(entrance_rad)])
        edges = np.concatenate([[0.0], np.geomspace(1e-10, 4.0, samples)])
        chord2 = (edges[:-1] + edges[1:]) / 2
        azimuth = (np.arange(samples) + 0.5) * 2 * np.pi / samples
        cos_a = 1 - chord2 / 2
        sin_a = np.sqrt(np.clip(1 - cos_a**2, 0, None))
        side, up = np.array([np.cos(entrance_rad), 0.0, -np.sin(entrance_rad)]), np.array([0.0, 1.0, 0.0])
        around = np.cos(azimuth)[:, None] * side + np.sin(azimuth)[:, None] * up
        viewer = cos_a[:, None, None] * source + sin_a[:, None, None] * around
        normal = np.array([0.0, 0.0, 1.0])
        value = self.brdf(normal, source, viewer, wavelength_nm) * np.clip(viewer[..., 2], 0, None)
        # dω = π dc over the full circle of azimuths, for c = 2(1 − cos α).
        return float(np.sum(value.mean(axis=1) * np.pi * np.diff(edges)))


def _spectrum(entry: object) -> Spectrum:
    """A number (the same at all wavelengths) or a list of [wavelength_nm, value] pairs."""
    if isinstance(entry, list):
        table = np.array(entry, float)
        return Spectrum(table[:, 0], table[:, 1])
    return Spectrum(np.array([300.0, 1200.0]), np.full(2, float(entry)))  # type: ignore[arg-type]


def available() -> tuple[str, ...]:
    """Names of all shipped materials, sorted."""
    return tuple(
        sorted(
            f.name.removesuffix(".toml") for f in (files("materials") / "data").iterdir() if f.name.endswith(".toml")
        )
    )


@cache
def load(name: str) -> Material:
    """The material of that name.

    Raises:
        ValueError: when there is none, or when it would return more light than it receives.
    """
    if name not in available():
        raise ValueError(f"material: {name!r} is unknown; there are {', '.join(available())}")
    data = tomllib.loads((files("materials") / "data" / f"{name}.toml").read_text(encoding="utf-8"))
    retro = data.get("retro")
    table = None
    if retro is not None:
        table = RetroTable(
            tuple(retro["observation_deg"]), tuple(retro["entrance_deg"]),
            tuple(tuple(row) for row in retro["coefficient_cd_per_lx_m2"]), retro.get("tail_exponent", 3.0),
        )  # fmt: skip
    gloss = data.get("gloss", {})
    material = Material(
        name=name,
        title=data["title"],
        source=data["source"],
        date=str(data["date"]),
        uncertainty=data["uncertainty"],
        assumption=data["assumption"],
        lobes=Lobes(table, gloss.get("ggx_alpha")),
        diffuse=_spectrum(data["diffuse"]["albedo"]),
        gloss=_spectrum(gloss.get("albedo", 0.0)),
        retro=_spectrum((retro or {}).get("spectral_factor", 0.0 if retro is None else 1.0)),
    )
    _assert_energy(material)
    return material


def _assert_energy(material: Material) -> None:
    for wavelength in (810.0, 850.0, 890.0):
        for entrance_deg in (0.0, 30.0, 60.0, 80.0, 88.0):
            albedo = material.albedo(np.radians(entrance_deg), wavelength, samples=100)
            if albedo > 1.0:
                raise ValueError(
                    f"material {material.name}: returns {albedo:.3f} of the light that arrives at {entrance_deg:g} deg and "
                    f"{wavelength:g} nm; at most 1 conserves energy"
                )
