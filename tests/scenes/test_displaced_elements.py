"""A marker whose elements stand off their places: opening, cavity, virtual line and blob move together, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scenes.marker import MarkerDesign

OFF = (1e-3, -5e-4, 0.0, 2e-3)


def test_an_element_off_its_place_moves_whole() -> None:
    design, built = MarkerDesign(), MarkerDesign(element_offsets_m=OFF)
    for planned, real, offset in zip(design.elements, built.elements, OFF, strict=True):
        assert real.shift_m == offset
        assert real.virtual_offset_m == pytest.approx(planned.virtual_offset_m + offset, abs=1e-15)
        np.testing.assert_array_equal(real.centre_m, planned.centre_m)
    for material in ("retro", "absorber"):
        vertices = built.meshes()[material][0]
        # The floor is retro, slats and walls are absorbing: below the front plane there is nothing else but the sides.
        below = vertices[(vertices[:, 2] < 0) & (np.abs(vertices[:, :2]).max(axis=1) < design.size_m / 2)]
        planned = design.meshes()[material][0]
        planned = planned[(planned[:, 2] < 0) & (np.abs(planned[:, :2]).max(axis=1) < design.size_m / 2)]
        moved = below - planned
        for element, offset in zip(design.elements, OFF, strict=True):
            of_it = np.abs((planned - element.centre_m) @ element.across) <= element.width_m / 2 + 1e-9
            others = [e for e in design.elements if e is not element]
            away = np.abs((planned - element.centre_m) @ element.along) <= element.length_m / 2 + 1e-9
            alone = (
                of_it
                & away
                & ~np.any([np.abs((planned - e.centre_m) @ e.across) <= e.width_m / 2 for e in others], axis=0)
            )
            assert alone.sum() >= 4
            np.testing.assert_allclose(
                moved[alone], np.broadcast_to(offset * element.along, moved[alone].shape), atol=1e-12
            )


def test_the_front_plane_still_covers_everything_once() -> None:
    marker = MarkerDesign(element_offsets_m=OFF)
    cells = np.array([cell[:4] for cell in marker.plane_cells()])
    area = (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2])
    openings = sum(e.length_m * e.width_m for e in marker.elements)
    assert area.sum() == pytest.approx(marker.size_m**2 - openings, abs=1e-12)
    for element in marker.elements:
        middle = (element.centre_m + element.shift_m * element.along)[:2]
        ends = middle + np.array([[-0.499], [0.499]]) * element.length_m * element.along[:2]
        covered = [
            np.any((cells[:, 0] < x) & (x < cells[:, 1]) & (cells[:, 2] < y) & (y < cells[:, 3])) for x, y in ends
        ]
        assert not any(covered)


def test_an_element_may_not_run_into_its_neighbour() -> None:
    with pytest.raises(ValidationError, match=r"element_offsets_m: .* expected at most .* m either way"):
        MarkerDesign(element_offsets_m=(0.02, 0, 0, 0))
    with pytest.raises(ValidationError):
        MarkerDesign(element_offsets_m=(np.nan, 0, 0, 0))
