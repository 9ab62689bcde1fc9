"""The renderer's own noise beside shot noise."""

from __future__ import annotations

import numpy as np

from detector.sensor.sensor import usable_well_electrons
from experiments.chain.illumination import active_sources, responsivity, source_spectra
from experiments.chain.rate import electron_rate
from experiments.chain.view import view
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from radiometry.optics import node_weights
from scenes.projection.regions import frame_box, marker_box, marker_pixels
from scenes.render import density
from scenes.render.transport import TransportBasis


def renderer_variance_fraction(
    scenario: Scenario, basis: TransportBasis, illumination: str, seconds: float, rate: FloatArray | None = None
) -> float:
    """Largest share of the renderer's variance in shot noise's, over the ArUco's and the elements' pixels, in an exposure.

    A pixel that would overflow counts in the exposure that just fills it. The renderer's variance is that of two independent
    halves of the rays, averaged over 5 × 5 pixels (`scenes.render.density.variance_fractions`). It is NaN where the basis
    does not tell it, or where no such pixel is in the frame.

    Args:
        scenario: of which the basis is.
        basis: with the renderer's own noise.
        illumination: 'eclipse' or 'sunlit'.
        seconds: exposure [s].
        rate: `electron_rate` of the same, where it is known.
    """
    if any(source not in basis.noise for source in active_sources(scenario, illumination)):
        return float("nan")
    scene_view = view(scenario)
    frame = frame_box(scene_view)
    box = marker_box(scene_view).within(frame)
    seen, part = marker_pixels(scene_view, box), box.slices(frame)
    pixels = seen.aruco | seen.opening
    if not pixels.any():
        return float("nan")
    strength, response = source_spectra(scenario), responsivity(scenario)
    falloff = scenario.camera.relative_illumination()[part] * seconds
    draw = np.zeros(pixels.shape)
    for source in active_sources(scenario, illumination):
        # The noise is a mean over the wavelengths; reflectances vary little over a passband.
        draw += basis.noise[source][part] * float(np.sum(node_weights(strength[source] * response, basis.nodes_nm)))
    electrons = (electron_rate(scenario, basis, illumination) if rate is None else rate)[part] * seconds
    fill = np.minimum(1.0, usable_well_electrons(scenario.sensor) / np.maximum(electrons, 1e-12))
    return float(density.variance_fractions(draw * falloff * fill, electrons * fill, pixels)[pixels].max())
