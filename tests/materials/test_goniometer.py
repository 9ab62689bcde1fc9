"""A scan in the retroreflection plane: flat for a diffuser, a glint for a mirror, a peak for tape."""

from __future__ import annotations

import numpy as np
import pytest

from materials.goniometer import WAVELENGTH_NM, goniometer_scan
from materials.library import load


@pytest.mark.parametrize("entrance_deg", [0.0, 20.0, 50.0])
def test_a_diffuser_looks_the_same_from_everywhere(entrance_deg: float) -> None:
    material = load("diffuse_reference")
    scan = goniometer_scan(material, entrance_deg, np.linspace(0.0, entrance_deg + 80.0, 9))
    np.testing.assert_allclose(scan, float(material.diffuse(WAVELENGTH_NM)) / np.pi, rtol=1e-12)


@pytest.mark.parametrize("entrance_deg", [10.0, 30.0])
def test_a_mirror_glints_at_twice_the_entrance_angle(entrance_deg: float) -> None:
    angles = np.linspace(0.0, 90.0, 901)
    scan = goniometer_scan(load("mli_bare"), entrance_deg, angles)
    assert angles[np.argmax(scan)] == pytest.approx(2 * entrance_deg, abs=1.0)


def test_tape_returns_most_along_the_way_the_light_came() -> None:
    angles = np.array([0.0, 0.2, 0.5, 1.0, 2.0, 10.0])
    scan = goniometer_scan(load("tape_type_xi"), 5.0, angles)
    assert np.all(np.diff(scan) <= 0)
    assert scan[0] > 100 * scan[-1]


def test_behind_the_surface_nothing_is_seen() -> None:
    assert goniometer_scan(load("white_paint"), 30.0, np.array([121.0]))[0] == 0.0
