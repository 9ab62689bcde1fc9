"""Electron rates: the transport basis under the scenario's sources, optics and sensor."""

from __future__ import annotations

import numpy as np

from experiments.chain.illumination import active_sources, responsivity, source_spectra, sun_stray_rate
from experiments.scenario import Scenario
from radiometry import stray
from radiometry.geometry import FloatArray
from radiometry.optics import node_weights
from scenes.render.transport import TransportBasis


def electron_rate(scenario: Scenario, basis: TransportBasis, illumination: str) -> FloatArray:
    """Photo-electrons per second of every pixel, (height, width), in an illumination ('eclipse' or 'sun').

    The lens's glare is spread, and stray light of the Sun added, last.

    Raises:
        ValueError: when the basis is not of the camera's size, or lacks a light that the scenario has.
    """
    camera, strength = scenario.camera, source_spectra(scenario)
    shape = (camera.height_px, camera.width_px)
    sine2 = 1 - np.sqrt(camera.natural_falloff())
    table = _incidence_table(scenario, float(sine2.max()))
    rate = np.zeros(shape)
    for source in active_sources(scenario, illumination):
        if source not in basis.layers:
            raise ValueError(f"transport basis has no {source} layers; render it again with the scenario's [{source}]")
        images = basis.layers[source]
        if images.shape[1:] != shape:
            raise ValueError(
                f"transport basis is {images.shape[2]} × {images.shape[1]} px, the camera {shape[1]} × {shape[0]} px"
            )
        weights = np.array(
            [node_weights(strength[source] * responsivity(scenario, np.arcsin(s**0.5)), basis.nodes_nm) for s in table]
        )
        if len(table) == 1:
            rate += np.tensordot(weights[0], images, axes=1)
        else:
            for image, weight in zip(images, weights.T, strict=True):
                rate += np.interp(sine2, table, weight) * image
    # The weights of the outer nodes can be negative, so a black pixel may come out at minus a rounding error.
    rate = np.maximum(rate, 0.0) * camera.relative_illumination()
    if camera.veiling_glare > 0:
        rate = stray.add_veiling_glare(rate, camera.veiling_glare)
    return rate + sun_stray_rate(scenario) if illumination == "sunlit" and camera.point_source_transmittance else rate


def _incidence_table(scenario: Scenario, largest: float) -> FloatArray:
    """Values of sin²θ up to the largest of the field, between which the filter's edges shift by 0.05 nm at most.

    Between them the weights of the nodes are taken as linear: a line of 2 nm across a steep edge allows no smoother curve.
    """
    if scenario.filter.effective_index == 0:
        return np.zeros(1)
    shift_nm = scenario.filter.high_nm * (1 - np.sqrt(1 - largest / scenario.filter.effective_index**2))
    return np.linspace(0.0, largest, 2 + int(shift_nm / 0.05))
