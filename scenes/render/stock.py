"""The same view as a scene for stock Mitsuba: for export, as the reference renderer, and for machines without LLVM.

The LEDs become spots with a textured pattern, Sun and Earth distant discs. The camera becomes a perspective sensor of
square pixels.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from materials import library
from radiometry.geometry import normal_to
from radiometry.optics import pixel_profile_integral
from radiometry.spectrum import Spectrum
from scenes.projection.regions import Box, frame_box, marker_box
from scenes.target import surroundings
from scenes.view import MM_PER_M, Quality, Region, TransportBasis, View

#: Resolution of the LED pattern's texture, and where the pattern is cut off: cos³¹ is 3e-7 there for the default LED.
_PATTERN_PX, _PATTERN_EDGE_DEG = 512, 60.0
_DISC_DISTANCE_MM = 1e6


def stock_scene(
    view: View,
    strengths: Mapping[str, Spectrum | float],
    mesh_folder: Path,
    film: dict[str, Any],
    sensor_offset_px: tuple[float, float] = (0.0, 0.0),
    pixel_rad: float | None = None,
    depth: int = 2,
) -> dict[str, Any]:
    """Scene description for `mi.load_dict`, in millimetres and in the marker frame. It needs a spectral variant.

    Args:
        view: what to describe.
        strengths: spectrum or constant by light: 'led' the on-axis intensity of the whole ring, 'sun' the irradiance,
            'earth' the radiance. The camera sees the discs directly only with 'earth'.
        mesh_folder: where PLY meshes and the LED texture are written.
        film: description of the film, with width and height.
        sensor_offset_px: centre of the film from the optical axis, to the right and down [film pixels].
        pixel_rad: angular pitch of the film's square pixels on the axis; default the camera's column pitch [tangent].
        depth: longest path; 2 is direct light.

    Raises:
        ValueError: for a lens with distortion, which a perspective sensor cannot have.
    """
    import mitsuba as mi

    from materials import plugins

    if view.camera.distorted:
        raise ValueError(
            "camera.k1, k2, p1, p2, k3: Mitsuba's own camera has no distortion; expected 0, or the LLVM renderer"
        )
    plugins.register()
    mesh_folder.mkdir(parents=True, exist_ok=True)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": depth, "hide_emitters": "earth" not in strengths},
        "sensor": _sensor(view, film, sensor_offset_px, pixel_rad or 1 / view.camera.focal_px[0]),
    }
    target = view.target
    surfaces = {"retro": target.tape_material, "absorber": target.absorber_material}
    meshes = {name: (mesh, surfaces[name]) for name, mesh in view.marker.meshes().items()}
    meshes |= surroundings(target, view.marker)
    for name, ((vertices, faces), material) in meshes.items():
        path = mesh_folder / f"{name}.ply"
        _write_ply(path, vertices * MM_PER_M, faces)
        bsdf = plugins.bsdf_dict(library.load(material))
        scene[name] = {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf}
    if "led" in strengths:
        scene.update(_leds(view, strengths["led"], mesh_folder, mi))
    if "sun" in strengths:
        radius = np.tan(view.sun.angular_radius_rad)
        scene["sun"] = _disc(view.sun_in_marker, radius, strengths["sun"] * (1 / (np.pi * radius**2)), mi)
    if "earth" in strengths:
        assert view.earth is not None
        scene["earth"] = _disc(view.earth_in_marker, np.tan(view.earth.angular_radius_rad), strengths["earth"], mi)
    return scene


def render_stock_basis(view: View, quality: Quality) -> TransportBasis:
    """Basis of a view by stock `path`: the whole frame coarsely, then the marker as densely as its rays allow.

    Args:
        view: what to render.
        quality: how densely.

    Raises:
        ValueError: for a lens with distortion.
    """
    frame = frame_box(view)
    layers = render_region(view, _region(frame, quality.frame_samples), quality.seed)
    marker = marker_box(view).within(frame)
    samples = int(np.clip(np.sqrt(quality.marker_rays / max(marker.width * marker.height, 1)), 1, 48))
    if marker.width and marker.height and samples > quality.frame_samples:
        patch = render_region(view, _region(marker, samples), quality.seed + 1)
        for light, images in layers.items():
            images[(slice(None), *marker.slices(frame))] = patch[light]
    return TransportBasis(
        view.nodes_nm, layers, {"marker_rays_per_pixel": float(max(samples, quality.frame_samples) ** 2)}
    )


def _region(box: Box, samples: int) -> Region:
    return Region(box.x0, box.y0, box.width, box.height, samples)


def render_region(view: View, region: Region, seed: int) -> dict[str, NDArray[np.float32]]:
    """Basis images of a region by stock `path`.

    Args:
        view: what to render.
        region: pixels, and sub-pixels of each.
        seed: of the renderer.

    Returns:
        By light, (nodes, height, width).
    """
    materials = [library.load(name) for name in view.target.materials]
    # A smaller change of albedo over the band is not worth a rendering at each node.
    flat = all(np.ptp(s(view.nodes_nm)) <= 0.002 for m in materials for s in (m.diffuse, m.gloss, m.retro))
    pad = int(np.ceil(4 * view.camera.psf_sigma_px + 0.5))
    result = {light: np.empty((len(view.nodes_nm), region.height, region.width), np.float32) for light in view.lights}
    for light, images in result.items():
        image = None
        for k, node in enumerate(view.nodes_nm):
            if image is None or not flat:
                image = reduced(render_subpixels(view, region, pad, node, light, seed), view, region, pad)
            images[k] = image
    return result


def reduced(subpixels: NDArray[np.float32], view: View, region: Region, pad: int) -> NDArray[np.float32]:
    """Pixels of a region from the square sub-pixels of `render_subpixels`.

    Args:
        subpixels: (rows, columns).
        view: for its camera.
        region: the pixels.
        pad: pixels around the region that the sub-pixels also cover.

    Returns:
        (height, width).
    """
    fx, fy = view.camera.focal_px
    rows, columns = subpixels.shape
    sigma, step = view.camera.psf_sigma_px, 1 / region.samples
    across = _reduction(region.width, pad, columns, step, sigma)
    return _reduction(region.height, pad, rows, step * fy / fx, sigma) @ (subpixels @ across.T)


@lru_cache(maxsize=64)
def _reduction(pixels: int, pad: int, count: int, step_px: float, psf_sigma_px: float) -> NDArray[np.float32]:
    """Weights, in the point-spread ⊗ pixel kernel, of sub-pixels of a size, (pixels, count).

    Light from anywhere in a sub-pixel of width h counts alike, which smooths the kernel K just as the sub-pixel does.
    Weights of K − h²/24 K″ undo this to fourth order; they are twice the kernel at the middle less its mean over the
    sub-pixel.
    """
    edges = np.arange(count + 1) * step_px - pad - 0.5 - np.arange(pixels)[:, None]
    matrix = np.diff(pixel_profile_integral(edges, psf_sigma_px), axis=1)
    if step_px <= psf_sigma_px:  # else the kernel bends within a sub-pixel
        middle = (edges[:, :-1] + edges[:, 1:]) / 2
        kernel = ndtr((middle + 0.5) / psf_sigma_px) - ndtr((middle - 0.5) / psf_sigma_px)
        matrix = 2 * kernel * step_px - matrix
    return (matrix / matrix.sum(axis=1, keepdims=True)).astype(np.float32)


def render_subpixels(
    view: View, region: Region, pad: int, node_nm: int, light: str, seed: int, spp: int = 1, depth: int = 2
) -> NDArray[np.float32]:
    """Radiance of square sub-pixels of a padded region at one wavelength, per unit strength of a light, by stock `path`.

    A sub-pixel is as wide as a `samples`-th of a column. There are as many rows of them as cover the region.

    Args:
        view: what to render.
        region: pixels, and sub-pixels of each.
        pad: pixels to add around the region.
        node_nm: the wavelength [nm].
        light: 'led', 'sun' or 'earth'.
        seed: of the renderer.
        spp: rays per sub-pixel.
        depth: longest path; 2 is direct light.

    Returns:
        (rows, columns).
    """
    import mitsuba as mi

    columns, rows = subpixel_counts(view, region, pad)
    film = {
        "type": "specfilm",
        "width": columns,
        "height": rows,
        "component_format": "float32",
        "rfilter": {"type": "box"},
        # A band of 2 nm about the node with area one: its integral is the radiance there.
        "band": {
            "type": "regular",
            "wavelength_min": node_nm - 1.0,
            "wavelength_max": node_nm + 1.0,
            "values": "0.5,0.5",
        },
    }
    (fx, fy), (cx, cy) = view.camera.focal_px, view.camera.principal_point_px
    step = 1 / (fx * region.samples)
    left, top = (region.x0 - pad - 0.5 - cx) / fx, (region.y0 - pad - 0.5 - cy) / fy
    offset = left / step + columns / 2, top / step + rows / 2
    # Per square millimetre inside: one watt per steradian is 1e6 times stronger at a distance counted in millimetres.
    strength = {"led": MM_PER_M**2, "sun": 1.0, "earth": 1.0}[light]
    with tempfile.TemporaryDirectory() as folder:
        scene = mi.load_dict(
            stock_scene(
                view,
                {light: strength},
                Path(folder),
                film,
                sensor_offset_px=offset,
                pixel_rad=step,
                depth=depth,
            )
        )
    image = np.array(mi.render(scene, spp=spp, seed=seed), np.float32)
    return image.reshape(rows, columns, -1)[:, :, 0]


def subpixel_counts(view: View, region: Region, pad: int) -> tuple[int, int]:
    """Columns and rows of square sub-pixels that cover a padded region.

    Args:
        view: for its camera.
        region: pixels, and sub-pixels of each.
        pad: pixels to add around the region.
    """
    fx, fy = view.camera.focal_px
    columns = (region.width + 2 * pad) * region.samples
    return columns, int(np.ceil((region.height + 2 * pad) * region.samples * fx / fy))


def _sensor(view: View, film: dict[str, Any], offset_px: tuple[float, float], pixel_rad: float) -> dict[str, Any]:
    import mitsuba as mi

    # Mitsuba's camera looks along +z with x to the left: turn ours by half a turn about z.
    to_world = np.eye(4)
    to_world[:3, :3] = view.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = view.to_marker(np.zeros(3)) * MM_PER_M
    return {
        "type": "perspective",
        "film": film,
        "to_world": mi.ScalarTransform4f(to_world),
        "near_clip": 1.0,
        "far_clip": 100 * _DISC_DISTANCE_MM,
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(film["width"] * pixel_rad / 2))),
        "principal_point_offset_x": offset_px[0] / film["width"],
        "principal_point_offset_y": offset_px[1] / film["height"],
    }


def _emission(strength: Spectrum | float) -> dict[str, Any]:
    if isinstance(strength, Spectrum):
        return {"type": "spectrum", "value": [(float(w), float(v)) for w, v in _whole(strength)]}
    return {"type": "uniform", "value": float(strength)}


def _whole(strength: Spectrum) -> list[tuple[float, float]]:
    """Samples every nanometre over 300-1200 nm: Mitsuba extends shorter tables beyond their ends."""
    grid = np.arange(300.0, 1201.0)
    return list(zip(grid, strength(grid), strict=True))


def _leds(view: View, strength: Spectrum | float, folder: Path, mi: Any) -> dict[str, Any]:
    count = view.leds.count
    edge = np.tan(np.radians(_PATTERN_EDGE_DEG))
    axis = (np.arange(_PATTERN_PX) + 0.5) / _PATTERN_PX * 2 - 1
    cosine = 1 / np.sqrt(1 + edge**2 * (axis**2 + axis[:, None] ** 2))
    pattern = folder / "led_pattern.exr"
    mi.Bitmap(view.leds.pattern(cosine).astype(np.float32)[..., None]).write(str(pattern))
    positions = view.to_marker(view.leds.positions_m()) * MM_PER_M
    to_world = np.eye(4)
    to_world[:3, :3] = view.rotation.T
    result = {}
    for k, position in enumerate(positions):
        to_world[:3, 3] = position
        result[f"led_{k:03d}"] = {
            "type": "spot",
            "to_world": mi.ScalarTransform4f(to_world.copy()),
            "intensity": _emission(strength * (1 / count)),
            "cutoff_angle": _PATTERN_EDGE_DEG,
            "beam_width": _PATTERN_EDGE_DEG,
            "texture": {"type": "bitmap", "filename": str(pattern), "raw": True},
        }
    return result


def _disc(direction: NDArray[np.float64], radius: float, radiance: Spectrum | float, mi: Any) -> dict[str, Any]:
    """A far disc of a radius over its distance, square to its direction."""
    place = direction * _DISC_DISTANCE_MM
    to_world = mi.ScalarTransform4f().look_at(origin=place.tolist(), target=[0, 0, 0], up=normal_to(place).tolist())
    to_world = to_world @ mi.ScalarTransform4f().scale(float(radius * _DISC_DISTANCE_MM))
    return {"type": "disk", "to_world": to_world, "emitter": {"type": "area", "radiance": _emission(radiance)}}


def _write_ply(path: Path, vertices_mm: NDArray[np.float64], faces: NDArray[np.uint32]) -> None:
    """Binary little-endian PLY of triangles."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices_mm)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), np.dtype([("count", "u1"), ("index", "<i4", (3,))]))
    records["count"], records["index"] = 3, faces
    path.write_bytes(header.encode("ascii") + vertices_mm.astype("<f4").tobytes() + records.tobytes())
