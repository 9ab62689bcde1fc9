"""The shipped materials conserve energy at every angle, and a file that does not is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad

from materials.brdf import gloss_lobe
from materials.library import Material, available, load

DENSE_DEG = np.concatenate([np.arange(0, 88, 4.0), [88.0, 89.0, 89.5]])

FILE = """
title = "test"
source = "none"
date = "2026"
uncertainty = "none"
assumption = true
[diffuse]
albedo = {albedo}
[retro]
observation_deg = [{first}, {last}]
entrance_deg = [4.0, 30.0]
coefficient_cd_per_lx_m2 = [[{peak}, {peak}], [{peak}, {peak}]]
"""


def written(folder: Path, **values: float) -> str:
    path = folder / "tape.toml"
    path.write_text(FILE.format(**{"albedo": 0.0, "first": 0.1, "last": 0.5, "peak": 200.0} | values), encoding="utf-8")
    return str(path)


def peak_albedo(material: Material, entrance_deg: float) -> float:
    """Largest albedo over wavelength: linear between the knots of the spectra, so it lies at one."""
    knots = np.unique(np.concatenate([s.wavelength_nm for s in (material.diffuse, material.gloss, material.retro)]))
    shares = np.array(material.lobe_albedos(np.radians(entrance_deg), samples=100))
    return float(np.max(shares @ [s(knots) for s in (material.diffuse, material.gloss, material.retro)]))


@pytest.mark.parametrize("name", available())
def test_no_material_returns_more_light_than_arrives(name: str) -> None:
    material = load(name)
    for entrance_deg in DENSE_DEG:
        albedo = peak_albedo(material, entrance_deg)
        fine = material.albedo(np.radians(entrance_deg), 850.0, samples=200)
        coarse = material.albedo(np.radians(entrance_deg), 850.0, samples=100)
        assert 0 < albedo <= 1 + abs(fine - coarse), f"{name} at {entrance_deg} deg"


@pytest.mark.parametrize("name", ["diffuse_reference", "black_coating"])
def test_the_albedo_of_a_lambertian_surface_is_its_reflectance_at_every_angle(name: str) -> None:
    material = load(name)
    for entrance_deg in (0.0, 45.0, 85.0):
        found = material.albedo(np.radians(entrance_deg), 850.0)
        assert found == pytest.approx(float(material.diffuse(850.0)), rel=1e-12)


@pytest.mark.parametrize("entrance_deg", [0.0, 40.0, 70.0])
def test_the_albedo_of_a_mirror_lobe_is_its_hemispherical_integral(entrance_deg: float) -> None:
    """Against adaptive quadrature over the viewer's hemisphere, to the change of the rule's last doubling of nodes."""
    material = load("mli_foil")
    alpha = material.lobes.gloss_alpha
    assert alpha is not None
    source = np.array([np.sin(np.radians(entrance_deg)), 0, np.cos(np.radians(entrance_deg))])

    def returned(azimuth: float, polar: float) -> float:
        viewer = np.array([-np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        half = source + viewer
        value = gloss_lobe(np, alpha, source[2], viewer[2], half[2] / np.linalg.norm(half))
        return 2 * float(value) * np.cos(polar) * np.sin(polar)

    expected, error = dblquad(returned, 0, np.pi / 2, 0, np.pi, epsabs=2e-4, epsrel=2e-4)
    expected = float(material.diffuse(850.0)) + expected * float(material.gloss(850.0))
    fine, coarse = (material.albedo(np.radians(entrance_deg), 850.0, samples=n) for n in (400, 200))
    assert fine == pytest.approx(expected, abs=error + 3 * abs(fine - coarse) + 1e-4)


@pytest.mark.parametrize("name", available())
def test_every_material_says_where_its_figures_come_from(name: str) -> None:
    material = load(name)
    assert material.name == name
    assert material.title
    assert material.source
    assert material.date.startswith("20") or material.date.startswith("19")
    assert material.uncertainty


def test_an_unknown_material_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'velvet' is unknown.*black_coating.*tape_type_xi"):
        load("velvet")


@pytest.mark.parametrize("peak", [200.0, 500.0])
def test_a_lobe_too_wide_for_its_height_is_refused(tmp_path: Path, peak: float) -> None:
    """A top-hat f₀ returns f₀ π sin²α: 200 /sr exceeds one beyond 2.29 deg, 500 /sr beyond 1.45 (audit, section 2)."""
    allowed = np.degrees(np.arcsin(np.sqrt(1 / (np.pi * peak))))
    assert allowed == pytest.approx({200.0: 2.29, 500.0: 1.45}[peak], abs=0.005)
    with pytest.raises(ValueError, match=r"times the light that arrives at .*at most 1 conserves energy"):
        load(written(tmp_path, peak=peak, first=0.5, last=2 * allowed))
    # Its fall beyond the table, as α^-3, holds twice the energy of the flat top: at half the width it fits.
    load(written(tmp_path, peak=peak, first=0.25 * allowed, last=0.5 * allowed))


def test_a_bright_floor_leaves_less_room_for_the_lobe(tmp_path: Path) -> None:
    load(written(tmp_path, peak=200.0, first=0.5, last=1.0))
    with pytest.raises(ValueError, match="conserves energy"):
        load(written(tmp_path, peak=200.0, first=0.5, last=1.0, albedo=0.9))
