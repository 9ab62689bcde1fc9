"""Light of the Earth's disc in the batched renderer."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes.render.scene import SurfaceInteraction

#: Squared chord below which directions about the camera's are drawn evenly: that of 0.1°, where tables of tape begin.
_CORE_CHORD2 = float(np.radians(0.1) ** 2)


def earth_radiance(
    interaction: SurfaceInteraction, ray: Any, to_earth: Any, radius_rad: Any, draws: list[Any], back_to_viewer: bool
) -> Any:
    """Radiance along each ray per unit radiance of the disc: of the surface that the ray hits, or of the disc itself behind it.

    One direction per ray is drawn evenly over the solid angle of the disc. Where the disc surrounds the camera, a second
    one is drawn about the direction to the camera, because tape sends back there what arrives from there; its density is ∝
    1/(chord² + core²). Both are weighted by the sum of their densities (balance heuristic; Veach and Guibas, SIGGRAPH
    1995).

    Args:
        interaction: what the rays hit.
        ray: the camera's rays, a lane each.
        to_earth: unit vector to the centre of the disc, in the scene's frame, a lane each.
        radius_rad: half the angle that the disc fills, a lane each [rad].
        draws: four numbers in 0 … 1 per ray.
        back_to_viewer: whether the second direction is drawn.
    """
    import drjit as dr
    import mitsuba as mi

    def opaque(value: float) -> Any:
        return dr.opaque(mi.Float, float(value))

    # 2 sin²(r/2) = 1 − cos r, without cancellation for a small disc.
    cap = 2 * dr.square(dr.sin(radius_rad / 2))
    rim, solid_angle = 1 - cap, 2 * np.pi * cap
    core, span = opaque(_CORE_CHORD2), opaque(np.log1p(4 / _CORE_CHORD2))
    earth = mi.Frame3f(to_earth)
    viewer = mi.Frame3f(-ray.d)

    def about(frame: Any, chord2: Any, azimuth: Any) -> Any:
        sine = dr.sqrt(dr.maximum(chord2 * (1 - chord2 / 4), 0.0))
        around = frame.s * dr.cos(azimuth) + frame.t * dr.sin(azimuth)
        return dr.normalize(frame.n * (1 - chord2 / 2) + around * sine)

    def estimate(direction: Any) -> Any:
        density = dr.rcp(solid_angle)
        if back_to_viewer:
            density += dr.rcp(np.pi * span * (dr.squared_norm(direction - viewer.n) + core))
        return dr.select(dr.dot(direction, earth.n) > rim, interaction.reflected(direction) / density, 0.0)

    # Equal steps of squared chord are equal solid angles.
    total = estimate(about(earth, 2 * cap * draws[0], 2 * np.pi * draws[1]))
    if back_to_viewer:
        chord2 = dr.minimum(core * (dr.exp(span * draws[2]) - 1), 4.0)
        total += estimate(about(viewer, chord2, 2 * np.pi * draws[3]))
    return dr.select(~interaction.valid & (dr.dot(ray.d, earth.n) > rim), 1.0, total)
