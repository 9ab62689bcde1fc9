"""The renderer's one kernel: rays of many views traced together, each lane with its own camera, lights and lattice.

Direct light only: indirect light adds up to 0.7 % in the Sun and 0.02 % in the LEDs' light. The scene stands still in the marker
frame, in millimetres, for ray offsets would swallow the slits in metres; cameras and lights are data of the lanes, and every size
is data of the kernel, so that no other view, region or batch compiles it again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometry.distortion import BrownConrady
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign
from scenes.projection.regions import at_rest
from scenes.render.earth import earth_radiance
from scenes.render.lattice import points
from scenes.render.scene import Scene, intersect
from scenes.target import Target
from scenes.view import MM_PER_M, View

#: Lanes that share a block's data: rays of one pixel, or of neighbouring pixels of one row.
BLOCK = 16
#: Odd multipliers that spread light choices evenly over a lattice's points, columns and rows: fractions of 2³² (golden ratio and
#: Roberts' R2 sequence, then square roots), by choice: LED, two of the Sun's disc, four of the Earth's.
_STRIDES = np.rint(
    np.array(
        [
            [0.6180339887, 0.7548776662, 0.5698402910],
            [0.7548776662, 0.5698402910, 0.6180339887],
            [0.5698402910, 0.6180339887, 0.4142135624],
            [0.7320508076, 0.7548776662, 0.6180339887],
            [0.2360679775, 0.5698402910, 0.4142135624],
            [0.6457513111, 0.4142135624, 0.7548776662],
            [0.3166247904, 0.7320508076, 0.6180339887],
        ]
    )
    * 2**32
).astype(np.uint64)
CHOICES = len(_STRIDES)
#: Further from the camera's direction than this, tape sends little of the light back to it [rad].
_RETRO_TAIL_RAD = np.radians(10.0)
#: Vectors of four numbers that hold one segment's data.
_ROWS = 11
#: LEDs that light a point at the bottom of a slit, of those on the ring.
LEDS_IN_SLITS = 4


@dataclass(frozen=True, eq=False)
class Segment:
    """Rays of one view and one lattice.

    Attributes:
        count, generator, shift: the lattice of every pixel (`scenes.render.lattice.points`).
        offsets: where its light choices start, (CHOICES,) in 0 … 1.
    """

    view: View
    count: int
    generator: int
    shift: FloatArray
    offsets: FloatArray

    @property
    def positions(self) -> FloatArray:
        """Places (count, 2) of the rays in every pixel."""
        return points(self.count, self.generator, self.shift)


@dataclass(frozen=True)
class Kind:
    """What makes views share a kernel and a scene."""

    marker: MarkerDesign
    surface: Target
    distorted: bool
    earth: bool
    earth_about_camera: bool

    @classmethod
    def of(cls, view: View) -> Kind:
        """Kind of a view."""
        near = view.earth is not None and (
            np.radians(view.earth.phase_deg) < view.earth.angular_radius_rad + _RETRO_TAIL_RAD
        )
        return cls(view.marker, at_rest(view.target), view.camera.distorted, view.earth is not None, bool(near))


class Traced:
    """Radiance of lanes on its way: the kernel runs while others work."""

    def __init__(self, spectra: dict[str, Any], nodes: int) -> None:
        self._spectra, self._nodes = spectra, nodes

    def arrays(self) -> dict[str, list[NDArray[np.float32]]]:
        """By light and wavelength, (lanes,); waits for the kernel."""
        return {
            light: [np.array(value[k], copy=False) for k in range(self._nodes)]
            for light, value in self._spectra.items()
        }


def trace(kind: Kind, segments: list[Segment], blocks: NDArray[np.int32], nodes_nm: tuple[int, ...]) -> Traced:
    """Start tracing blocks of `BLOCK` lanes at up to four wavelengths.

    Args:
        blocks: (n, 4): segment, column and row of the first lane's pixel, index of its lattice point. Lanes count up lattice
            points, and go on in the next column after a pixel's last one.
    """
    import drjit as dr
    import mitsuba as mi

    rings = [s.view.to_marker(s.view.leds.positions_m()) * MM_PER_M for s in segments]
    starts = np.concatenate([[0], np.cumsum([len(ring) for ring in rings])])
    table = mi.Float(np.concatenate([_row(s, int(start)) for s, start in zip(segments, starts, strict=False)]))
    positions = np.zeros((starts[-1], 4), np.float32)
    positions[:, :3] = np.concatenate(rings)
    led_table = mi.Float(positions.ravel())

    lane = dr.arange(mi.UInt32, len(blocks) * BLOCK)
    block = dr.gather(mi.Vector4i, mi.Int32(np.ascontiguousarray(blocks).ravel()), lane >> 4)
    base = mi.UInt32(block.x) * _ROWS
    data = [dr.gather(mi.Vector4f, table, base + k) for k in range(_ROWS)]
    origin, led_start = mi.Point3f(data[0].x, data[0].y, data[0].z), mi.UInt32(data[0].w)
    axes = [mi.Vector3f(d.x, d.y, d.z) for d in data[1:4]]  # the camera's, in the marker frame
    (per_fx, per_fy), (cx, cy) = (data[1].w, data[2].w), (data[3].w, data[4].x)
    count, step = mi.UInt32(data[5].z), mi.UInt32(data[5].w)

    index = mi.UInt32(block.w) + (lane & (BLOCK - 1))
    over = index // count
    index -= over * count
    column, row = block.y + mi.Int32(over), block.z
    per_point = dr.rcp(mi.Float(count))

    def fraction(x: Any) -> Any:
        return x - dr.floor(x)

    def choice(k: int, offset: Any) -> Any:
        """A number in 0 … 1 for the k-th choice of light."""
        a, b, c = (mi.UInt32(int(v)) for v in _STRIDES[k])
        turned = index * a + mi.UInt32(column) * b + mi.UInt32(row) * c + (mi.UInt32(offset * 2**24) << 8)
        return mi.Float(turned >> 8) * 2**-24

    x = (mi.Float(column) - cx) + (fraction(mi.Float(index) * per_point + data[6].x) - 0.5)
    y = (mi.Float(row) - cy) + (fraction(mi.Float(index * step % count) * per_point + data[6].y) - 0.5)
    x, y = x * per_fx, y * per_fy
    if kind.distorted:
        x, y = BrownConrady(data[9].x, data[9].y, data[9].z, data[9].w, data[8].w).undistort(x, y)
    ray = mi.Ray3f(origin, dr.normalize(axes[0] * x + axes[1] * y + axes[2]))
    interaction = intersect(_scene(kind.marker, kind.surface), ray, nodes_nm)

    # LED ring: one LED a ray, evenly over the ring, or some evenly spaced ones where slits let few of them in; intensity pattern
    # about the camera's axis.
    lamps, first = data[5].x, choice(0, data[6].z)
    several = dr.select(
        interaction.deep, dr.minimum(mi.UInt32(dr.opaque(mi.UInt32, LEDS_IN_SLITS)), mi.UInt32(lamps)), 1
    )

    def one_led(k: Any, total: Any) -> tuple[Any, Any]:
        turn = fraction(first + mi.Float(k) / mi.Float(several)) * lamps
        place = dr.gather(mi.Vector4f, led_table, led_start + mi.UInt32(dr.minimum(turn, lamps - 1)))
        led = mi.Point3f(place.x, place.y, place.z)
        to_led = led - interaction.hit.p
        distance2 = dr.squared_norm(to_led)
        to_led *= dr.rsqrt(distance2)
        cos_axis = dr.maximum(-dr.dot(to_led, axes[2]), 0.0)
        intensity = dr.power(cos_axis, data[5].y) / distance2 * MM_PER_M**2
        return k + 1, total + interaction.reflected(to_led, led) * intensity

    _, total = dr.while_loop((mi.UInt32(0), mi.Spectrum(0)), lambda k, _: k < several, one_led)
    spectra = {"led": total / mi.Float(several)}

    # Sun: a uniform disc.
    disc = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(choice(1, data[6].w), choice(2, data[7].x))) * data[4].y
    frame = mi.Frame3f(mi.Vector3f(data[8].x, data[8].y, data[8].z))
    spectra["sun"] = interaction.reflected(dr.normalize(frame.n + frame.s * disc.x + frame.t * disc.y))

    if kind.earth:
        draws = [choice(3 + k, offset) for k, offset in enumerate((data[7].y, data[7].z, data[7].w, data[4].z))]
        towards = mi.Vector3f(data[10].x, data[10].y, data[10].z)
        spectra["earth"] = earth_radiance(interaction, ray, towards, data[10].w, draws, kind.earth_about_camera)
    dr.eval(*spectra.values())
    return Traced(spectra, len(nodes_nm))


def _row(segment: Segment, led_start: int) -> NDArray[np.float32]:
    """Data of a segment's lanes, (4 _ROWS,)."""
    view, camera = segment.view, segment.view.camera
    row = np.zeros((_ROWS, 4))
    row[0] = *(view.to_marker(np.zeros(3)) * MM_PER_M), led_start
    row[1:4, :3] = view.rotation
    row[1:3, 3] = 1 / np.array(camera.focal_px)
    row[3, 3], row[4, 0] = camera.principal_point_px
    row[4, 1:3] = np.tan(view.sun.angular_radius_rad), segment.offsets[6]
    row[5] = view.leds.count, view.leds.exponent, segment.count, segment.generator
    row[6] = *segment.shift, *segment.offsets[:2]
    row[7] = segment.offsets[2:6]
    row[8] = *view.sun_in_marker, camera.k3
    row[9] = camera.k1, camera.k2, camera.p1, camera.p2
    if view.earth is not None:
        row[10] = *view.earth_in_marker, view.earth.angular_radius_rad
    return row.astype(np.float32).ravel()


@lru_cache(maxsize=4)
def _scene(marker: MarkerDesign, surface: Target) -> Scene:
    return Scene(marker, surface)
