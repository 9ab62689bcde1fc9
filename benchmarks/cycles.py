"""Equal noise beside Blender's Cycles."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.noise import compare
from benchmarks.rows import Row
from benchmarks.scene import poses, scenario

TITLE = "Beside Blender's Cycles at equal noise"
TEXT = """
The same triangles, the same ring of LEDs (as point lights) and the same Sun, rendered by Cycles on the processor with
direct light only, a Gaussian pixel filter as wide as this camera's pixel and point spread, no denoising and no
adaptive sampling. Cycles has no retroreflector, so for this comparison all materials are diffuse, on both sides, and
neither side has the LEDs' pattern to draw. A frame of 160 × 160 px at 3.3 m; noise as above, and carried on in the
same way. Cycles' time is that of a whole frame with its scene kept in memory. That the fluxes agree is a check of
this renderer by a stranger.
"""
_DIFFUSE = {"tape_material": "diffuse_reference", "absorber_material": "black_coating", "face_material": "white_paint"}


def run(quick: bool) -> list[Row]:
    """Time and noise of both, and the ratio at equal noise."""
    if (version := peers.version("bpy")) is None:
        return [Row("Cycles", np.nan, note="bpy is not installed (extra `bench`)")]
    from scenes.llvm import activate_variant

    activate_variant()
    wide = ("camera.width_px=160", "camera.height_px=160", "camera.pixel_pitch_y_m=8.6e-6", "leds.half_angle_deg=80")
    power = ("leds.intensity_w_sr=0.1", *(f"target.{key}={name}" for key, name in _DIFFUSE.items()))
    view, seeds = poses(scenario("range_m=3.3", *wide, *power), 3)[2], 3 if quick else 4
    name = f"Cycles (Blender {version})"
    rows, ratio = compare(view, lambda light, samples: _cycles(view, light, seeds, samples), name, seeds, (16, 64))
    return [*rows, Row("times as fast as Cycles at equal noise", ratio, "", "≥ 1")]


def _cycles(view: Any, light: str, seeds: int, samples: int) -> tuple[float, Any]:
    """Shortest seconds of a frame, and frames (seeds, height, width) per unit strength."""
    from materials import library
    from scenes.target import surroundings

    camera, target = view.camera, view.target
    names = {"retro": target.tape_material, "absorber": target.absorber_material}
    meshes = {key: (mesh, names[key]) for key, mesh in view.marker.meshes().items()} | surroundings(target, view.marker)
    to_world = np.eye(4)
    # Blender's cameras look along −z with y up.
    to_world[:3, :3], to_world[:3, 3] = view.rotation.T @ np.diag([1.0, -1.0, -1.0]), view.to_marker(np.zeros(3))
    sigma = float(np.sqrt(camera.psf_sigma_px**2 + 1 / 12))
    request: dict[str, Any] = {
        "albedos": {
            key: float(library.load(material).diffuse(float(view.nodes_nm[0]))) for key, (_, material) in meshes.items()
        },
        "matrix": to_world.tolist(),
        "fov_rad": float(2 * np.arctan(camera.width_px / 2 / camera.focal_px[0])),
        "width": camera.width_px,
        "height": camera.height_px,
        "filter_px": 4 * sigma,  # Cycles' Gaussian is exp(−2 (6 x / (3 width))²)
        "samples": samples,
        "seeds": seeds,
        "threads": os.cpu_count(),
    }
    if light == "sun":
        request |= {"sun": view.sun_in_marker.tolist(), "sun_diameter_rad": 2 * view.sun.angular_radius_rad}
    else:
        request |= {"leds": view.to_marker(view.leds.positions_m()).tolist()}
    with tempfile.TemporaryDirectory() as folder:
        arrays = {}
        for key, ((vertices, faces), _) in meshes.items():
            arrays |= {f"{key}_vertices": vertices, f"{key}_faces": faces}
        np.savez(Path(folder) / "meshes.npz", **arrays)
        answer = peers.run_script("cycles_job.py", {**request, "folder": folder})
        frames = np.load(Path(folder) / "frames.npy").astype(float)
    return min(answer["seconds"]), frames
