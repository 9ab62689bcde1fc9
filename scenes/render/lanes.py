"""Lanes of the renderer's kernel: the rays of a view that share a lattice, and the record of numbers that each lane carries.

`pack` writes a record with numpy, `unpack` reads it with Dr.Jit. Both go by `_SIZES`, so the order of the numbers stands once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiometry.distortion import BrownConrady
from radiometry.geometry import FloatArray
from scenes.render.lattice import points
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
#: Which of the choices each light takes.
LED_CHOICE, SUN_CHOICES, EARTH_CHOICES = 0, (1, 2), (3, 4, 5, 6)


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
        """Places (count, 2) of the rays in every pixel, −0.5 … 0.5 from its centre [px]."""
        return points(self.count, self.generator, self.shift)


@dataclass(frozen=True)
class LaneRecord:
    """What every lane knows of its view and lattice: Dr.Jit variables, in the marker frame and in millimetres.

    Attributes:
        origin: centre of the lens.
        axes: the camera's x, y and z axis.
        tangent_per_px: inverse focal lengths along columns and rows.
        principal_point_px: column and row.
        distortion: of the lens.
        count, generator, shift: the lattice of every pixel.
        offsets: where the light choices start, CHOICES numbers in 0 … 1.
        first_led, led_count: the view's LEDs in the table of all LEDs.
        led_exponent: of the intensity pattern cosⁿθ.
        to_sun, sun_tangent: direction to the Sun's centre, and the tangent of its angular radius.
        to_earth, earth_radius_rad: direction to the Earth's centre and its angular radius; zero without an Earth.
    """

    origin: Any
    axes: tuple[Any, Any, Any]
    tangent_per_px: tuple[Any, Any]
    principal_point_px: tuple[Any, Any]
    distortion: BrownConrady
    count: Any
    generator: Any
    shift: tuple[Any, Any]
    offsets: tuple[Any, ...]
    first_led: Any
    led_count: Any
    led_exponent: Any
    to_sun: Any
    sun_tangent: Any
    to_earth: Any
    earth_radius_rad: Any


#: Numbers of each field of a record, in the order in which they stand in the table.
_SIZES = {
    "origin": 3,
    "axes": 9,
    "tangent_per_px": 2,
    "principal_point_px": 2,
    "distortion": 5,
    "count": 1,
    "generator": 1,
    "shift": 2,
    "offsets": CHOICES,
    "first_led": 1,
    "led_count": 1,
    "led_exponent": 1,
    "to_sun": 3,
    "sun_tangent": 1,
    "to_earth": 3,
    "earth_radius_rad": 1,
}
_ENDS = np.cumsum(list(_SIZES.values()))
_PLACES = {name: slice(int(end) - size, int(end)) for (name, size), end in zip(_SIZES.items(), _ENDS, strict=True)}
#: Vectors of four numbers that hold one record.
_VECTORS = -(-int(_ENDS[-1]) // 4)


def pack(segment: Segment, first_led: int) -> NDArray[np.float32]:
    """The record of a segment's lanes, as a row of the kernel's table.

    Args:
        segment: the view and the lattice.
        first_led: index of the view's first LED in the table of all LEDs.

    Returns:
        float32 of a fixed length.
    """
    view, camera, earth = segment.view, segment.view.camera, segment.view.earth
    fields = {
        "origin": view.to_marker(np.zeros(3)) * MM_PER_M,
        "axes": view.rotation.ravel(),
        "tangent_per_px": 1 / np.array(camera.focal_px),
        "principal_point_px": camera.principal_point_px,
        "distortion": (camera.k1, camera.k2, camera.p1, camera.p2, camera.k3),
        "count": segment.count,
        "generator": segment.generator,
        "shift": segment.shift,
        "offsets": segment.offsets,
        "first_led": first_led,
        "led_count": view.leds.count,
        "led_exponent": view.leds.exponent,
        "to_sun": view.sun_in_marker,
        "sun_tangent": np.tan(view.sun.angular_radius_rad),
        "to_earth": np.zeros(3) if earth is None else view.earth_in_marker,
        "earth_radius_rad": 0.0 if earth is None else earth.angular_radius_rad,
    }
    row = np.zeros(4 * _VECTORS)
    for name, place in _PLACES.items():
        row[place] = fields[name]
    return row.astype(np.float32)


def unpack(table: Any, segment: Any) -> LaneRecord:
    """The records of lanes, from a table of rows that `pack` made.

    Args:
        table: the rows, one after the other.
        segment: index of each lane's row.
    """
    import drjit as dr
    import mitsuba as mi

    vectors = [dr.gather(mi.Vector4f, table, segment * _VECTORS + k) for k in range(_VECTORS)]
    numbers = [number for vector in vectors for number in (vector.x, vector.y, vector.z, vector.w)]
    fields = {name: numbers[place] for name, place in _PLACES.items()}
    axes = fields["axes"]
    return LaneRecord(
        origin=mi.Point3f(*fields["origin"]),
        axes=(mi.Vector3f(*axes[:3]), mi.Vector3f(*axes[3:6]), mi.Vector3f(*axes[6:])),
        tangent_per_px=(fields["tangent_per_px"][0], fields["tangent_per_px"][1]),
        principal_point_px=(fields["principal_point_px"][0], fields["principal_point_px"][1]),
        distortion=BrownConrady(*fields["distortion"]),
        count=mi.UInt32(fields["count"][0]),
        generator=mi.UInt32(fields["generator"][0]),
        shift=(fields["shift"][0], fields["shift"][1]),
        offsets=tuple(fields["offsets"]),
        first_led=mi.UInt32(fields["first_led"][0]),
        led_count=fields["led_count"][0],
        led_exponent=fields["led_exponent"][0],
        to_sun=mi.Vector3f(*fields["to_sun"]),
        sun_tangent=fields["sun_tangent"][0],
        to_earth=mi.Vector3f(*fields["to_earth"]),
        earth_radius_rad=fields["earth_radius_rad"][0],
    )


def fraction(x: Any) -> Any:
    """Fractional part of a Dr.Jit number, 0 … 1.

    Args:
        x: any finite number.
    """
    import drjit as dr

    return x - dr.floor(x)


@dataclass(frozen=True)
class Sample:
    """Which ray every lane traces.

    Attributes:
        column, row: the pixel.
        index: of the ray in the pixel's lattice.
        record: what the lane knows of its view.
    """

    column: Any
    row: Any
    index: Any
    record: LaneRecord

    @classmethod
    def of(cls, lane: Any, block: Any, record: LaneRecord) -> Sample:
        """Samples of lanes.

        Args:
            lane: number of each lane, from zero.
            block: the lane's row of the table of blocks (`scenes.render.tracer.trace`).
            record: the lane's record.
        """
        import mitsuba as mi

        index = mi.UInt32(block.w) + (lane & (BLOCK - 1))
        over = index // record.count
        return cls(block.y + mi.Int32(over), block.z, index - over * record.count, record)

    def position(self) -> tuple[Any, Any]:
        """Where the ray passes the image, from the principal point [tangent], distortion included."""
        import drjit as dr
        import mitsuba as mi

        record, (cx, cy) = self.record, self.record.principal_point_px
        per_point = dr.rcp(mi.Float(record.count))
        turned = mi.Float(self.index * record.generator % record.count)
        x = (mi.Float(self.column) - cx) + (fraction(mi.Float(self.index) * per_point + record.shift[0]) - 0.5)
        y = (mi.Float(self.row) - cy) + (fraction(turned * per_point + record.shift[1]) - 0.5)
        return x * record.tangent_per_px[0], y * record.tangent_per_px[1]

    def choice(self, k: int) -> Any:
        """A number in 0 … 1 for one of the choices of light.

        Args:
            k: which of the `CHOICES`.
        """
        import mitsuba as mi

        a, b, c = (mi.UInt32(int(stride)) for stride in _STRIDES[k])
        start = mi.UInt32(self.record.offsets[k] * 2**24) << 8
        turned = self.index * a + mi.UInt32(self.column) * b + mi.UInt32(self.row) * c + start
        return mi.Float(turned >> 8) * 2**-24
