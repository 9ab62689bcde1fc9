"""Reflectance of a material in the retroreflection plane, as a goniometer measures it."""

from __future__ import annotations

import numpy as np

from materials.library import Material
from radiometry.geometry import FloatArray

#: The wavelength of the illuminator, at which the table holds [nm].
WAVELENGTH_NM = 850.0


def goniometer_scan(
    material: Material, entrance_deg: float, observation_deg: FloatArray, nm: float = WAVELENGTH_NM
) -> FloatArray:
    """BRDF f [sr⁻¹] against observation angle, for a source at one entrance angle.

    The viewer moves from the source through the normal, so a mirror glints at an observation angle of 2β.

    Args:
        material: the surface.
        entrance_deg: angle β of the source from the normal [deg].
        observation_deg: angles between source and viewer, (n,) [deg].
        nm: wavelength [nm].

    Returns:
        (n,) [sr⁻¹].
    """
    source = np.radians(entrance_deg)
    viewer = source - np.radians(observation_deg)
    to_viewer = np.stack([np.sin(viewer), np.zeros_like(viewer), np.cos(viewer)], axis=-1)
    return material.brdf([0.0, 0.0, 1.0], [np.sin(source), 0.0, np.cos(source)], to_viewer, nm)
