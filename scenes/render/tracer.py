"""The renderer's one kernel: rays of many views traced together, each lane with its own camera, lights and lattice.

Only direct light counts. Indirect light would add up to 0.7 % to the Sun's light and 0.02 % to that of the LEDs. The scene
stands still in the marker frame, in millimetres, because in metres the ray offsets would swallow the slits. Cameras and
lights are data of the lanes, and every size is data of the kernel, so no other view, region or batch compiles the kernel
again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.marker import MarkerDesign
from scenes.projection.regions import at_rest
from scenes.render.earth import earth_radiance
from scenes.render.lanes import (
    BLOCK,
    EARTH_CHOICES,
    LED_CHOICE,
    SUN_CHOICES,
    Sample,
    Segment,
    fraction,
    pack,
    unpack,
)
from scenes.render.scene import Scene, SurfaceInteraction, intersect
from scenes.target import Target
from scenes.view import MM_PER_M, View

#: Further from the camera's direction than this, tape sends little of the light back to it [rad].
_RETRO_TAIL_RAD = np.radians(10.0)
#: LEDs that light a point at the bottom of a slit, of those on the ring.
LEDS_IN_SLITS = 4


@dataclass(frozen=True)
class Kind:
    """What views must have in common to share a kernel and a scene.

    Attributes:
        marker: the design.
        surface: the target at rest.
        distorted: whether the lens has distortion.
        earth: whether there is an Earth.
        earth_about_camera: whether the Earth stands so near to the camera's direction that tape returns its light.
    """

    marker: MarkerDesign
    surface: Target
    distorted: bool
    earth: bool
    earth_about_camera: bool

    @classmethod
    def of(cls, view: View) -> Kind:
        """Kind of a view.

        Args:
            view: any view.
        """
        near = view.earth is not None and (
            np.radians(view.earth.phase_deg) < view.earth.angular_radius_rad + _RETRO_TAIL_RAD
        )
        return cls(view.marker, at_rest(view.target), view.camera.distorted, view.earth is not None, bool(near))


class Traced:
    """Radiance of lanes while the kernel still computes it, so that the caller can work in the meantime."""

    def __init__(self, spectra: dict[str, Any], nodes: int) -> None:
        self._spectra, self._nodes = spectra, nodes

    def arrays(self) -> dict[str, list[NDArray[np.float32]]]:
        """Radiance by light, an array (lanes,) for each wavelength; waits for the kernel."""
        return {
            light: [np.array(value[k], copy=False) for k in range(self._nodes)]
            for light, value in self._spectra.items()
        }


def trace(kind: Kind, segments: list[Segment], blocks: NDArray[np.int32], nodes_nm: tuple[int, ...]) -> Traced:
    """Start tracing blocks of `BLOCK` lanes at up to four wavelengths.

    Args:
        kind: of all segments' views.
        segments: the views and lattices that blocks refer to.
        blocks: (n, 4): segment, column and row of the first lane's pixel, index of its lattice point. Lanes count up lattice
            points, and go on in the next column after a pixel's last one.
        nodes_nm: the wavelengths [nm].
    """
    import drjit as dr
    import mitsuba as mi

    table, leds = _tables(segments)
    lane = dr.arange(mi.UInt32, len(blocks) * BLOCK)
    block = dr.gather(mi.Vector4i, mi.Int32(np.ascontiguousarray(blocks).ravel()), lane >> 4)
    record = unpack(table, mi.UInt32(block.x))
    sample = Sample.of(lane, block, record)
    ray = _camera_ray(sample, kind.distorted)
    interaction = intersect(_scene(kind.marker, kind.surface), ray, nodes_nm)
    spectra = {"led": _led_light(interaction, sample, leds), "sun": _sun_light(interaction, sample)}
    if kind.earth:
        draws = [sample.choice(k) for k in EARTH_CHOICES]
        spectra["earth"] = earth_radiance(
            interaction, ray, record.to_earth, record.earth_radius_rad, draws, kind.earth_about_camera
        )
    dr.eval(*spectra.values())
    return Traced(spectra, len(nodes_nm))


def _tables(segments: list[Segment]) -> tuple[Any, Any]:
    """The segments' records and the places of all their LEDs, four numbers each [mm], as Dr.Jit arrays."""
    import mitsuba as mi

    rings = [s.view.to_marker(s.view.leds.positions_m()) * MM_PER_M for s in segments]
    starts = np.concatenate([[0], np.cumsum([len(ring) for ring in rings])])
    records = np.concatenate([pack(s, int(start)) for s, start in zip(segments, starts, strict=False)])
    positions = np.zeros((starts[-1], 4), np.float32)
    positions[:, :3] = np.concatenate(rings)
    return mi.Float(records), mi.Float(positions.ravel())


def _camera_ray(sample: Sample, distorted: bool) -> Any:
    """Rays from the lens through the samples' places in the image."""
    import drjit as dr
    import mitsuba as mi

    x, y = sample.position()
    if distorted:
        x, y = sample.record.distortion.undistort(x, y)
    axes = sample.record.axes
    return mi.Ray3f(sample.record.origin, dr.normalize(axes[0] * x + axes[1] * y + axes[2]))


def _led_light(interaction: SurfaceInteraction, sample: Sample, leds: Any) -> Any:
    """Radiance per unit on-axis intensity of the whole ring [m⁻²]; the LEDs aim along the camera's axis.

    One LED a ray, evenly over the ring, or some evenly spaced ones where slits let few of them in.
    """
    import drjit as dr
    import mitsuba as mi

    record, lamps, first = sample.record, sample.record.led_count, sample.choice(LED_CHOICE)
    several = dr.select(
        interaction.deep, dr.minimum(mi.UInt32(dr.opaque(mi.UInt32, LEDS_IN_SLITS)), mi.UInt32(lamps)), 1
    )

    def one_led(k: Any, total: Any) -> tuple[Any, Any]:
        turn = fraction(first + mi.Float(k) / mi.Float(several)) * lamps
        place = dr.gather(mi.Vector4f, leds, record.first_led + mi.UInt32(dr.minimum(turn, lamps - 1)))
        led = mi.Point3f(place.x, place.y, place.z)
        to_led = led - interaction.hit.p
        distance2 = dr.squared_norm(to_led)
        to_led *= dr.rsqrt(distance2)
        cos_axis = dr.maximum(-dr.dot(to_led, record.axes[2]), 0.0)
        intensity = dr.power(cos_axis, record.led_exponent) / distance2 * MM_PER_M**2
        return k + 1, total + interaction.reflected(to_led, led) * intensity

    _, total = dr.while_loop((mi.UInt32(0), mi.Spectrum(0)), lambda k, _: k < several, one_led)
    return total / mi.Float(several)


def _sun_light(interaction: SurfaceInteraction, sample: Sample) -> Any:
    """Radiance per unit irradiance of the Sun, a uniform disc [sr⁻¹]."""
    import drjit as dr
    import mitsuba as mi

    across, along = (sample.choice(k) for k in SUN_CHOICES)
    disc = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(across, along)) * sample.record.sun_tangent
    frame = mi.Frame3f(sample.record.to_sun)
    return interaction.reflected(dr.normalize(frame.n + frame.s * disc.x + frame.t * disc.y))


@lru_cache(maxsize=4)
def _scene(marker: MarkerDesign, surface: Target) -> Scene:
    return Scene(marker, surface)
