"""Other fiducials in the marker's place: square tags of any of OpenCV's dictionaries, and dots of which one stands on a post.

They are compared with the Mantis Marker at equal outer size. In a `View` they stand where the marker does, in the plane z =
0 of the marker frame with its origin at the centre, and they answer everything that the renderer asks of a marker.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign, Mesh, aruco_dictionary
from scenes.view import View

Side = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
#: A length over the plate's side that fits between its edge and its centre.
FractionBelowHalf = Annotated[float, Field(gt=0, lt=0.5, allow_inf_nan=False)]

#: Sides of the polygon that stands for a dot: its area is 0.3 % below the circle's.
_DOT_SIDES = 48
#: Dots lie this much above their plate, so that rays do not take one for the other [m].
_DOT_LIFT_M = 1e-5


class _Plate(BaseModel):
    """What the renderer asks of anything in the marker's place. A plate has no encoding elements."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @property
    def size_m(self) -> float:
        """Side of the square that is sampled densely [m]."""
        raise NotImplementedError

    @property
    def bit_m(self) -> float:
        """Distance between edges of the pattern [m]."""
        raise NotImplementedError

    def meshes(self) -> dict[str, Mesh]:
        """Triangles by 'retro' and 'absorber': vertices (n, 3) [m] and faces (m, 3), wound outwards."""
        raise NotImplementedError

    @property
    def aruco_m(self) -> float:
        """Side of the pattern [m]."""
        return self.size_m

    @property
    def elements(self) -> tuple[()]:
        """No encoding elements."""
        return ()

    @property
    def ring_fraction(self) -> float:
        """Width of what belongs to the pattern around it, over its side."""
        return 0.0

    @property
    def slit_count(self) -> int:
        """One slit as long as two bits: edges as close as the pattern's, for the choice of sampling."""
        return 1

    @property
    def element_length_m(self) -> float:
        return 2 * self.bit_m

    @property
    def element_depth_m(self) -> float:
        """Nothing lies below the plate's front [m]."""
        return 0.0

    @property
    def thickness_m(self) -> float:
        """Front to mounting plane [m]."""
        return 0.05 * self.size_m


class TagPlate(_Plate):
    """A printed square tag: black border and bits, a bright quiet zone one cell wide, and an absorbing rim one cell wide."""

    dictionary: str = Field("4X4_50", description="OpenCV dictionary without its DICT_ prefix")
    identity: int = Field(0, ge=0, description="index in the dictionary")
    side_m: Side = Field(0.10, description="outer side of the black border [m]")

    @property
    def bits(self) -> NDArray[np.bool_]:
        """Printed pattern with its black border, (n, n), row 0 on top; True is bright."""
        chosen = aruco_dictionary(self.dictionary)
        return chosen.generateImageMarker(self.identity, chosen.markerSize + 2, borderBits=1) > 127

    @property
    def bit_m(self) -> float:
        """Side of one printed cell [m]."""
        return self.side_m / len(self.bits)

    @property
    def size_m(self) -> float:
        """Side of the plate, quiet zone and rim included [m]."""
        return self.side_m * (1 + 2 * self.gap_fraction)

    @property
    def aruco_m(self) -> float:
        """Outer side of the black border [m]."""
        return self.side_m

    @property
    def ring_fraction(self) -> float:
        """Width of the quiet zone over the side."""
        return 1 / len(self.bits)

    @property
    def gap_fraction(self) -> float:
        """Distance from the border to the end of the absorbing rim, over the side."""
        return 2 / len(self.bits)

    @property
    def corners_m(self) -> FloatArray:
        """Corners of the black border, (4, 3): top left first, clockwise as seen [m]."""
        h = self.side_m / 2
        return np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])

    def meshes(self) -> dict[str, Mesh]:
        """Triangles by 'retro' and 'absorber': vertices (n, 3) [m] and faces (m, 3), wound outwards."""
        bright = np.pad(np.pad(self.bits, 1, constant_values=True), 1)
        n = len(bright)
        edge = np.linspace(-self.size_m / 2, self.size_m / 2, n + 1)
        vertices = np.stack([*np.meshgrid(edge, edge), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
        row, column = np.indices((n, n))  # rows upwards
        first = (row * (n + 1) + column).astype(np.uint32)
        above = first + np.uint32(n + 1)
        faces = np.stack([np.stack([first, first + 1, above + 1], -1), np.stack([first, above + 1, above], -1)], axis=2)
        lit = bright[::-1]
        return {"retro": (vertices, faces[lit].reshape(-1, 3)), "absorber": (vertices, faces[~lit].reshape(-1, 3))}


class DotPlate(_Plate):
    """Bright dots at the corners of an absorbing plate, and one above its centre on a post, as true geometry.

    After the Space Vision Marker System (Bondy et al. 2007), idealised: the post is as slender as its dot, and absorbs.
    """

    side_m: Side = Field(0.10, description="side of the plate [m]")
    dot_fraction: FractionBelowHalf = Field(0.06, description="radius of a dot over the plate's side; assumption")
    margin_fraction: FractionBelowHalf = Field(
        0.10, description="from the plate's edge to a dot's centre, over its side; assumption"
    )
    height_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.25, description="height of the post's dot over the plate's side"
    )

    @property
    def size_m(self) -> float:
        """Side of the plate [m]."""
        return self.side_m

    @property
    def bit_m(self) -> float:
        """Radius of a dot [m], which stands for the distance between edges."""
        return self.dot_radius_m

    @property
    def dot_radius_m(self) -> float:
        """Radius of a dot [m]."""
        return self.dot_fraction * self.side_m

    @property
    def points_m(self) -> FloatArray:
        """Centres of the dots, (5, 3): top left first, clockwise, then the post's [m]."""
        h = self.side_m * (0.5 - self.margin_fraction)
        flat = np.array([[-h, h], [h, h], [h, -h], [-h, -h], [0, 0]])
        return np.column_stack([flat, [_DOT_LIFT_M] * 4 + [self.height_fraction * self.side_m]])

    def meshes(self) -> dict[str, Mesh]:
        """Triangles by 'retro' and 'absorber': vertices (n, 3) [m] and faces (m, 3), wound outwards."""
        angle = 2 * np.pi * np.arange(_DOT_SIDES) / _DOT_SIDES
        rim = self.dot_radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        k = np.arange(_DOT_SIDES, dtype=np.uint32)
        fan = np.stack([np.full_like(k, _DOT_SIDES), k, (k + 1) % _DOT_SIDES], axis=-1)
        vertices = np.concatenate([np.vstack([centre + rim, centre]) for centre in self.points_m])
        faces = np.concatenate([fan + np.uint32(i * (_DOT_SIDES + 1)) for i in range(len(self.points_m))])
        half, top = self.side_m / 2, self.points_m[-1]
        plate = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
        foot, head = rim, rim + top - [0, 0, _DOT_LIFT_M]
        wall = np.concatenate([plate, foot, head])
        low, high = 4 + k, 4 + _DOT_SIDES + k
        after = (k + 1) % _DOT_SIDES
        sides = [
            np.stack([low, 4 + after, 4 + _DOT_SIDES + after], -1),
            np.stack([low, 4 + _DOT_SIDES + after, high], -1),
        ]
        square = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        return {"retro": (vertices, faces), "absorber": (wall, np.concatenate([square, *sides]).astype(np.uint32))}


def view_of(plate: TagPlate | DotPlate, view: View) -> View:
    """A view with a plate in the marker's place.

    Args:
        plate: the tag or the dots.
        view: camera, lights, target and range; its own marker is replaced.
    """
    # The renderer asks a marker for what a plate answers, too.
    return replace(view, marker=cast(MarkerDesign, plate))
