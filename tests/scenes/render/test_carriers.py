"""Few wavelengths carry all others, exactly."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from materials import library
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.render import image
from scenes.render.carriers import carriers
from scenes.render.transport import Quality, View, render_basis
from scenes.target import Target

NODES = (803, 815, 834, 858, 881, 892, 895, 897)
TARGET = Target(pitch_deg=10, yaw_deg=-8)


@pytest.mark.parametrize(
    "materials", [("diffuse_reference",) * 3, TARGET.materials, ("aluminium", "acrylic_black", "mli_foil")]
)
def test_carriers_give_every_reflectance_at_every_wavelength(materials: tuple[str, ...]) -> None:
    chosen, mixture = carriers(materials, NODES)
    assert set(chosen) <= set(NODES)
    assert mixture.shape == (len(NODES), len(chosen))
    for name in materials:
        material = library.load(name)
        for spectrum in (material.diffuse, material.gloss, material.retro):
            wanted, carried = (spectrum(np.array(nm, float)) for nm in (NODES, chosen))
            np.testing.assert_allclose(mixture @ carried, wanted, atol=1e-6 * max(wanted.max(), 1e-12))
    np.testing.assert_allclose(mixture.sum(axis=1), 1, atol=1e-6)  # the Earth's own disc


def test_flat_spectra_need_one_wavelength_and_independent_ones_as_many_as_there_are(tmp_path: Path) -> None:
    assert len(carriers(("tape_type_xi", "mli_foil"), NODES)[0]) == 1
    assert len(carriers(TARGET.materials, NODES)[0]) == 2
    assert len(carriers(TARGET.materials, NODES[:1])[0]) == 1


def test_a_basis_is_the_same_with_every_wavelength_traced(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    view = View(
        camera=Camera(width_px=40, height_px=40),
        marker=MarkerDesign(size_m=0.05),
        target=TARGET,
        leds=LedRing(count=5),
        sun=Sun(),
        range_m=2.6,
        nodes_nm=NODES,
    )
    quality = Quality(marker_rays=60_000)
    few = render_basis(view, quality)
    monkeypatch.setattr(image, "carriers", lambda materials, nodes: (nodes, np.eye(len(nodes))))
    every = render_basis(view, quality)
    for light in every.layers:
        np.testing.assert_allclose(
            few.layers[light], every.layers[light], rtol=2e-5, atol=1e-6 * every.layers[light].max()
        )
        np.testing.assert_allclose(few.noise[light], every.noise[light], atol=1e-6 * every.layers[light].max())
