"""The materials as a Mitsuba BSDF, type ``mantis_material``. Import only after a variant has been set."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from materials.library import Material, load
from radiometry.spectrum import Spectrum

_registered: set[str] = set()


def register() -> None:
    """Make ``mantis_material`` known to Mitsuba's current variant. The plugin's property `material` is a name of the library."""
    variant = mi.variant()
    if variant not in _registered:
        mi.register_bsdf("mantis_material", _bsdf_class())
        _registered.add(variant)


def texture(spectrum: Spectrum) -> dict[str, Any]:
    """Scene description of a spectrum. It covers the whole near infrared, so that Mitsuba consults no built-in data.

    Args:
        spectrum: of a reflectance or a factor.
    """
    if np.ptp(spectrum.values) == 0:
        return {"type": "uniform", "value": float(spectrum.values[0])}
    return {
        "type": "irregular",
        "wavelengths": ",".join(f"{w:.6g}" for w in spectrum.wavelength_nm),
        "values": ",".join(f"{v:.8g}" for v in spectrum.values),
    }


def bsdf_dict(material: Material) -> dict[str, Any]:
    """Scene description of a material.

    A Lambertian material becomes Mitsuba's own ``diffuse``. In scalar variants, where a Python BSDF is two orders of
    magnitude slower, a glossy one becomes Mitsuba's ``roughconductor`` blended with ``diffuse``. Tests hold both equal to
    the definition.

    Args:
        material: of the library.
    """
    if material.lobes.retro is None and material.lobes.gloss_alpha is None:
        return {"type": "diffuse", "reflectance": texture(material.diffuse)}
    if material.lobes.retro is None and mi.variant().startswith("scalar"):
        diffuse, gloss = float(material.diffuse(850.0)), float(material.gloss(850.0))
        weight = min(max(gloss / max(diffuse + gloss, 1e-6), 0.02), 0.98)  # neither lobe is ever divided by nothing
        return {
            "type": "blendbsdf",
            "weight": weight,
            "first": {"type": "diffuse", "reflectance": texture(material.diffuse * (1 / (1 - weight)))},
            "second": {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha": material.lobes.gloss_alpha,
                "specular_reflectance": texture(material.gloss * (1 / weight)),
            },
        }
    return {"type": "mantis_material", "material": material.name}


def _bsdf_class() -> type:
    """The BSDF class of the current variant (its base class differs between variants)."""

    class MantisMaterial(mi.BSDF):
        """Evaluates `materials.brdf.Lobes`; sampled as a mixture of its lobes."""

        def __init__(self, props: mi.Properties) -> None:
            mi.BSDF.__init__(self, props)
            self.material = load(str(props["material"]))
            self.lobes = self.material.lobes
            self.diffuse, self.gloss, self.retro = (
                mi.load_dict(texture(s)) for s in (self.material.diffuse, self.material.gloss, self.material.retro)
            )
            self.weights = _lobe_weights(self.material)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags
            if self.lobes.retro is not None:
                self.chord_sampler = _ChordSampler(self.material)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            active = mi.Mask(active) & (cos_i > 0) & (cos_o > 0)
            value = self.lobes.evaluate(
                dr,
                dr.maximum(cos_i, 1e-6),
                dr.maximum(cos_o, 1e-6),
                dr.squared_norm(si.wi - wo),
                diffuse=self.diffuse.eval(si, active),
                gloss=self.gloss.eval(si, active),
                retro=self.retro.eval(si, active),
            )
            return dr.select(active, value * cos_o, 0.0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            active = mi.Mask(active) & (cos_i > 0) & (cos_o > 0)
            w_diffuse, w_gloss, w_retro = self.weights
            total = w_diffuse * mi.warp.square_to_cosine_hemisphere_pdf(wo)
            if w_gloss > 0:
                half = dr.normalize(si.wi + wo)
                d = self._microfacets()
                total += w_gloss * d.pdf(si.wi, half) / (4.0 * dr.maximum(dr.dot(wo, half), 1e-6))
            if w_retro > 0:
                total += w_retro * self.chord_sampler.pdf(dr.squared_norm(si.wi - wo))
            return dr.select(active, total, 0.0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            active = mi.Mask(active) & (mi.Frame3f.cos_theta(si.wi) > 0)
            w_diffuse, w_gloss, w_retro = self.weights
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            if w_gloss > 0:
                half = self._microfacets().sample(si.wi, sample2)[0]
                wo = dr.select(sample1 < w_diffuse, wo, 2.0 * dr.dot(si.wi, half) * half - si.wi)
            if w_retro > 0:
                chord2 = dr.minimum(self.chord_sampler.sample(sample2.x), 4.0)
                cos_a = 1.0 - 0.5 * chord2
                sin_a = dr.safe_sqrt(chord2 * (1.0 - 0.25 * chord2))
                sin_p, cos_p = dr.sincos(2.0 * dr.pi * sample2.y)
                back = mi.Frame3f(si.wi).to_world(mi.Vector3f(sin_a * cos_p, sin_a * sin_p, cos_a))
                wo = dr.select(sample1 < w_diffuse + w_gloss, wo, back)
            result = dr.zeros(mi.BSDFSample3f)
            result.wo, result.eta = wo, 1.0
            result.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            result.sampled_component = mi.UInt32(0)
            value, result.pdf = self.eval_pdf(ctx, si, wo, active)
            valid = active & (result.pdf > 0) & (mi.Frame3f.cos_theta(wo) > 0)
            return result, dr.select(valid, value / dr.maximum(result.pdf, 1e-20), 0.0)

        def _microfacets(self) -> Any:
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.lobes.gloss_alpha, True)

        def to_string(self) -> str:
            return f"MantisMaterial[{self.material.name}]"

    return MantisMaterial


def _lobe_weights(material: Material) -> tuple[float, float, float]:
    """Probabilities of sampling the diffuse, glossy and retroreflective lobe, near to their albedos at 850 nm."""
    diffuse = float(material.diffuse(850.0))
    gloss = float(material.gloss(850.0)) if material.lobes.gloss_alpha is not None else 0.0
    retro = 0.5 if material.lobes.retro is not None else 0.0
    total = diffuse + gloss + retro
    return diffuse / total, gloss / total, retro / total


class _ChordSampler:
    """Samples the squared chord c of the retro lobe's first row, a power law between knots. dω = π dc, azimuth uniform."""

    def __init__(self, material: Material) -> None:
        table = material.lobes.retro
        assert table is not None
        _, log_first, bends = table.rows[0]
        self.knots = np.concatenate([[0.0], np.exp(2 * table.log_chord), [4.0]])
        exponents = np.concatenate([[0.0], np.cumsum(bends)]) / 2  # f ∝ c^exponent in each segment
        heights = [float(np.exp(log_first))]
        for k in range(1, len(self.knots) - 2):
            heights.append(heights[-1] * float((self.knots[k + 1] / self.knots[k]) ** exponents[k]))
        self.segments = []  # lower knot, its height, exponent, integral before the segment, integral of the segment
        before = 0.0
        for k, exponent in enumerate(exponents):
            low, high = float(self.knots[k]), float(self.knots[k + 1])
            anchor = high if k == 0 else low
            height = heights[0] if k == 0 else heights[k - 1]
            power = float(exponent) + 1.0
            if abs(power) < 1e-3:  # at a slope of −2 the integral is a logarithm; samples need only be near the lobe
                power = 1e-3
            area = height * anchor * ((high / anchor) ** power - (low / anchor) ** power) / power
            self.segments.append((low, high, anchor, height, power, before, area))
            before += area
        self.total = before

    def sample(self, u: Any) -> Any:
        """Squared chord for a uniform number."""
        target = u * self.total
        chord2 = mi.Float(0.0)
        for low, high, anchor, height, power, before, area in self.segments:
            start = (low / anchor) ** power
            rest = dr.minimum(dr.maximum(target - before, 0.0), area) * (power / (height * anchor)) + start
            value = anchor * dr.power(dr.maximum(rest, 1e-20), 1.0 / power)
            inside = (target >= before) & (target <= before + area)
            chord2 = dr.select(inside, dr.minimum(dr.maximum(value, low), high), chord2)
        return chord2

    def pdf(self, chord2: Any) -> Any:
        """Density over solid angle [sr⁻¹]."""
        density = mi.Float(0.0)
        for low, high, anchor, height, power, _, _ in self.segments:
            value = height * dr.power(dr.maximum(chord2, 1e-14) / anchor, power - 1.0)
            density = dr.select((chord2 >= low) & (chord2 < high), value, density)
        return density / (np.pi * self.total)
