"""What shows through the slits of an encoding element."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detector.elements.slits import Slits, lit_cells
from scenes.marker import MarkerDesign

MARKER = MarkerDesign()


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.floats(-0.5, 0.5), st.floats(0.5, 20.0))
def test_floor_seen_through_the_slits_is_a_triangle_about_the_blob(place, range_m):
    element = MARKER.elements[0]
    slits = Slits(MARKER, element, np.array([0.0, 0.0, range_m]))
    u = np.linspace(-0.5, 0.5, 4001) * element.length_m
    seen = slits.seen_up_to(u, np.array([place * element.length_m]))[0]
    assert np.all(np.diff(seen) >= -1e-15)
    assert seen[-1] <= (1 - MARKER.slat_fraction) * element.length_m
    # The area of the triangle, its top cut flat by one slit, but for what the ends cut off and the sampling by slits.
    whole = (1 - MARKER.slat_fraction) * (1 - slits.follow) * slits.half_width
    assert seen[-1] == pytest.approx(whole * (1 - slits.cut_fraction(place * element.length_m)), abs=0.12 * whole)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.floats(-0.6, 0.6), st.floats(0.5, 10.0), st.sampled_from([0.0, 0.05, 0.2]))
def test_the_cells_of_light_are_the_floor_seen_between_their_edges(place, range_m, light_ring_m):
    element = MARKER.elements[0]
    slits = Slits(MARKER, element, np.array([0.3 * range_m, 0.0, range_m]), light_ring_m)
    edges = np.linspace(-0.6, 0.6, 200) * element.length_m
    lit = np.empty(len(edges) - 1)
    grid = edges[0], edges[1] - edges[0]
    lit_cells(slits.numbers, slits.count, slits.beside, place * element.length_m, grid, lit)
    seen = slits.seen_up_to(edges, np.array([place * element.length_m]))[0]
    assert lit * grid[1] == pytest.approx(np.diff(seen), abs=1e-12)
