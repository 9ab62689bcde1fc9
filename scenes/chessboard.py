"""A chessboard in front of the camera, rendered by the same transport as the marker, to calibrate cameras with.

It takes the marker's place in a `View`: dark squares on a bright sheet, in the plane z = 0 of the marker frame. A view
keeps the origin of that frame on the optical axis. Moved off its centre, a board reaches the corners of the frame, where
distortion shows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign, Mesh
from scenes.view import View

Squares = Annotated[int, Field(ge=3, le=100)]
Offset = Annotated[float, Field(allow_inf_nan=False)]

#: Materials of the bright sheet and of the dark squares.
WHITE, BLACK = "white_paint", "acrylic_black"


class Chessboard(BaseModel):
    """A printed chessboard. Columns and rows count dark and bright squares alike."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    columns: Squares = Field(10, description="squares along x")
    rows: Squares = Field(7, description="squares along y")
    square_m: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = Field(
        0.03, description="side of a square [m]"
    )
    margin_m: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = Field(
        0.03, description="bright rim around the squares, at least a square's side [m]"
    )
    centre_m: tuple[Offset, Offset] = Field(
        (0.0, 0.0), description="centre of the board, x and y in the marker frame [m]"
    )
    thickness_m: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] = Field(0.005, description="thickness [m]")

    @property
    def inner_corners(self) -> tuple[int, int]:
        """Corners where four squares meet, along x and along y."""
        return self.columns - 1, self.rows - 1

    @property
    def corners_m(self) -> FloatArray:
        """Inner corners in the marker frame (n, 3), row by row from the top left [m]."""
        x = (np.arange(1, self.columns) - self.columns / 2) * self.square_m + self.centre_m[0]
        y = (self.rows / 2 - np.arange(1, self.rows)) * self.square_m + self.centre_m[1]
        return np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)

    @property
    def size_m(self) -> float:
        """Side of the square about the frame's origin that holds the whole board [m]. The renderer samples it densely."""
        half = np.array([self.columns, self.rows]) * self.square_m / 2 + self.margin_m
        return float(2 * np.max(half + np.abs(self.centre_m)))

    # What the renderer asks of a marker, to sample its edges densely enough: a board is one print without elements.

    @property
    def aruco_m(self) -> float:
        """Side of the printed area [m], which is the whole board."""
        return self.size_m

    @property
    def bit_m(self) -> float:
        """Side of a printed cell [m]."""
        return self.square_m

    @property
    def ring_fraction(self) -> float:
        """Width of the print beyond `aruco_m`: none."""
        return 0.0

    @property
    def elements(self) -> tuple[()]:
        """Encoding elements: none."""
        return ()

    @property
    def element_length_m(self) -> float:
        """Spacing of edges where a marker has elements [m]; the renderer chooses its sampling by it."""
        return self.square_m

    @property
    def element_depth_m(self) -> float:
        """Depth below the front that the board reaches [m]."""
        return self.thickness_m

    @property
    def slit_count(self) -> int:
        """One edge within `element_length_m`."""
        return 1

    def meshes(self) -> dict[str, Mesh]:
        """Triangles by role: 'retro' is the bright sheet with the bright squares, 'absorber' the dark squares.

        Returns:
            By role, vertices (n, 3) in the marker frame [m] and triangles (m, 3).
        """
        corner = np.array(self.centre_m) - np.array([self.columns, self.rows]) * self.square_m / 2
        edges = [
            np.concatenate([[low - self.margin_m], low + np.arange(n + 1) * self.square_m, [low + n * self.square_m]])
            for low, n in zip(corner, (self.columns, self.rows), strict=True)
        ]
        for axis in edges:
            axis[-1] += self.margin_m
        vertices = np.stack([*np.meshgrid(*edges), np.zeros((len(edges[1]), len(edges[0])))], axis=-1).reshape(-1, 3)
        row, column = np.indices((self.rows + 2, self.columns + 2)).reshape(2, -1)
        inside = (row > 0) & (row <= self.rows) & (column > 0) & (column <= self.columns)
        dark = inside & ((row + column) % 2 == 0)
        first = (row * len(edges[0]) + column).astype(np.uint32)
        above = first + np.uint32(len(edges[0]))
        faces = np.stack([np.stack([first, first + 1, above + 1], -1), np.stack([first, above + 1, above], -1)], axis=1)
        return {
            "retro": (vertices, faces[~dark].reshape(-1, 3)),
            "absorber": (vertices, faces[dark].reshape(-1, 3)),
        }


def view_of(board: Chessboard, view: View) -> View:
    """A view with the board in the marker's place, in white and black paint.

    Args:
        board: the chessboard.
        view: camera, lights, target and range; its own marker is replaced.
    """
    target = view.target.model_copy(update={"tape_material": WHITE, "absorber_material": BLACK})
    # A board answers whatever the renderer asks of a marker.
    return replace(view, marker=cast(MarkerDesign, board), target=target)
