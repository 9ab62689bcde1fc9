"""A material's lobe in the retroreflection plane, as a goniometer reads it."""

from __future__ import annotations

import numpy as np

from materials.library import Material
from radiometry.geometry import FloatArray

#: The wavelength of the illuminator, at which the table holds [nm].
WAVELENGTH_NM = 850.0


def goniometer_scan(
    material: Material, entrance_deg: float, observation_deg: FloatArray, nm: float = WAVELENGTH_NM
) -> FloatArray:
    """f [sr⁻¹] against observation angle, the viewer moving from the source through the normal: a mirror glints at 2β."""
    source = np.radians(entrance_deg)
    viewer = source - np.radians(observation_deg)
    to_viewer = np.stack([np.sin(viewer), np.zeros_like(viewer), np.cos(viewer)], axis=-1)
    return material.brdf([0.0, 0.0, 1.0], [np.sin(source), 0.0, np.cos(source)], to_viewer, nm)
