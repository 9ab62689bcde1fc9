"""Named materials, read from data files that state source, date, unit and uncertainty."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from materials.brdf import Lobes, chord_squared
from materials.datafile import Sourced, parse
from radiometry.geometry import FloatArray
from radiometry.spectrum import Spectrum, constant

#: Appended to a material's name for its state at the end of the mission.
END_OF_LIFE = "_eol"
#: What the midpoint rule with a hundred nodes may add to an albedo of one.
_QUADRATURE_ERROR = 1e-3
_LED_NM = 850.0


@dataclass(frozen=True)
class Material:
    """A reflective surface: the shape of its lobes, the spectrum of each, and where the figures come from.

    Attributes:
        name: by which `load` finds it.
        title: what it is, in one line.
        source, date, uncertainty: of the figures, in words.
        assumption: whether some figure has no source.
        lobes: shape of the reflectance.
        diffuse, gloss, retro: what scales each lobe, over wavelength [-].
    """

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
        """BRDF f [sr⁻¹]; zero where source or viewer stand behind the surface.

        Args:
            normal: unit vector (..., 3).
            to_source: unit vector that leaves the surface, (..., 3).
            to_viewer: unit vector that leaves the surface, (..., 3).
            wavelength_nm: broadcasts against the leading shape of the vectors [nm].

        Returns:
            (...) [sr⁻¹].

        Example:
            A perfect diffuser would have 1/π = 0.318 sr⁻¹; Spectralon comes near to it:

            >>> from materials import library
            >>> up = [0.0, 0.0, 1.0]
            >>> round(float(library.load("spectralon").brdf(up, up, up, 850.0)), 3)
            0.315
        """
        normal, to_source, to_viewer = (np.asarray(v, float) for v in (normal, to_source, to_viewer))
        cos_i, cos_o = np.sum(normal * to_source, axis=-1), np.sum(normal * to_viewer, axis=-1)
        lit = (cos_i > 0) & (cos_o > 0)
        value = self.lobes.evaluate(
            np,
            np.where(lit, cos_i, 1.0),
            np.where(lit, cos_o, 1.0),
            np.minimum(chord_squared(to_source, to_viewer), 4.0),
            diffuse=self.diffuse(wavelength_nm),
            gloss=self.gloss(wavelength_nm),
            retro=self.retro(wavelength_nm),
        )
        return np.where(lit, value, 0.0)

    def albedo(self, entrance_rad: float, wavelength_nm: float, samples: int = 400) -> float:
        """Share of the light from one direction that the surface reflects into the half space: ∫ f cosθ_o dω_o [-].

        Args:
            entrance_rad: angle of the light from the normal [rad].
            wavelength_nm: of the light [nm].
            samples: nodes of the quadrature along each axis.
        """
        shares = self.lobe_albedos(entrance_rad, samples)
        return float(
            sum(s(wavelength_nm) * a for s, a in zip((self.diffuse, self.gloss, self.retro), shares, strict=True))
        )

    def lobe_albedos(self, entrance_rad: float, samples: int = 400) -> tuple[float, float, float]:
        """What each lobe reflects of the light that arrives, where its spectrum is one: diffuse, gloss and retro [-].

        The mirror lobe is integrated over half vectors, the retro lobe over directions about the source. Both use the
        midpoint rule, with nodes spaced so that a narrow lobe and its far tail are resolved alike.

        Args:
            entrance_rad: angle of the light from the normal [rad].
            samples: nodes of the quadrature along each axis.
        """
        source = np.array([np.sin(entrance_rad), 0.0, np.cos(entrance_rad)])
        azimuth = (np.arange(samples) + 0.5) * 2 * np.pi / samples
        gloss = retro = 0.0
        if self.lobes.gloss_alpha is not None:
            # tan θ_h = α √(u / (1 − u)) spreads the nodes as GGX spreads the microfacets; dω_o = 4 (ω_i·h) dω_h.
            alpha2, u = self.lobes.gloss_alpha**2, (np.arange(samples) + 0.5) / samples
            cosine = 1 / np.sqrt(1 + alpha2 * u / (1 - u))
            half = _cone(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), cosine, azimuth)
            towards = half @ source
            viewer = 2 * towards[..., None] * half - source
            solid_angle = 4 * np.clip(towards, 0, None) * (np.pi * cosine**3 * alpha2 / (1 - u) ** 2)[:, None]
            gloss = float(np.mean(self._lobe("gloss", source, viewer) * solid_angle))
        if self.lobes.retro is not None:
            edges = np.concatenate([[0.0], np.geomspace(1e-10, 4.0, samples)])
            cosine = 1 - (edges[:-1] + edges[1:]) / 4
            side = np.array([np.cos(entrance_rad), 0.0, -np.sin(entrance_rad)])
            viewer = _cone(side, source, cosine, azimuth)
            # dω = π dc over the full circle of azimuths, for the squared chord c = 2(1 − cos α).
            retro = float(np.sum(np.mean(self._lobe("retro", source, viewer), axis=1) * np.pi * np.diff(edges)))
        return 1.0, gloss, retro

    def _lobe(self, name: str, to_source: FloatArray, to_viewer: FloatArray) -> FloatArray:
        """F cosθ_o of one lobe alone, its spectrum set to one, for a normal along z."""
        cos_o = to_viewer[..., 2]
        alone = {lobe: float(lobe == name) for lobe in ("diffuse", "gloss", "retro")}
        chord2 = np.minimum(chord_squared(to_source, to_viewer), 4.0)
        value = self.lobes.evaluate(np, to_source[2], np.where(cos_o > 0, cos_o, 1.0), chord2, **alone)
        return np.where(cos_o > 0, value * cos_o, 0.0)


def _cone(side: FloatArray, axis: FloatArray, cosine: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Unit vectors (polar, azimuth, 3) about an axis; `side` is normal to it and to the y axis."""
    around = np.cos(azimuth)[:, None] * side + np.sin(azimuth)[:, None] * np.array([0.0, 1.0, 0.0])
    sine = np.sqrt(np.clip(1 - cosine**2, 0, None))
    return cosine[:, None, None] * axis + sine[:, None, None] * around


def available() -> tuple[str, ...]:
    """Names of all shipped materials, sorted. Names that end in `_eol` are the same materials at the end of their life."""
    shipped = _shipped()
    worn = (name + END_OF_LIFE for name, text in shipped.items() if parse(text, name).end_of_life is not None)
    return tuple(sorted([*shipped, *worn]))


def load(name: str) -> Material:
    """A material of the library, or of a user's own data file.

    Args:
        name: a shipped name, or the path of a file that ends in `.toml`. With `_eol` appended, the material at the end of
            its life.

    Raises:
        ValueError: when the material is unknown, its file cannot be read or is wrong, or it returns more light than
            arrives.

    Example:
        >>> from materials import library
        >>> tape = library.load("tape_type_xi")
        >>> tape.lobes.retro is not None, tape.albedo(0.0, 850.0) < 1.0
        (True, True)
    """
    return _material(name, _text(name))


def fingerprint(name: str) -> str:
    """A material's content as a short text: a shipped name itself, or the SHA-256 of a user's own data file.

    Args:
        name: as for `load`.

    Raises:
        ValueError: when the material is unknown or its file cannot be read.
    """
    if name.removesuffix(END_OF_LIFE) in _shipped():
        return name
    suffix = END_OF_LIFE if name.endswith(END_OF_LIFE) else ""
    return "sha256:" + hashlib.sha256(_text(name).encode()).hexdigest() + suffix


def is_path(name: str) -> bool:
    """Whether a material's name is the path of a data file.

    Args:
        name: as for `load`.
    """
    return name.removesuffix(END_OF_LIFE).endswith(".toml")


def widest_half_angle_deg(peak_per_sr: float, share: float = 1.0) -> float:
    """Half angle of the widest top-hat lobe of a given height that reflects no more than a share of the light [deg].

    From f₀ π sin²θ ≤ share.

    Args:
        peak_per_sr: height f₀ of the lobe [sr⁻¹].
        share: of the light that arrives [-].
    """
    return float(np.degrees(np.arcsin(np.sqrt(min(1.0, max(0.0, share) / (np.pi * peak_per_sr))))))


@cache
def _shipped() -> dict[str, str]:
    """Text of every shipped data file, by name."""
    folder = files("materials") / "data"
    return {
        f.name.removesuffix(".toml"): f.read_text(encoding="utf-8")
        for f in folder.iterdir()
        if f.name.endswith(".toml")
    }


def _text(name: str) -> str:
    base = name.removesuffix(END_OF_LIFE)
    if base in _shipped():
        return _shipped()[base]
    if not is_path(name):
        raise ValueError(
            f"material {name!r} is unknown; expected one of {', '.join(sorted(_shipped()))}, most also with {END_OF_LIFE} "
            "for the end of life, or the path of a .toml file"
        )
    try:
        return Path(base).read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"material {base!r} cannot be read ({error.strerror}); expected a TOML file") from error
    except UnicodeDecodeError:
        raise ValueError(f"material {base!r} is not text; expected a TOML file") from None


@cache
def _material(name: str, text: str) -> Material:
    data = parse(text, name)
    nothing = constant(0.0)
    spectra = {
        "diffuse": data.diffuse.albedo,
        "gloss": data.gloss.albedo if data.gloss else nothing,
        "retro": data.retro.spectral_factor if data.retro else nothing,
    }
    origin: Sourced = data
    title, assumption = data.title, data.assumption
    if name.endswith(END_OF_LIFE):
        worn = data.end_of_life
        if worn is None:
            raise ValueError(f"material {name!r} is unknown: its data file has no table [end_of_life]")
        spectra = {lobe: spectrum * getattr(worn, lobe) for lobe, spectrum in spectra.items()}
        origin, title, assumption = worn, f"{data.title}, end of life", data.assumption or worn.assumption
    material = Material(
        name=name,
        title=title,
        source=origin.source,
        date=origin.date,
        uncertainty=origin.uncertainty,
        assumption=assumption,
        lobes=data.lobes(),
        **spectra,
    )
    _assert_energy(material)
    return material


def _assert_energy(material: Material) -> None:
    """Refuse a material that returns more light than arrives, at any angle or wavelength, with the arithmetic."""
    spectra = (material.diffuse, material.gloss, material.retro)
    # Albedo is linear between the knots of the spectra, so its largest value lies at one of them.
    wavelengths = np.unique(np.concatenate([[_LED_NM], *(s.wavelength_nm for s in spectra)]))
    values = np.array([s(wavelengths) for s in spectra])
    table = material.lobes.retro
    for entrance_deg in sorted({0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 85.0, *(table.entrance_deg if table else ())}):
        shares = np.array(material.lobe_albedos(np.radians(entrance_deg), samples=100))
        albedo = shares @ values
        # Of equally bad wavelengths, the one that the illuminator is at.
        worst = int(np.lexsort((np.abs(wavelengths - _LED_NM), -albedo.round(9)))[0])
        if albedo[worst] > 1 + _QUADRATURE_ERROR:
            parts = values[:, worst] * shares
            terms = " + ".join(
                f"{n} {p:.3g}" for n, p in zip(("diffuse", "gloss", "retro"), parts, strict=True) if p > 0
            )
            raise ValueError(
                f"material {material.name}: returns {albedo[worst]:.3g} times the light that arrives at {entrance_deg:g} deg "
                f"and {wavelengths[worst]:g} nm ({terms}); at most 1 conserves energy{_too_wide(material, parts)}"
            )


def _too_wide(material: Material, parts: FloatArray) -> str:
    """The widest retro lobe of its height that energy allows, beside the one that was asked for."""
    if material.lobes.retro is None or parts[2] <= 0:
        return ""
    peak = float(np.max(material.retro.values) * np.max(material.lobes.retro.coefficient))
    room = 1.0 - float(parts[0] + parts[1])
    return (
        f". A lobe of {peak:g} /sr that returns {parts[2]:.3g} is as wide as a top-hat of "
        f"{widest_half_angle_deg(peak, float(parts[2])):.3g} deg half angle; f0 * pi * sin^2(angle) <= {max(room, 0):.3g} allows "
        f"{widest_half_angle_deg(peak, room):.3g} deg"
    )
