"""Transport rendering: what the camera would see of each light at unit strength, at a few fixed wavelengths.

Light transport is linear, so one basis image per light and wavelength serves every power, spectrum, filter and exposure. The
renderer is direct light only (indirect light adds up to 0.7 % in the Sun and 0.02 % in the LEDs' light): one jittered ray per
sub-pixel, one light sample per ray, then a fixed point-spread ⊗ pixel kernel, so that neighbouring pixels share their rays.

Units: the LED basis is radiance per unit on-axis intensity of the whole ring [m⁻²], the Sun's is radiance per unit irradiance
square to the Sun [sr⁻¹], the Earth's is radiance per unit radiance of its disc [-]. The renderer's own scene is in millimetres,
for its ray offsets would swallow the slits in metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from materials import library
from radiometry.distortion import BrownConrady
from radiometry.geometry import FloatArray, attitude_matrix, sun_direction
from radiometry.optics import Camera, pixel_profile_integral
from radiometry.sources import Earth, LedRing, Sun
from scenes.earth import earth_radiance
from scenes.marker import MarkerDesign
from scenes.target import Target, face_mesh

MM_PER_M = 1000.0
LIGHTS = ("led", "sun")
#: Unit of each light's basis; the Earth's is rendered where there is one.
UNITS = {"led": "m-2", "sun": "sr-1", "earth": "1"}
#: Fields of the camera that act on the rendered radiance, not on its transport. The focus acts through the point spread, which
#: a view's camera already holds (`radiometry.optics.camera_at`).
AFTER_TRANSPORT = frozenset(
    {"f_number", "lens_transmission", "focus_m", "vignetting", "veiling_glare", "point_source_transmittance"}
)

# Irrational strides of the sub-pixel lattice (Roberts' R2 sequence and the golden ratio): a lattice point set per sub-pixel
# row and column fills jitter and light choice evenly, which random numbers do not.
_GOLDEN, _R2X, _R2Y = 0.6180339887498949, 0.7548776662466927, 0.5698402909980532
_SQRT2, _SQRT3 = 0.41421356237309515, 0.7320508075688772
#: Further from the camera's direction than this, tape sends little of the light back to it [rad].
_RETRO_TAIL_RAD = np.radians(10.0)


@dataclass(frozen=True)
class View:
    """One geometry to be rendered: everything that changes transport, and nothing else."""

    camera: Camera
    marker: MarkerDesign
    target: Target
    leds: LedRing
    sun: Sun
    range_m: float
    nodes_nm: tuple[int, ...]
    earth: Earth | None = None

    @property
    def lights(self) -> tuple[str, ...]:
        """Lights that have a basis, keys of `UNITS`."""
        return LIGHTS if self.earth is None else (*LIGHTS, "earth")

    @cached_property
    def rotation(self) -> FloatArray:
        """Marker -> camera, (3, 3)."""
        return attitude_matrix(*np.radians([self.target.pitch_deg, self.target.yaw_deg, self.target.roll_deg]))

    @cached_property
    def translation_m(self) -> FloatArray:
        """Marker's origin in the camera frame, (3,) [m]: on the optical axis at the range."""
        return np.array([0.0, 0.0, self.range_m])

    @cached_property
    def sun_in_marker(self) -> FloatArray:
        """Unit vector target -> Sun in the marker frame, (3,)."""
        return self.rotation.T @ sun_direction(np.radians(self.sun.phase_deg), np.radians(self.sun.azimuth_deg))

    @cached_property
    def earth_in_marker(self) -> FloatArray:
        """Unit vector target -> centre of the Earth in the marker frame, (3,); needs an Earth."""
        assert self.earth is not None
        there = sun_direction(np.radians(self.earth.phase_deg), np.radians(self.earth.azimuth_deg))
        return self.rotation.T @ there

    def to_marker(self, points_camera_m: FloatArray) -> FloatArray:
        """Points (..., 3) of the camera frame in the marker frame [m]."""
        return (points_camera_m - self.translation_m) @ self.rotation

    def to_image(self, points_marker_m: FloatArray) -> FloatArray:
        """Image positions (..., 2) [px] of points (..., 3) of the marker frame [m]."""
        return self.camera.project(points_marker_m @ self.rotation.T + self.translation_m)

    def to_plane(self, image_px: FloatArray) -> FloatArray:
        """Coordinates (n, 2) [m] on the marker's plane of what is seen at image positions (n, 2) [px]."""
        homography = self.camera.matrix @ np.column_stack([self.rotation[:, :2], self.translation_m])
        ideal_px = self.camera.undistort_px(image_px)
        points = np.column_stack([ideal_px, np.ones(len(ideal_px))]) @ np.linalg.inv(homography).T
        return points[:, :2] / points[:, 2:]


@dataclass(frozen=True)
class Quality:
    """How densely a view is sampled.

    Attributes:
        frame_samples: sub-pixels along one side of a pixel, outside the marker.
        marker_rays: rays spent on the marker's surroundings; the sub-pixels follow from it and the marker's size in pixels.
        seed: of the sub-pixel jitter.
    """

    frame_samples: int = 2
    marker_rays: int = 2_000_000
    seed: int = 1


@dataclass(frozen=True)
class Region:
    """A rectangle of whole pixels and the sub-pixels along one side of each."""

    x0: int
    y0: int
    width: int
    height: int
    samples: int


@dataclass(frozen=True)
class TransportBasis:
    """Basis images of one view.

    Attributes:
        nodes_nm: wavelengths [nm].
        layers: by light, (nodes, height, width) float32 in the units of `UNITS`.
        attributes: provenance, string or number.
    """

    nodes_nm: tuple[int, ...]
    layers: dict[str, NDArray[np.float32]]
    attributes: dict[str, str | float] = field(default_factory=dict)


def render_basis(view: View, quality: Quality | None = None) -> TransportBasis:
    """Render every light of a view: the whole frame coarsely, the marker and its surroundings densely.

    Raises:
        RuntimeError: when no Mitsuba variant can run here.
    """
    quality = quality or Quality()
    from scenes.llvm import activate_variant

    scalar = activate_variant().startswith("scalar")
    scene = None if scalar else _scene(view.marker, view.target)
    camera = view.camera
    whole = Region(0, 0, camera.width_px, camera.height_px, quality.frame_samples)
    layers = _render_region(scene, view, whole, quality.seed)
    dense = marker_region(view, quality.marker_rays)
    if dense is not None and dense.samples > quality.frame_samples:
        patch = _render_region(scene, view, dense, quality.seed + 1)
        rows, columns = slice(dense.y0, dense.y0 + dense.height), slice(dense.x0, dense.x0 + dense.width)
        for light in view.lights:
            layers[light][:, rows, columns] = patch[light]
    samples = float(dense.samples if dense is not None else quality.frame_samples)
    return TransportBasis(view.nodes_nm, layers, {"marker_samples_per_pixel": samples**2})


def marker_region(view: View, rays: int, margin_px: int = 4) -> Region | None:
    """The marker's bounding box in whole pixels, as dense as `rays` allow (2 to 48 per side); None outside the frame."""
    half, back = view.marker.size_m / 2, -view.marker.thickness_m
    # Distortion bends edges, which then reach further than the corners.
    side = np.linspace(-half, half, 17 if view.camera.distorted else 2)
    box = np.array([[x, y, z] for x in side for y in side for z in (0.0, back)])
    image = view.to_image(box)
    x0, y0 = np.floor(image.min(axis=0)).astype(int) - margin_px
    x1, y1 = np.ceil(image.max(axis=0)).astype(int) + margin_px + 1
    x0, y0 = max(x0, 0), max(y0, 0)
    x1, y1 = min(x1, view.camera.width_px), min(y1, view.camera.height_px)
    if x0 >= x1 or y0 >= y1:
        return None
    samples = int(np.clip(np.sqrt(rays / ((x1 - x0) * (y1 - y0))), 2, 48))
    return Region(int(x0), int(y0), int(x1 - x0), int(y1 - y0), samples)


def _render_region(scene: Any, view: View, region: Region, seed: int) -> dict[str, NDArray[np.float32]]:
    """Basis images of a region, (nodes, height, width) by light; without a batched scene, by Mitsuba's own renderer."""
    pad = int(np.ceil(4 * view.camera.psf_sigma_px + 0.5))
    fine = _stock_subpixels if scene is None else _traced_subpixels
    result = {light: np.empty((len(view.nodes_nm), region.height, region.width), np.float32) for light in view.lights}
    for light, k, image, steps in fine(scene, view, region, pad, seed):
        columns = _reduction(region.width, pad, image.shape[1], steps[0], view.camera.psf_sigma_px)
        rows = _reduction(region.height, pad, image.shape[0], steps[1], view.camera.psf_sigma_px)
        result[light][k] = rows @ (image @ columns.T)
    return result


#: A light, the index of a wavelength, its sub-pixels (height, width), and their size along x and y [px].
_SubPixels = tuple[str, int, NDArray[np.float32], tuple[float, float]]


def _traced_subpixels(scene: Any, view: View, region: Region, pad: int, seed: int) -> Iterator[_SubPixels]:
    """Sub-pixels by the batched renderer, four wavelengths at a time."""
    step = 1 / region.samples
    for first in range(0, len(view.nodes_nm), 4):
        fine = _trace(scene, view, region, pad, view.nodes_nm[first : first + 4], seed)
        for light, images in fine.items():
            for k, image in enumerate(images):
                yield light, first + k, image, (step, step)


def _stock_subpixels(scene: Any, view: View, region: Region, pad: int, seed: int) -> Iterator[_SubPixels]:
    """Sub-pixels by Mitsuba's own renderer, for scalar variants; once only where no material changes with wavelength."""
    from scenes.stock import render_subpixels

    materials = [library.load(name) for name in view.target.materials]
    # A change of albedo smaller than this over the band is not worth a rendering at each node.
    flat = all(np.ptp(s(view.nodes_nm)) <= 0.002 for m in materials for s in (m.diffuse, m.gloss, m.retro))
    fx, fy = view.camera.focal_px
    steps = (1 / region.samples, fy / fx / region.samples)
    for light in view.lights:
        image = None
        for k, node in enumerate(view.nodes_nm):
            if image is None or not flat:
                image = render_subpixels(view, region, pad, node, light, seed)
            yield light, k, image, steps


@lru_cache(maxsize=64)
def _reduction(pixels: int, pad: int, count: int, step_px: float, psf_sigma_px: float) -> NDArray[np.float32]:
    """Matrix (pixels, count) that integrates sub-pixels of a size against the point-spread ⊗ pixel kernel."""
    edges = np.arange(count + 1) * step_px - pad - 0.5
    cumulative = pixel_profile_integral(edges - np.arange(pixels)[:, None], psf_sigma_px)
    matrix = np.diff(cumulative, axis=1)
    return (matrix / matrix.sum(axis=1, keepdims=True)).astype(np.float32)


@lru_cache(maxsize=4)
def _scene(marker: MarkerDesign, target: Target) -> Any:
    """Mitsuba scene in the marker frame [mm], without lights or sensor: both are data of the tracer."""
    import mitsuba as mi

    from materials import plugins

    plugins.register()
    description: dict[str, Any] = {"type": "scene"}
    names = {"retro": target.tape_material, "absorber": target.absorber_material}
    meshes = {names_key: (mesh, names[names_key]) for names_key, mesh in marker.meshes().items()}
    meshes["face"] = (face_mesh(target, marker), target.face_material)
    for key, ((vertices, faces), material) in meshes.items():
        props = mi.Properties()
        props["bsdf"] = mi.load_dict(plugins.bsdf_dict(library.load(material)))
        mesh = mi.Mesh(
            key, len(vertices), len(faces), props=props, has_vertex_normals=False, has_vertex_texcoords=False
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(vertices * MM_PER_M, dtype=np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
        parameters.update()
        description[key] = mesh
    return mi.load_dict(description)


def _trace(
    scene: Any, view: View, region: Region, pad: int, nodes_nm: tuple[int, ...], seed: int
) -> dict[str, list[NDArray[np.float32]]]:
    """Radiance of every sub-pixel of the padded region at four wavelengths, (height, width) each, by light."""
    import drjit as dr
    import mitsuba as mi

    height, width = ((n + 2 * pad) * region.samples for n in (region.height, region.width))
    camera = view.camera
    origin = view.to_marker(np.zeros(3)) * MM_PER_M
    leds = view.to_marker(view.leds.positions_m()) * MM_PER_M
    offsets = np.random.default_rng(seed).random(9)

    def opaque(value: float) -> Any:  # kernel data, so that another range or region does not compile again
        return dr.opaque(mi.Float, float(value))

    def lattice(a: float, b: float, offset: float) -> Any:
        x = mi.Float(column) * a + mi.Float(row) * b + opaque(offset)
        return x - dr.floor(x)

    lane = dr.arange(mi.UInt32, height * width)
    row = lane // dr.opaque(mi.UInt32, width)
    column = lane - row * dr.opaque(mi.UInt32, width)
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_point_px
    step = opaque(1 / region.samples)
    x = (mi.Float(column) + lattice(0.0, _GOLDEN, offsets[0])) * step + opaque(region.x0 - pad - 0.5 - cx)
    y = (mi.Float(row) + lattice(_GOLDEN, 0.0, offsets[1])) * step + opaque(region.y0 - pad - 0.5 - cy)
    axes = [mi.Vector3f(*(opaque(v) for v in axis)) for axis in view.rotation]  # rows: camera axes in the marker frame
    x, y = x / opaque(fx), y / opaque(fy)
    if camera.distorted:
        lens = camera.distortion
        x, y = BrownConrady(*(opaque(k) for k in (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3))).undistort(x, y)
    direction = dr.normalize(axes[0] * x + axes[1] * y + axes[2])
    ray = mi.Ray3f(mi.Point3f(*(opaque(v) for v in origin)), direction)
    for k, node in enumerate(nodes_nm):
        ray.wavelengths[k] = opaque(node)
    hit = scene.ray_intersect(ray)
    bsdf, context, valid = hit.bsdf(ray), mi.BSDFContext(), hit.is_valid()

    # LED ring: one LED a ray, evenly over the ring; intensity pattern about the camera's axis.
    table = mi.Point3f(*(mi.Float(np.ascontiguousarray(leds[:, k], dtype=np.float32)) for k in range(3)))
    count = dr.opaque(mi.UInt32, len(leds))
    choice = dr.minimum(mi.UInt32(lattice(_R2X, _R2Y, offsets[2]) * mi.Float(count)), count - 1)
    led = dr.gather(mi.Point3f, table, choice)
    to_led = led - hit.p
    distance2 = dr.squared_norm(to_led)
    to_led = to_led * dr.rsqrt(distance2)
    cos_axis = dr.maximum(-dr.dot(to_led, axes[2]), 0.0)
    intensity = dr.power(cos_axis, opaque(view.leds.exponent)) / distance2 * MM_PER_M**2
    value = bsdf.eval(context, hit, hit.to_local(to_led), valid)
    lit = valid & (dr.max(value) > 0)
    lit &= ~scene.ray_test(hit.spawn_ray_to(led), lit)
    from_leds = dr.select(lit, value * intensity, 0.0)

    # Sun: a uniform disc.
    disc = mi.warp.square_to_uniform_disk_concentric(
        mi.Point2f(lattice(_R2Y, _R2X, offsets[3]), lattice(_GOLDEN, _R2Y, offsets[4]))
    ) * opaque(np.tan(view.sun.angular_radius_rad))
    frame = mi.Frame3f(mi.Vector3f(*(opaque(v) for v in view.sun_in_marker)))
    to_sun = dr.normalize(frame.n + frame.s * disc.x + frame.t * disc.y)
    value = bsdf.eval(context, hit, hit.to_local(to_sun), valid)
    lit = valid & (dr.max(value) > 0)
    lit &= ~scene.ray_test(hit.spawn_ray(to_sun), lit)
    from_sun = dr.select(lit, value, 0.0)

    spectra = {"led": from_leds, "sun": from_sun}
    if view.earth is not None:
        draws = [lattice(_R2X, _GOLDEN, offsets[5]), lattice(_R2Y, _SQRT2, offsets[6])]
        draws += [lattice(_SQRT2, _R2X, offsets[7]), lattice(_SQRT3, _GOLDEN, offsets[8])]
        radius = view.earth.angular_radius_rad
        near_viewer = np.radians(view.earth.phase_deg) < radius + _RETRO_TAIL_RAD
        spectra["earth"] = earth_radiance(scene, ray, hit, view.earth_in_marker, radius, draws, near_viewer)
    dr.eval(*spectra.values())
    return {
        light: [np.array(value[k], copy=False).reshape(height, width) for k in range(len(nodes_nm))]
        for light, value in spectra.items()
    }
