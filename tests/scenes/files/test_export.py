"""What is exported loads in stock Mitsuba and shines as brightly as the transport basis, in absolute units."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.stats import t as student

from radiometry.geometry import FloatArray
from radiometry.optics import Camera, node_weights
from radiometry.sources import LedRing, Sun
from radiometry.spectrum import Spectrum, constant
from scenes.files.export import export_scene
from scenes.marker import MarkerDesign
from scenes.render.transport import LIGHTS, Quality, View, render_basis
from scenes.target import Target

VIEW = View(
    # Square pixels, so that the exported image covers the same field; a marker of 24 px on flat foil, so that the image is even
    # where the two reconstruction filters mix in what lies beyond its edge.
    camera=Camera(width_px=48, height_px=40, pixel_pitch_y_m=8.6e-6),
    marker=MarkerDesign(size_m=0.05),
    target=Target(facet_slope_deg=0, pitch_deg=12, yaw_deg=-15),
    leds=LedRing(count=3),
    sun=Sun(),
    range_m=5.0,
    nodes_nm=(807, 833, 867, 893),
)
STRENGTHS = {"led": VIEW.leds.spectral_intensity(), "sun": VIEW.sun.irradiance()}
BAND_NM = (800.0, 900.0)
SEEDS = 12


@pytest.fixture(scope="module")
def exported(mi: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    export_scene(VIEW, STRENGTHS, folder)
    return folder


@pytest.fixture(scope="module")
def composed(mi: ModuleType) -> dict[str, FloatArray]:
    """Mean radiance of the batched basis composed with the same spectra over the same band [W m⁻² sr⁻¹], by seed."""
    runs = [render_basis(VIEW, Quality(4, 400_000, seed)).layers for seed in range(SEEDS)]
    weights = {
        light: node_weights(strength * constant(1.0, *BAND_NM).resampled(0.5), VIEW.nodes_nm)
        for light, strength in STRENGTHS.items()
    }
    return {
        light: np.array([np.tensordot(weights[light], run[light], 1).mean(dtype=float) for run in runs])
        for light in LIGHTS
    }


@pytest.mark.parametrize("light", LIGHTS)
def test_an_exported_scene_renders_to_the_flux_of_the_composed_basis(
    mi: ModuleType, exported: Path, composed: dict[str, FloatArray], light: str
) -> None:
    """Mean radiance over the frame, 12 seeds each: Welch's t at 99.9 % for both lights together.

    Allowed for besides: stock's textured LED pattern and its nearer Sun (2.5e-4, see the test of the renderers' agreement).
    """
    scene = mi.load_file(str(exported / f"{light}.xml"))
    images = [np.array(mi.render(scene, spp=128, seed=seed), float) for seed in range(SEEDS)]
    assert images[0].shape == (40, 48, 1)
    means = np.array([image.mean() for image in images])
    ours = composed[light]
    error = np.hypot(means.std(ddof=1), ours.std(ddof=1)) / np.sqrt(SEEDS)
    limit = student.isf((1 - 0.999 ** (1 / len(LIGHTS))) / 2, SEEDS - 1)
    assert error < 2e-3 * ours.mean()  # or the interval would say nothing
    assert abs(means.mean() - ours.mean()) < limit * error + 2.5e-4 * ours.mean()


def test_an_export_is_complete_and_can_be_moved(exported: Path) -> None:
    """Every file that the scenes name lies in the folder, by a relative path."""
    for light in LIGHTS:
        root = ElementTree.parse(exported / f"{light}.xml").getroot()
        assert root.get("version") == "3.0.0"
        named = [
            e.get("filename") or e.get("value") for e in root.iter() if e.get("filename") or e.get("name") == "filename"
        ]
        assert len(named) > 3
        for name in named:
            assert name is not None
            assert not Path(name).is_absolute()
            assert (exported / name).is_file()


def test_each_scene_holds_its_own_light_only(exported: Path) -> None:
    lights = {
        light: [e.get("type") for e in ElementTree.parse(exported / f"{light}.xml").getroot().iter("emitter")]
        for light in LIGHTS
    }
    assert lights == {"led": ["spot"] * 3, "sun": ["area"]}


def test_the_how_to_names_the_image_and_its_band(exported: Path) -> None:
    text = (exported / "README.txt").read_text("utf-8")
    assert "40 x 48" in text
    assert "800-900 nm" in text
    assert "millimetres" in text


def test_exported_spectra_are_those_of_the_lights(exported: Path) -> None:
    """One table a light; the LEDs' share one, a third of the ring each and 1e6 for distances in millimetres."""
    tables = [np.loadtxt(path) for path in sorted((exported / "spectra").glob("*.spd"))]
    assert len(tables) == 2
    peaks = {}
    for table in tables:
        spectrum = Spectrum(table[:, 0], table[:, 1])
        peaks["led" if spectrum(700.0) == 0 else "sun"] = spectrum
    led, sun = STRENGTHS["led"], STRENGTHS["sun"]
    # Tables are printed with eight digits.
    grid = np.arange(810.0, 891.0)
    np.testing.assert_allclose(peaks["led"](grid), led(grid) * 1e6 / 3, rtol=1e-6)
    disc = np.pi * np.tan(VIEW.sun.angular_radius_rad) ** 2
    np.testing.assert_allclose(peaks["sun"](grid), sun(grid) / disc, rtol=1e-6)
