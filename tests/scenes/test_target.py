"""The crinkled face behind the marker: as steep as stated, never folded, never in the marker's way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.stats import kurtosis, norm

from scenes.marker import MarkerDesign
from scenes.target import Target, edge_mesh, face_mesh, facet_slopes, surroundings

MARKER = MarkerDesign()

targets = st.builds(
    Target,
    face_m=st.floats(0.2, 3),
    facet_m=st.floats(0.02, 1),
    facet_slope_deg=st.floats(0, 30),
    facet_seed=st.integers(0, 1000),
)


@settings(deadline=None, derandomize=True)
@given(targets)
def test_the_face_stays_behind_the_markers_back_and_faces_the_viewer(target: Target) -> None:
    vertices, faces = face_mesh(target, MARKER)
    assert vertices[:, 2].max() <= -MARKER.thickness_m
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2].min() > 0  # an overturned facet would be black, and hide another


@settings(deadline=None, derandomize=True)
@given(targets)
def test_the_face_is_a_square_without_holes(target: Target) -> None:
    vertices, faces = face_mesh(target, MARKER)
    assert np.array_equal(np.unique(faces), np.arange(len(vertices)))
    np.testing.assert_allclose(np.abs(vertices[:, :2]).max(axis=0), target.face_m / 2, rtol=1e-12)
    a, b, c = (vertices[faces[:, k], :2] for k in range(3))
    area = np.sum((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert area == pytest.approx(target.face_m**2, rel=1e-9)


@pytest.mark.parametrize("slope_deg", [0.5, 4.0, 30.0])
def test_facets_are_as_steep_as_stated_along_both_axes(slope_deg: float) -> None:
    """All slopes of a sheet together have the stated root mean square; each axis alone has it within a 99.9 % interval.

    The interval of a variance of n values of excess kurtosis k is √((2 + k)/n); a sheet has as many independent heights as half
    its facets.
    """
    sheets = [Target(facet_slope_deg=slope_deg, facet_seed=seed) for seed in range(4)]
    slopes = [facet_slopes(*face_mesh(target, MARKER)) for target in sheets]
    stated = np.tan(np.radians(slope_deg))
    for slope in slopes:
        assert np.sqrt(np.mean(slope**2)) == pytest.approx(stated, rel=1e-9)
    together = np.concatenate(slopes)
    independent = len(together) / 2
    for axis in (0, 1):
        error = np.sqrt((2 + kurtosis(together[:, axis])) / independent)
        assert np.mean(together[:, axis] ** 2) / stated**2 == pytest.approx(1, abs=norm.isf(0.0005 / 2) * error)
        # Facets lean to either side alike.
        assert abs(np.mean(together[:, axis])) < norm.isf(0.0005 / 2) * stated / np.sqrt(independent)


def test_a_face_without_slope_is_one_flat_sheet() -> None:
    vertices, faces = face_mesh(Target(facet_slope_deg=0), MARKER)
    assert len(faces) == 2
    assert np.all(vertices[:, 2] == -MARKER.thickness_m)


def test_a_seed_names_one_crinkle() -> None:
    first, again, other = (face_mesh(Target(facet_seed=seed), MARKER)[0] for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("face_m", 0),
        ("face_m", np.inf),
        ("facet_m", 0),
        ("facet_slope_deg", 31),
        ("facet_slope_deg", -1),
        ("pitch_deg", 81),
        ("yaw_deg", -81),
        ("roll_deg", np.nan),
        ("facet_seed", -1),
        ("colour", 1),
    ],
)
def test_a_target_that_cannot_be_is_refused(field: str, value: float) -> None:
    with pytest.raises(ValidationError, match=field):
        Target(**{field: value})


def test_facets_too_fine_to_mesh_are_refused() -> None:
    with pytest.raises(ValidationError, match=r"facet_m: 0\.0001 m is 10000 facets"):
        Target(face_m=1.0, facet_m=1e-4)


@settings(deadline=None, derandomize=True)
@given(st.floats(1e-3, 0.1))
def test_bars_stand_beside_the_marker_and_face_outwards(radius_m: float) -> None:
    target = Target(edge_radius_m=radius_m)
    vertices, faces = edge_mesh(target, MARKER)
    assert np.abs(vertices[:, :2]).max(axis=1).min() >= MARKER.size_m / 2 + radius_m - 1e-12
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal, height = np.cross(b - a, c - a), (a + b + c)[:, 2] / 3 + MARKER.thickness_m
    assert normal[:, 2].min() > 0
    assert height.max() == pytest.approx(radius_m, rel=1e-3)
    area = np.linalg.norm(normal, axis=1).sum() / 2
    length = 2 * (MARKER.size_m / 2 + 3 * radius_m)
    assert area == pytest.approx(4 * np.pi * radius_m * length, rel=1e-3)


def test_bars_are_there_only_where_asked_for() -> None:
    assert set(surroundings(Target(), MARKER)) == {"face"}
    bars = Target(edge_radius_m=0.005)
    assert surroundings(bars, MARKER)["edge"][1] == bars.edge_material in bars.materials
    assert Target().edge_material not in Target().materials
