"""Cross-checks of the chain by other people's code: stock Mitsuba, colour-science and prysm.

Each check computes the same figure twice and states the relative difference with what it can be held to.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from detector.sensor.sensor import Sensor, moments, presets
from experiments import chain
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from radiometry.optics import node_weights
from radiometry.sources import am0_spectrum
from scenes.llvm import activate_variant
from scenes.render import stock
from scenes.render.transport import MM_PER_M, Region

#: Relative difference that counts as agreement, beside the statistical uncertainty.
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Agreement:
    """Two results of one quantity.

    Attributes:
        what: the quantity.
        by: whose code is the other side.
        ours, theirs: in the same unit.
        uncertainty: relative standard uncertainty of their ratio, from sampling; 0 where nothing is sampled.
    """

    what: str
    by: str
    ours: float
    theirs: float
    uncertainty: float = 0.0

    @property
    def difference(self) -> float:
        """Relative difference, ours over theirs less one."""
        return self.ours / self.theirs - 1

    @property
    def agrees(self) -> bool:
        """True within `TOLERANCE` and four standard uncertainties of the sampling."""
        return abs(self.difference) <= TOLERANCE + 4 * self.uncertainty


def run(scenario: Scenario) -> tuple[list[Agreement], dict[str, float]]:
    """All checks of a scenario's sources, optics and materials, tilted at 2 m and with a sensor of sloped QE; and indirect light.

    prysm is a development extra; where it is not installed its lines are missing.
    """
    sensor = presets()["icx429al"].sensor
    near = scenario.at(
        range_m=2.0,
        camera=scenario.camera.model_dump() | {"width_px": 160, "height_px": 160},
        target=scenario.target.model_dump() | {"yaw_deg": 29.0, "pitch_deg": -29.0, "roll_deg": 0.0},
        sensor=sensor.model_dump(),
    )
    checks = [*stock_transport(near), *spectral_integrals(near)]
    if find_spec("prysm"):
        checks += prysm_electrons(sensor, np.array([1e4, 1e5, 1e6]), 1e-2)
    return checks, indirect_light(near)


def stock_transport(scenario: Scenario, samples: int = 64, repeats: int = 4) -> list[Agreement]:
    """Electron rates by stock `path` with `specfilm` against the composed basis, per light: bits, dark cells, whole frame.

    Stock Mitsuba samples wavelengths at random and integrates the sources' own spectra against the camera's responsivity as the
    film's response, with knots 1 nm apart (coarse knots bias it). Its film has square pixels and no point spread, so the
    scenario is taken with those.

    Args:
        scenario: its camera should be small; every pixel is rendered.
        samples: rays a pixel of each repeat.
        repeats: renderings with different seeds, whose scatter gives the uncertainty.
    """
    import mitsuba as mi

    activate_variant()
    camera = scenario.camera.model_dump() | {"psf_sigma_px": 0.0, "pixel_pitch_y_m": scenario.camera.pixel_pitch_x_m}
    scenario = scenario.at(camera=camera)
    view, basis = chain.view(scenario), chain.transport(scenario)
    response = chain.responsivity(scenario)
    grid = np.arange(np.floor(response.support_nm[0]), np.ceil(response.support_nm[1]) + 1)
    film = {
        "type": "specfilm",
        "width": view.camera.width_px,
        "height": view.camera.height_px,
        "component_format": "float32",
        "rfilter": {"type": "box"},
        "band": {
            "type": "regular",
            "wavelength_min": float(grid[0]),
            "wavelength_max": float(grid[-1]),
            "values": ",".join(f"{v:.9g}" for v in response(grid) / response.values.max()),
        },
    }
    parts = {
        "bright bits": chain.bit_pixels(view, scenario.marker.white_bit_centres_m()),
        "dark cells": chain.bit_pixels(view, scenario.marker.black_bit_centres_m()),
    }
    result = []
    for light, strength in chain.source_spectra(scenario).items():
        scale = {"led": MM_PER_M**2, "sun": 1.0}[light]  # per square millimetre inside
        with tempfile.TemporaryDirectory() as folder:
            scene = mi.load_dict(stock.stock_scene(view, {light: strength * scale}, Path(folder), dict(film)))
        theirs = [
            np.array(mi.render(scene, spp=samples, seed=k), float).reshape(basis.layers[light].shape[1:])
            * response.values.max()
            for k in range(repeats)
        ]
        weights = node_weights(strength * response, basis.nodes_nm)
        ours = np.tensordot(weights, basis.layers[light], axes=1)
        for name, pixels in parts.items():
            values = [np.mean([image[p].mean() for p in pixels]) for image in (ours, *theirs)]
            result.append(_sampled(f"electron rate of {name}, {light}", "Mitsuba path + specfilm", values))
        values = [image.mean() for image in (ours, *theirs)]
        result.append(_sampled(f"electron rate of the frame, {light}", "Mitsuba path + specfilm", values))
    return result


def _sampled(what: str, by: str, values: list[np.floating]) -> Agreement:
    """Agreement of the first value with the mean of the others."""
    theirs = np.array(values[1:], float)
    spread = float(theirs.std(ddof=1) / np.sqrt(len(theirs)) / theirs.mean())
    return Agreement(what, by, float(values[0]), float(theirs.mean()), spread)


def spectral_integrals(scenario: Scenario) -> list[Agreement]:
    """∫ source · filter · QE · λ/(hc) dλ of Sun and LED line, interpolated and integrated by colour-science.

    colour is given the solar spectrum at its own knots, 1 nm apart, and the line every 0.5 nm; it interpolates both by Sprague's
    method to 1/32 nm. Ours is linear between the knots.
    """
    import colour

    response = chain.responsivity(scenario)
    low, high = np.floor(response.support_nm[0]), np.ceil(response.support_nm[1])
    shape = colour.SpectralShape(low, high, 1 / 32)  # a power of two: colour's grids must divide exactly
    camera = _distribution(shape.wavelengths, response(shape.wavelengths))
    sun = am0_spectrum() * scenario.sun.distance_au**-2
    line = scenario.leds.spectral_intensity()
    near = np.abs(sun.wavelength_nm - (low + high) / 2) < (high - low) / 2 + 10
    grid = np.arange(low - 10, high + 10, 0.5)
    result = []
    for name, spectrum, knots in (("sun", sun, sun.wavelength_nm[near]), ("led", line, grid)):
        source = _distribution(knots, spectrum(knots)).align(shape)
        # colour's luminous flux is K ∫ V(λ) Φ(λ) dλ; with our responsivity for V and K = 1 it is the electron rate.
        theirs = float(colour.luminous_flux(source, camera, K_m=1.0))
        ours = (spectrum * response).integral()
        result.append(Agreement(f"electrons per unit transport, {name}", "colour-science", ours, theirs))
    return result


def _distribution(wavelength_nm: FloatArray, values: FloatArray) -> Any:
    import colour

    return colour.SpectralDistribution(dict(zip(wavelength_nm, values, strict=True)))


def prysm_electrons(
    sensor: Sensor, rates: FloatArray, exposure_s: float, frames: int = 2000, seed: int = 1
) -> list[Agreement]:
    """Mean and variance of the digital numbers of prysm's detector against the closed-form moments, one pair a rate.

    prysm adds bias and read noise in electrons, divides by the gain and rounds down where ours rounds to the nearest, so its
    bias is half a number more. Both use a Poisson law for the charge; prysm's full well would clip the bias too and is left open.

    Raises:
        ImportError: when prysm, a development extra, is not installed.
    """
    from prysm.detector import Detector

    gain, shape = sensor.gain_electrons_per_dn, (frames, 64)
    # prysm draws from numpy's global state; it is put back afterwards.
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        device = Detector(
            dark_current=sensor.dark_rate_electrons_per_s,
            read_noise=sensor.read_noise_electrons,
            bias=(sensor.offset_dn + 0.5) * gain,
            fwc=np.inf,
            conversion_gain=gain,
            bits=sensor.bits,
            exposure_time=exposure_s,
        )
        drawn = [np.asarray(device.expose(np.full(shape, rate)), float) for rate in rates]
    finally:
        np.random.set_state(state)  # noqa: NPY002
    result = []
    for rate, dn in zip(rates, drawn, strict=True):
        mean, variance = (float(m[0]) for m in moments(sensor, np.array([rate]), exposure_s))
        level, drawn_level = mean - sensor.offset_dn, dn.mean() - sensor.offset_dn
        of_mean, of_variance = np.sqrt(variance / dn.size) / level, np.sqrt(2 / (dn.size - 1))
        charge = f"{rate * exposure_s:.0f} e-"
        result += [
            Agreement(f"mean of {charge}", "prysm", level, drawn_level, of_mean),
            Agreement(f"variance of {charge}", "prysm", variance, dn.var(ddof=1), of_variance),
        ]
    return result


def indirect_light(scenario: Scenario, samples: int = 4) -> dict[str, float]:
    """Relative gain of bits, dark cells and frame when stock `path` follows light over four segments instead of two.

    Returns:
        By '<part>, <light>'. Nothing faces the front plane, so bits and cells gain nothing; foil and cavities do.
    """
    activate_variant()
    view, camera = chain.view(scenario), scenario.camera
    region = Region(0, 0, camera.width_px, camera.height_px, 4)
    parts = {"bright bits": scenario.marker.white_bit_centres_m(), "dark cells": scenario.marker.black_bit_centres_m()}
    result = {}
    for light in chain.source_spectra(scenario):
        node = scenario.leds.centroid_nm
        direct, full = (
            stock.render_subpixels(
                view, region, pad=0, node_nm=round(node), light=light, seed=1, spp=samples, depth=depth
            )
            for depth in (2, 4)
        )
        row_scale = direct.shape[0] / camera.height_px
        for name, centres in parts.items():
            column, row = view.to_image(centres).T
            at = np.floor((row + 0.5) * row_scale).astype(int), np.floor((column + 0.5) * 4).astype(int)
            result[f"{name}, {light}"] = float(full[at].mean() / direct[at].mean() - 1)
        result[f"frame, {light}"] = float(full.mean(dtype=float) / direct.mean(dtype=float) - 1)
    return result
