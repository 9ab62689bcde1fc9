"""The chessboard: squares in the right places, wound towards the viewer, and taken for a marker by a view."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from experiments import chain
from experiments.scenario import Scenario
from scenes.chessboard import BLACK, WHITE, Chessboard, view_of

BOARD = Chessboard(columns=5, rows=4, square_m=0.02, margin_m=0.03, centre_m=(0.01, -0.005))


def test_bright_and_dark_tile_the_sheet() -> None:
    areas = {}
    for name, (vertices, faces) in BOARD.meshes().items():
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        assert np.all(normal[:, 2] > 0)
        areas[name] = normal[:, 2].sum() / 2
    assert areas["absorber"] == pytest.approx(10 * 0.02**2, rel=1e-12)
    assert areas["retro"] + areas["absorber"] == pytest.approx((0.1 + 0.06) * (0.08 + 0.06), rel=1e-12)


def test_corners_are_where_four_squares_meet() -> None:
    corners = BOARD.corners_m
    assert corners.shape == (12, 3)
    assert BOARD.inner_corners == (4, 3)
    np.testing.assert_allclose(corners.mean(axis=0), [0.01, -0.005, 0], atol=1e-15)
    assert corners[1, 0] > corners[0, 0]
    assert corners[4, 1] < corners[0, 1]
    vertices, faces = BOARD.meshes()["absorber"]
    centres = np.array([vertices[f].reshape(-1, 3).mean(axis=0) for f in faces.reshape(-1, 6)])
    for corner in corners:
        # Two dark squares touch each corner, across from each other.
        touching = centres[np.abs(centres - corner).max(axis=1) < 0.0101]
        assert len(touching) == 2
        np.testing.assert_allclose(touching.mean(axis=0), corner, atol=1e-12)


def test_a_view_shows_it_instead_of_the_marker() -> None:
    view = view_of(BOARD, chain.view(Scenario()))
    assert view.target.tape_material == WHITE
    assert view.target.absorber_material == BLACK
    reach = np.abs(BOARD.corners_m[:, :2]).max() + BOARD.square_m
    assert BOARD.size_m / 2 >= reach


def test_a_board_of_two_squares_is_refused() -> None:
    with pytest.raises(ValidationError, match="columns"):
        Chessboard(columns=2)
