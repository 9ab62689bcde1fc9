"""The sunlit Earth in closed form: what an unshadowed plane sends to the camera of the light of a uniform disc."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiometry.geometry import FloatArray, normal_to
from radiometry.link import Brdf

#: Nodes on −1 … 1: across a ring between two edges, and along its arc.
_ACROSS, _ACROSS_WEIGHTS = np.polynomial.legendre.leggauss(6)
_ALONG, _ALONG_WEIGHTS = np.polynomial.legendre.leggauss(64)


def earth_transport(
    to_viewer: ArrayLike, to_earth: ArrayLike, angular_radius_rad: float, brdf: Brdf, wavelength_nm: ArrayLike
) -> FloatArray:
    """Radiance of a plane towards the viewer per unit radiance of the Earth's disc [-]: ∫ f cosθ_i dΩ over the visible disc.

    The integral is a quadrature on rings about the viewer's direction. The rings lie close together near it, where tape
    returns its light. For a Lambertian plane that sees the whole disc the result is albedo · sin²(radius) · cos(angle of
    the disc's centre from the normal).

    Args:
        to_viewer: unit vector (3,) from the plane z = 0, whose normal is z.
        to_earth: unit vector (3,) from the plane to the centre of the disc.
        angular_radius_rad: half the angle that the disc fills [rad].
        brdf: reflectance of the plane [sr⁻¹].
        wavelength_nm: (w,) [nm].

    Returns:
        (w,).
    """
    viewer, earth = np.asarray(to_viewer, float), np.asarray(to_earth, float)
    # atan2 stays accurate where the Earth stands right behind the camera.
    sideways = earth - (earth @ viewer) * viewer
    apart = float(np.arctan2(np.linalg.norm(sideways), earth @ viewer))
    nearest, furthest = max(0.0, apart - angular_radius_rad), min(np.pi, apart + angular_radius_rad)
    bends = [angular_radius_rad - apart, 2 * np.pi - apart - angular_radius_rad, nearest, furthest]
    # Arcs begin and end like square roots of the distance from the first and last ring.
    ends = (furthest - nearest) * np.geomspace(1e-4, 0.5, 8)
    edges = np.concatenate([np.geomspace(1e-4, np.pi, 28), bends, nearest + ends, furthest - ends, [0.0]])
    edges = np.unique(np.clip(edges, nearest, furthest))
    half = np.diff(edges)[:, None] / 2
    ring = (edges[:-1, None] + half * (1 + _ACROSS)).ravel()
    ring_weight = (half * _ACROSS_WEIGHTS).ravel() * np.sin(ring)

    # A point of the ring lies on the disc within this azimuth from the Earth's: spherical law of cosines.
    spread = np.sin(ring) * np.sin(apart)
    cosine = (np.cos(angular_radius_rad) - np.cos(ring) * np.cos(apart)) / np.maximum(spread, 1e-12)
    arc = np.arccos(np.clip(cosine, -1.0, 1.0))
    azimuth = arc[:, None] * _ALONG
    side = sideways / np.linalg.norm(sideways) if np.linalg.norm(sideways) > 1e-9 else normal_to(viewer)
    across = np.cos(azimuth)[..., None] * side + np.sin(azimuth)[..., None] * np.cross(viewer, side)
    towards = np.cos(ring)[:, None, None] * viewer + np.sin(ring)[:, None, None] * across
    weight = (ring_weight * arc)[:, None] * _ALONG_WEIGHTS * np.clip(towards[..., 2], 0.0, None)
    lit = weight > 0
    value = brdf(np.array([0.0, 0.0, 1.0]), towards[lit][:, None, :], viewer, np.asarray(wavelength_nm, float))
    return weight[lit] @ value
