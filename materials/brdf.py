"""The reflectance model, defined once and evaluated by numpy (budget) and by Dr.Jit (renderer) alike.

Every material here is isotropic, reflects only on its front side, and is the sum of up to three reciprocal lobes:

* Lambertian, ρ/π; * gloss: a GGX microfacet mirror, ρ_s · D · G / (4 cosθ_i cosθ_o) (Walter et al., EGSR 2007, eq. 20, 33,
34; no Fresnel term); * retroreflection, a table in observation and entrance angle as ASTM E810 measures it: R_A = f cosθ_i
cosθ_o.

All three depend on three numbers only: cosθ_i, cosθ_o and the squared chord c = |ω_i − ω_o|². For nearly parallel
directions the chord stays accurate in single precision, while the angle between them does not. `ops` is the namespace that
computes, ``numpy`` or ``drjit``; both spell exp, log, sqrt, minimum and maximum alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray

#: Smallest squared chord told apart [-]; an observation angle of 6e-6°, far below any table.
_SMALLEST_CHORD2 = 1e-14


@dataclass(frozen=True)
class RetroTable:
    """Coefficient of retroreflection over observation and entrance angle.

    Between the tabulated observation angles the lobe is a power law of the chord (log-log linear). Below the first it is
    constant, beyond the last it falls with `tail_exponent`. In entrance angle, f is linear in cosβ between the rows and
    falls to zero at 90°. β is the angle between the normal and the bisector of both directions, which makes the lobe
    reciprocal.

    Attributes:
        observation_deg: (n,) increasing [deg].
        entrance_deg: (m,) increasing, the first near zero [deg].
        coefficient: R_A, (m, n) [cd lx⁻¹ m⁻² = sr⁻¹].
        tail_exponent: fall-off with the observation angle beyond the table, above 2 so that its energy is finite.

    Raises:
        ValueError: when the table's shape does not fit the angles, the angles do not increase within their bounds, a
            coefficient is not above zero, or the tail's exponent is not above 2.
    """

    observation_deg: tuple[float, ...]
    entrance_deg: tuple[float, ...]
    coefficient: tuple[tuple[float, ...], ...]
    tail_exponent: float = 3.0

    def __post_init__(self) -> None:
        table = np.array(self.coefficient, float)
        if table.shape != (len(self.entrance_deg), len(self.observation_deg)) or not np.all(table > 0):
            raise ValueError(f"retro table: {table.shape} must be entrance × observation angles, every R_A > 0 sr⁻¹")
        if np.any(np.diff(self.observation_deg) <= 0) or np.any(np.diff(self.entrance_deg) <= 0):
            raise ValueError("retro table: observation and entrance angles [deg] must increase")
        if self.observation_deg[0] <= 0 or not 0 <= self.entrance_deg[0] < self.entrance_deg[-1] + 1 < 90:
            raise ValueError("retro table: observation angles must exceed 0 and entrance angles lie in 0-89 deg")
        if self.tail_exponent <= 2:
            raise ValueError(
                f"retro table: tail_exponent {self.tail_exponent:g} must exceed 2, or the lobe holds infinite energy"
            )

    @cached_property
    def log_chord(self) -> FloatArray:
        """Logarithm of the chord 2 sin(α/2) at the tabulated observation angles, (n,) [-]."""
        return np.log(2 * np.sin(np.radians(self.observation_deg) / 2))

    @cached_property
    def rows(self) -> list[tuple[float, float, FloatArray]]:
        """For each entrance angle: cosβ, log f at the first observation angle, and the changes of log-log slope, (n,)."""
        result = []
        for entrance, row in zip(self.entrance_deg, self.coefficient, strict=True):
            log_f = np.log(np.array(row) / np.cos(np.radians(entrance)) ** 2)
            slopes = np.concatenate([[0.0], np.diff(log_f) / np.diff(self.log_chord), [-self.tail_exponent]])
            result.append((float(np.cos(np.radians(entrance))), float(log_f[0]), np.diff(slopes)))
        return result

    def lobe(self, ops: Any, cos_bisector: Any, chord2: Any) -> Any:
        """The retroreflective lobe f [sr⁻¹].

        Args:
            ops: ``numpy`` or ``drjit``.
            cos_bisector: cosβ of the bisector of both directions from the normal.
            chord2: squared chord between both directions, of the same shape.
        """
        log_chord = 0.5 * ops.log(ops.maximum(chord2, _SMALLEST_CHORD2))
        hinges = [ops.maximum(log_chord - float(x), 0.0) for x in self.log_chord]

        def row_value(index: int) -> Any:
            _, value, bends = self.rows[index]
            for bend, hinge in zip(bends, hinges, strict=True):
                value = value + float(bend) * hinge
            return ops.exp(value)

        cosines = [row[0] for row in self.rows]
        # Linear interpolation in cosβ written with clamped ramps, so that it needs no branch and no gather.
        total = row_value(0)
        for k in range(1, len(cosines)):
            ramp = ops.minimum(ops.maximum((cosines[k - 1] - cos_bisector) / (cosines[k - 1] - cosines[k]), 0.0), 1.0)
            total = total * (1.0 - ramp) + row_value(k) * ramp
        return total * ops.minimum(ops.maximum(cos_bisector / cosines[-1], 0.0), 1.0)


def gloss_lobe(ops: Any, alpha: float, cos_i: Any, cos_o: Any, cos_half: Any) -> Any:
    """GGX microfacet mirror of unit reflectance, f [sr⁻¹]: D · G₁(θ_i) · G₁(θ_o) / (4 cosθ_i cosθ_o).

    Args:
        ops: ``numpy`` or ``drjit``.
        alpha: GGX roughness.
        cos_i: cosine of the source's angle from the normal.
        cos_o: cosine of the viewer's angle from the normal, of the same shape.
        cos_half: cosine of the angle between the half vector and the normal, of the same shape.
    """
    a2 = alpha * alpha
    base = cos_half * cos_half * (a2 - 1.0) + 1.0
    distribution = a2 / (np.pi * base * base)

    def shadowed(cosine: Any) -> Any:  # G₁(θ) / (2 cosθ), finite at grazing
        return 1.0 / (cosine + ops.sqrt(a2 + (1.0 - a2) * cosine * cosine))

    return distribution * shadowed(cos_i) * shadowed(cos_o)


@dataclass(frozen=True)
class Lobes:
    """Shape of a material's reflectance. The spectra that scale each lobe are given with every evaluation.

    Attributes:
        retro: table of the retroreflective lobe, or None.
        gloss_alpha: GGX roughness of the glossy lobe, or None.
    """

    retro: RetroTable | None = None
    gloss_alpha: float | None = None

    def evaluate(self, ops: Any, cos_i: Any, cos_o: Any, chord2: Any, diffuse: Any, gloss: Any, retro: Any) -> Any:
        """BRDF f [sr⁻¹] where both cosines are positive. The caller masks everything else.

        Args:
            ops: ``numpy`` or ``drjit``.
            cos_i: cosine of the source's angle from the normal.
            cos_o: cosine of the viewer's angle from the normal, of the same shape.
            chord2: squared chord |ω_i − ω_o|² of both directions, of the same shape.
            diffuse: albedo of the Lambertian lobe.
            gloss: albedo of the microfacet mirror.
            retro: factor on the retro table, 1 at the wavelength where it was measured.

        Example:
            A Lambertian surface reflects ρ/π, whatever the directions:

            >>> import numpy as np
            >>> from materials.brdf import Lobes
            >>> round(float(Lobes().evaluate(np, 1.0, 0.5, 1.0, diffuse=0.5, gloss=0.0, retro=0.0)), 6)
            0.159155
        """
        value = diffuse * (1.0 / np.pi)
        bisector = (cos_i + cos_o) / ops.sqrt(ops.maximum(4.0 - chord2, 1e-6))
        if self.gloss_alpha is not None:
            value = value + gloss * gloss_lobe(ops, self.gloss_alpha, cos_i, cos_o, bisector)
        if self.retro is not None:
            value = value + retro * self.retro.lobe(ops, bisector, chord2)
        return value


def chord_squared(direction_a: ArrayLike, direction_b: ArrayLike) -> FloatArray:
    """Squared chord |a − b|² = 2(1 − cos α) of unit vectors, without cancellation at small angles (...).

    Args:
        direction_a: (..., 3).
        direction_b: (..., 3).
    """
    difference = np.asarray(direction_a, float) - np.asarray(direction_b, float)
    return np.sum(difference**2, axis=-1)
