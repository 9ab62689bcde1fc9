"""What rays can hit: marker and target as triangles, and the marker in closed form where that is valid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from materials import library
from materials.library import Material
from radiometry.spectrum import Spectrum
from scenes.marker import MarkerDesign
from scenes.projection.regions import bounds_m
from scenes.render.marker_rays import MarkerHit, MarkerRays
from scenes.target import Target, surroundings
from scenes.view import MM_PER_M


class Scene:
    """A Mitsuba scene in the marker frame [mm], without lights or sensor. Both are data of the tracer.

    Attributes:
        materials: material of each surface by name; 'retro' and 'absorber' are the first two.
        solids: the triangles, a Mitsuba scene.
        shapes: Mitsuba's shapes by name.
        marker: the marker in closed form, or None where something stands in front of its plane.
    """

    def __init__(self, marker: MarkerDesign, surface: Target) -> None:
        import mitsuba as mi

        from materials import plugins

        plugins.register()
        names = {"retro": surface.tape_material, "absorber": surface.absorber_material}
        meshes = {key: (mesh, names[key]) for key, mesh in marker.meshes().items()}
        meshes |= surroundings(surface, marker)
        description: dict[str, Any] = {"type": "scene"}
        #: Material of each surface; 'retro' and 'absorber' are the first two.
        self.materials = {key: library.load(material) for key, (_, material) in meshes.items()}
        for key, ((vertices, faces), _) in meshes.items():
            props = mi.Properties()
            props["bsdf"] = mi.load_dict(plugins.bsdf_dict(self.materials[key]))
            mesh = mi.Mesh(
                key, len(vertices), len(faces), props=props, has_vertex_normals=False, has_vertex_texcoords=False
            )
            parameters = mi.traverse(mesh)
            parameters["vertex_positions"] = np.ascontiguousarray(vertices * MM_PER_M, dtype=np.float32).ravel()
            parameters["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
            parameters.update()
            description[key] = mesh
        self.solids = mi.load_dict(description)
        self.shapes = {shape.id(): shape for shape in self.solids.shapes()}
        # Only where nothing stands before the front plane does a ray through it meet the marker and nothing else.
        flush = bounds_m(marker, surface)[1, 2] <= 0
        self.marker = MarkerRays(marker) if isinstance(marker, MarkerDesign) and flush else None


@dataclass
class SurfaceInteraction:
    """Surface points that rays have hit, a lane each.

    Attributes:
        hit: Mitsuba's interaction, in millimetres.
        valid: whether anything was hit.
        deep: whether the point is on the floor of a slit.
    """

    hit: Any
    valid: Any
    deep: Any
    _surface: Any  # index of its material
    _brdfs: list[Callable[[Any, Any, Any], Any]]
    _scene: Any
    _marker: MarkerHit | None

    def reflected(self, direction: Any, source: Any = None) -> Any:
        """Radiance towards the viewer per irradiance of a plane square to a direction [sr⁻¹]; zero in shadow.

        Args:
            direction: unit vector to the light.
            source: position of the light [mm]; default infinitely far away.
        """
        import drjit as dr

        out, back = self.hit.to_local(direction), self.hit.wi
        lit = self.valid & (out.z > 0) & (back.z > 0)
        chord2 = dr.squared_norm(back - out)
        brdf = dr.switch(self._surface, self._brdfs, dr.maximum(back.z, 1e-6), dr.maximum(out.z, 1e-6), chord2)
        ray = self.hit.spawn_ray(direction) if source is None else self.hit.spawn_ray_to(source)
        if self._marker is None:
            lit &= ~self._scene.ray_test(ray, lit)
        else:
            lit &= ~self._scene.ray_test(ray, lit & ~self._marker.found)
            lit &= ~self._marker.found | self._marker.sees(self.hit.p, direction)
        return dr.select(lit, brdf * out.z, 0.0)


def intersect(scene: Scene, ray: Any, nodes_nm: tuple[int, ...]) -> SurfaceInteraction:
    """First surface points of camera rays.

    Args:
        scene: what the rays can hit.
        ray: the camera's rays, in the marker frame [mm].
        nodes_nm: up to four wavelengths at which the surfaces reflect [nm].
    """
    import drjit as dr
    import mitsuba as mi

    brdfs = [_brdf(material, nodes_nm) for material in scene.materials.values()]
    if scene.marker is None:
        hit = scene.solids.ray_intersect(ray)
        surface = _surface(scene, hit)
        return SurfaceInteraction(
            hit=hit,
            valid=hit.is_valid(),
            deep=mi.Bool(False),
            _surface=surface,
            _brdfs=brdfs,
            _scene=scene.solids,
            _marker=None,
        )
    on_marker = scene.marker.find(ray.o, ray.d)
    hit = scene.solids.ray_intersect(ray, active=~on_marker.found)
    surface = dr.select(on_marker.found, dr.select(on_marker.bright, mi.UInt32(0), 1), _surface(scene, hit))
    hit.t = dr.select(on_marker.found, on_marker.distance, hit.t)
    hit.p = dr.select(on_marker.found, ray(hit.t), hit.p)
    hit.n = dr.select(on_marker.found, on_marker.normal, hit.n)
    hit.sh_frame = mi.Frame3f(hit.n)
    hit.wi = hit.to_local(-ray.d)
    return SurfaceInteraction(
        hit=hit,
        valid=on_marker.found | hit.is_valid(),
        deep=on_marker.floor,
        _surface=surface,
        _brdfs=brdfs,
        _scene=scene.solids,
        _marker=on_marker,
    )


def _surface(scene: Scene, hit: Any) -> Any:
    import drjit as dr
    import mitsuba as mi

    index = mi.UInt32(0)
    for k, name in enumerate(scene.materials):
        index = dr.select(hit.shape == mi.ShapePtr(scene.shapes[name]), k, index)
    return index


def _brdf(material: Material, nodes_nm: tuple[int, ...]) -> Callable[[Any, Any, Any], Any]:
    """A material's reflectance at four wavelengths, of the cosines and the squared chord; data of the kernel, not its code."""
    import drjit as dr
    import mitsuba as mi

    def at_nodes(spectrum: Spectrum) -> Any:
        values = [float(spectrum(float(nodes_nm[min(k, len(nodes_nm) - 1)]))) for k in range(4)]
        return mi.Spectrum(*(dr.opaque(mi.Float, value) for value in values))

    lobes, spectra = material.lobes, [at_nodes(s) for s in (material.diffuse, material.gloss, material.retro)]

    def evaluate(cos_i: Any, cos_o: Any, chord2: Any) -> Any:
        return mi.Spectrum(lobes.evaluate(dr, cos_i, cos_o, chord2, *spectra))

    return evaluate
