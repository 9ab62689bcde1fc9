"""Rays against a Mantis Marker in closed form: the same marker as its triangles, several times faster.

The front plane is a table of cells. A slit is a convex cell between two planes through the element's virtual line, the two
side walls and the floor, open at the front. A ray that enters it hits the first of those planes. A point in it sees
everything that a straight line through its opening reaches. With the virtual line at depth V, w = u₀ + (u − u₀) V / (V + z)
is constant on every plane through the line and equals u on the front plane, so a slit is an interval of w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from scenes.marker import MarkerDesign
from scenes.view import MM_PER_M


@dataclass
class MarkerHit:
    """Where rays hit the marker, a lane each.

    Attributes:
        found: whether the ray passes through the marker's front square, and so hits the marker.
        distance: along the ray [mm].
        normal: of the surface, outwards.
        bright: whether the surface is reflective.
        floor: whether it is the floor of a slit.
    """

    found: Any
    distance: Any
    normal: Any
    bright: Any
    floor: Any
    _inside: Any  # in a slit, below the front plane
    _opening: tuple[Any, Any, Any, Any]  # bounds of the slit's opening on the front plane: x0, x1, y0, y1

    def sees(self, point: Any, towards: Any) -> Any:
        """Whether light from a direction reaches the points, which lie on or below the front plane.

        Args:
            point: points in the marker frame [mm].
            towards: direction to the light.
        """
        import drjit as dr

        reach = -point.z / towards.z
        x, y = point.x + towards.x * reach, point.y + towards.y * reach
        x0, x1, y0, y1 = self._opening
        through = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        return (towards.z > 0) & (~self._inside | through | dr.isnan(reach))


class MarkerRays:
    """One marker design in closed form. Its dimensions are data of the kernel."""

    def __init__(self, design: MarkerDesign) -> None:
        import drjit as dr
        import mitsuba as mi

        def number(metres: float) -> Any:
            return dr.opaque(mi.Float, float(metres * MM_PER_M))

        self._half, self._aruco = number(design.size_m / 2), number(design.aruco_m / 2)
        self._ring = number(design.aruco_m * (0.5 + design.ring_fraction))
        self._bit, self._cells = number(design.bit_m), dr.opaque(mi.UInt32, len(design.bits))
        self._bits = mi.UInt32(np.ascontiguousarray(design.bits, np.uint32).ravel())
        pitch = design.element_length_m / design.slit_count
        self._pitch, self._slat = number(pitch), number(design.slat_fraction * pitch / 2)
        self._depth, self._virtual = number(design.element_depth_m), number(design.elements[0].virtual_depth_m)
        self._half_width, self._half_length = (
            number(design.elements[0].width_m / 2),
            number(design.element_length_m / 2),
        )
        self._elements = [
            (abs(element.along[0]) > 0.5, *(number(v) for v in (place, element.shift_m, element.virtual_offset_m)))
            for element in design.elements
            for place in [float(element.centre_m @ element.across)]
        ]

    def find(self, origin: Any, direction: Any) -> MarkerHit:
        """Intersect rays that come from in front of the marker with it.

        Args:
            origin: of the rays in the marker frame [mm].
            direction: unit vectors in the marker frame.
        """
        import drjit as dr
        import mitsuba as mi

        distance = -origin.z / direction.z
        x, y = origin.x + direction.x * distance, origin.y + direction.y * distance
        reach = dr.maximum(dr.abs(x), dr.abs(y))
        found = (direction.z < 0) & (reach <= self._half)
        cell_x = dr.clip(mi.UInt32(dr.maximum(x + self._aruco, 0.0) / self._bit), 0, self._cells - 1)
        cell_y = dr.clip(mi.UInt32(dr.maximum(self._aruco - y, 0.0) / self._bit), 0, self._cells - 1)
        bright = dr.gather(mi.UInt32, self._bits, cell_y * self._cells + cell_x, found) != 0
        bright = dr.select(reach < self._aruco, bright, reach < self._ring)

        # The element whose opening the ray goes through, in its own coordinates: u along, v across.
        opening, along_x = mi.Bool(False), mi.Bool(False)
        place, shift, virtual = mi.Float(0), mi.Float(0), mi.Float(0)
        for horizontal, *numbers in self._elements:
            u, v = (x, y) if horizontal else (y, x)
            here = (dr.abs(u - numbers[1]) < self._half_length) & (dr.abs(v - numbers[0]) < self._half_width)
            opening |= here
            along_x |= here & horizontal
            place, shift, virtual = (
                dr.select(here, new, old) for new, old in zip(numbers, (place, shift, virtual), strict=True)
            )
        opening &= found
        u, v = dr.select(along_x, x, y), dr.select(along_x, y, x)
        du, dv = dr.select(along_x, direction.x, direction.y), dr.select(along_x, direction.y, direction.x)
        start = shift - self._half_length
        step = (u - start) / self._pitch
        slit = dr.floor(step)
        low, high = start + slit * self._pitch + self._slat, start + (slit + 1) * self._pitch - self._slat
        inside = opening & (u > low) & (u < high)

        # The first wall behind the opening. A plane of constant w through the virtual line is u − u₀ = (w − u₀)(1 + z/V), which
        # a ray from (u, 0) meets after s = (w − u) / (du − (w − u₀) dz / V).
        far = dr.opaque(mi.Float, np.inf)

        def after(numerator: Any, denominator: Any) -> Any:
            time = numerator / denominator
            return dr.select(time > 0, time, far)

        slope = direction.z / self._virtual
        to_low = after(low - u, du - (low - virtual) * slope)
        to_high = after(high - u, du - (high - virtual) * slope)
        to_near = after(place - self._half_width - v, dv)
        to_far = after(place + self._half_width - v, dv)
        to_floor = -self._depth / direction.z
        deeper = dr.minimum(dr.minimum(dr.minimum(to_low, to_high), dr.minimum(to_near, to_far)), to_floor)
        floor = inside & (deeper == to_floor)

        # Normals into the slit: of the planes of constant w along (±1, ∓(w − u₀)/V), of the side walls across.
        lower, higher = deeper == to_low, deeper == to_high
        along = dr.select(lower, 1.0, dr.select(higher, -1.0, 0.0))
        lean = dr.select(lower, -(low - virtual), dr.select(higher, high - virtual, 0.0)) / self._virtual
        across = dr.select(deeper == to_near, 1.0, dr.select(deeper == to_far, -1.0, 0.0))
        wall = dr.normalize(mi.Vector3f(dr.select(along_x, along, across), dr.select(along_x, across, along), lean))
        flat = ~inside | floor
        bounds = low, high, place - self._half_width, place + self._half_width
        return MarkerHit(
            found=found,
            distance=distance + dr.select(inside, deeper, 0.0),
            normal=dr.select(flat, mi.Vector3f(0, 0, 1), wall),
            bright=dr.select(opening, floor, bright),
            floor=floor,
            _inside=inside,
            _opening=tuple(dr.select(along_x, bounds[k], bounds[(k + 2) % 4]) for k in range(4)),
        )
