"""A few wavelengths that carry all others: the radiance of a ray is linear in the reflectances of what it hits.

The lobes of a material have one spectrum each. Transport at any wavelength is therefore a fixed combination of transport at
as many wavelengths as those spectra have independent shapes: a single one where all spectra are flat.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from materials import library
from radiometry.geometry import FloatArray

#: Largest error of a combination, over the largest reflectance of a spectrum: single precision's.
_EXACT = 1e-7


def carriers(materials: tuple[str, ...], nodes_nm: tuple[int, ...]) -> tuple[tuple[int, ...], FloatArray]:
    """Which wavelengths to trace, and how they make up all.

    Args:
        materials: names of all materials of the scene.
        nodes_nm: wavelengths wanted.

    Returns:
        The wavelengths to trace, r of the wanted ones, and coefficients (nodes, r).
    """
    return _chosen(tuple(library.fingerprint(name) for name in materials), materials, nodes_nm)


@lru_cache(maxsize=64)
def _chosen(
    _: tuple[str, ...], materials: tuple[str, ...], nodes_nm: tuple[int, ...]
) -> tuple[tuple[int, ...], FloatArray]:
    spectra = [s for name in materials for m in [library.load(name)] for s in (m.diffuse, m.gloss, m.retro)]
    # What shines by itself is the same at all wavelengths.
    shapes = np.array([np.ones(len(nodes_nm)), *(s(np.array(nodes_nm, float)) for s in spectra)])
    shapes = shapes[shapes.max(axis=1) > 0]
    shapes /= shapes.max(axis=1, keepdims=True)
    _, _, order = qr(shapes, mode="economic", pivoting=True)
    for count in range(1, len(nodes_nm) + 1):
        picked: NDArray[np.intp] = np.sort(order[:count])
        coefficients = np.linalg.lstsq(shapes[:, picked], shapes)[0].T
        if np.abs(shapes[:, picked] @ coefficients.T - shapes).max() <= _EXACT:
            break
    return tuple(nodes_nm[k] for k in picked), coefficients
