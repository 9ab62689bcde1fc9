"""Writes a view for stock Mitsuba: one XML scene per light, PLY meshes, spectra, and a how-to."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from radiometry.spectrum import Spectrum
from scenes.render.stock import stock_scene
from scenes.view import MM_PER_M, View

#: XML element of each plugin that `stock_scene` uses.
_ELEMENTS = {
    "scene": "scene",
    "path": "integrator",
    "perspective": "sensor",
    "specfilm": "film",
    "ply": "shape",
    "disk": "shape",
    "spot": "emitter",
    "area": "emitter",
    "bitmap": "texture",
    "diffuse": "bsdf",
    "mantis_material": "bsdf",
    "blendbsdf": "bsdf",
    "roughconductor": "bsdf",
    "uniform": "spectrum",
    "regular": "spectrum",
    "irregular": "spectrum",
}

_HOW_TO = """\
Scene of the Mantis Marker for stock Mitsuba 3.9, one file per light. Lengths are millimetres, radiance is W m-2 sr-1.

    import mitsuba as mi
    mi.set_variant("llvm_ad_spectral")          # or scalar_spectral
    from materials import plugins               # tape and foil, from the package mantis-radiometry
    plugins.register()
    image = mi.render(mi.load_file("led.xml"), spp=64)

The image is {height} x {width}: radiance integrated over {low:g}-{high:g} nm, without the filter's curve. Its pixels are
square and as wide as the camera's columns.
"""


def export_scene(view: View, strengths: Mapping[str, Spectrum], folder: Path) -> None:
    """Write led.xml, sun.xml, earth.xml (where there is an Earth), meshes/, spectra/ and README.txt, in absolute units.

    Args:
        view: what to export.
        strengths: by light: on-axis intensity of the whole LED ring, irradiance of the Sun, radiance of the Earth.
        folder: where the files go.

    Raises:
        ValueError: for a lens with distortion, which Mitsuba's own camera cannot have.
    """
    camera = view.camera
    rows = round(camera.height_px * camera.pixel_pitch_y_m / camera.pixel_pitch_x_m)
    low, high = view.nodes_nm[0] - 7.0, view.nodes_nm[-1] + 7.0
    knots = int(np.ceil((high - low) / 2)) + 1
    # Knots 2 nm apart: `specfilm` samples a flat band of coarse knots with a bias.
    band = {"type": "regular", "wavelength_min": low, "wavelength_max": high, "values": ",".join(["1.0"] * knots)}
    film = {"type": "specfilm", "width": camera.width_px, "height": rows, "component_format": "float32", "band": band}
    per_square_mm = {"led": MM_PER_M**2, "sun": 1.0, "earth": 1.0}  # intensity over a distance in millimetres
    for light, strength in strengths.items():
        scene = stock_scene(view, {light: strength * per_square_mm[light]}, folder / "meshes", dict(film))
        (folder / "spectra").mkdir(exist_ok=True)
        root = _element(scene, None, folder, {})
        root.set("version", "3.0.0")
        ElementTree.indent(root)
        ElementTree.ElementTree(root).write(folder / f"{light}.xml", encoding="utf-8", xml_declaration=True)
    how_to = _HOW_TO.format(width=camera.width_px, height=rows, low=low, high=high)
    (folder / "README.txt").write_text(how_to, encoding="utf-8")


def _element(value: dict[str, Any], name: str | None, folder: Path, tables: dict[str, str]) -> ElementTree.Element:
    """XML of a scene description; `tables` remembers which spectra have been written, by content."""
    if value["type"] == "spectrum":
        return ElementTree.Element(
            "spectrum", {"name": name or "", "filename": _write_table(value["value"], folder, tables)}
        )
    element = ElementTree.Element(_ELEMENTS[value["type"]])
    if value["type"] != "scene":
        element.set("type", value["type"])
    if name is not None:
        element.set("name", name)
    for key, item in value.items():
        if key != "type":
            element.append(_property(item, key, folder, tables))
    return element


def _property(item: Any, key: str, folder: Path, tables: dict[str, str]) -> ElementTree.Element:
    if isinstance(item, dict):
        return _element(item, key, folder, tables)
    if hasattr(item, "matrix"):
        transform = ElementTree.Element("transform", {"name": key})
        numbers = " ".join(f"{x:.9g}" for x in np.array(item.matrix).ravel())
        ElementTree.SubElement(transform, "matrix", {"value": numbers})
        return transform
    if key == "filename":
        item = os.path.relpath(item, folder)
    kinds = {bool: "boolean", int: "integer", float: "float", str: "string"}
    text = str(item).lower() if isinstance(item, bool) else str(item)
    return ElementTree.Element(kinds[type(item)], {"name": key, "value": text})


def _write_table(samples: list[tuple[float, float]], folder: Path, tables: dict[str, str]) -> str:
    """Write a spectrum once; its path relative to the scene."""
    text = "".join(f"{wavelength:g} {value:.8g}\n" for wavelength, value in samples)
    if text not in tables:
        tables[text] = f"spectra/spectrum_{len(list((folder / 'spectra').glob('*.spd')))}.spd"
        (folder / tables[text]).write_text(text, encoding="ascii")
    return tables[text]
