"""The debris face that carries the marker: a square of crinkled foil behind the marker, and metal bars beside it if wanted."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign, Mesh, Offset

#: Facets along a side of the face that the renderer is asked to mesh: two million triangles.
MAX_FACETS = 1000
#: Flat strips of a half-round bar, enough that a glint of some degrees' lobe is smooth.
_EDGE_STRIPS = 64


class Target(BaseModel):
    """Face of the target spacecraft, its attitude and its rotation before the camera.

    Raises:
        ValueError: when the facets are too small for the face to be meshed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    face_m: Annotated[float, Field(gt=0, le=50, allow_inf_nan=False)] = Field(
        1.0, description="side of the square face [m]"
    )
    face_centre_m: tuple[Offset, Offset] = Field(
        (0.0, 0.0), description="centre of the face in the marker's frame, to the right and up [m]"
    )
    face_material: str = Field("mli_foil", description="material of the face, a name of the library")
    tape_material: str = Field("tape_type_xi", description="material of the marker's reflective parts")
    absorber_material: str = Field("black_coating", description="material of the marker's absorbing parts")
    facet_m: Annotated[float, Field(gt=0, allow_inf_nan=False)] = Field(
        0.02, description="side of a facet of the crinkled foil [m]; assumption"
    )
    facet_slope_deg: Annotated[float, Field(ge=0, le=30)] = Field(
        4.0, description="standard deviation of the facets' slope [deg]; 0 is a flat sheet; assumption"
    )
    facet_seed: int = Field(1, ge=0, description="which crinkle")
    edge_radius_m: Annotated[float, Field(ge=0, le=0.1, allow_inf_nan=False)] = Field(
        0.0, description="radius of half-round bars along the marker's four sides [m]; 0 is none"
    )
    edge_material: str = Field("aluminium", description="material of those bars")
    pitch_deg: Annotated[float, Field(ge=-80, le=80)] = Field(0.0, description="tilt about the marker's x axis [deg]")
    yaw_deg: Annotated[float, Field(ge=-80, le=80)] = Field(0.0, description="tilt about the marker's y axis [deg]")
    roll_deg: Annotated[float, Field(ge=-180, le=180)] = Field(0.0, description="turn about the marker's normal [deg]")
    tumble_deg_s: Annotated[float, Field(ge=0, le=360)] = Field(5.0, description="rate of turn, SYS-REQ-5 [deg/s]")
    tumble_lever_m: Annotated[float, Field(ge=0, le=50)] = Field(
        0.57,
        description="distance of the marker from the axis of turn [m]; assumption: near half a 1 m face's diagonal",
    )

    @model_validator(mode="after")
    def _meshable(self) -> Target:
        if self.facet_slope_deg > 0 and self.face_m / self.facet_m > MAX_FACETS:
            raise ValueError(
                f"facet_m: {self.facet_m:g} m is {self.face_m / self.facet_m:.0f} facets along face_m, {self.face_m:g} m; "
                f"expected at most {MAX_FACETS}"
            )
        return self

    @property
    def tumble_speed_m_s(self) -> float:
        """Speed of the marker across the line of sight as the target tumbles [m/s]."""
        return float(np.radians(self.tumble_deg_s) * self.tumble_lever_m)

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of all materials: tape, absorber, face, and the bars' where there are any."""
        names = self.tape_material, self.absorber_material, self.face_material
        return (*names, self.edge_material) if self.edge_radius_m > 0 else names


def surroundings(target: Target, marker: MarkerDesign) -> dict[str, tuple[Mesh, str]]:
    """Everything around the marker, as mesh and name of the material by name of the surface.

    Args:
        target: the face.
        marker: behind which it stands.
    """
    meshes = {"face": (face_mesh(target, marker), target.face_material)}
    if target.edge_radius_m > 0:
        meshes["edge"] = (edge_mesh(target, marker), target.edge_material)
    return meshes


def face_mesh(target: Target, marker: MarkerDesign) -> Mesh:
    """Crinkled sheet as flat triangles that face the viewer.

    Heights are independent and Gaussian, cut at 3σ, at the vertices of a jittered grid. They are scaled so that the root
    mean square of the slopes ∂z/∂x and ∂z/∂y of the facets is tan(facet_slope). The whole sheet stays behind the mounting
    plane of the marker.

    Args:
        target: size, facets and seed.
        marker: behind which the sheet stands.

    Returns:
        Vertices (n, 3) in the marker frame [m] and triangles (m, 3).
    """
    cells = max(1, round(target.face_m / target.facet_m)) if target.facet_slope_deg > 0 else 1
    rng = np.random.default_rng(target.facet_seed)
    edge = np.linspace(-target.face_m / 2, target.face_m / 2, cells + 1)
    x, y = np.meshgrid(edge, edge)
    step = target.face_m / cells
    if cells > 1:
        inner = (slice(1, -1), slice(1, -1))
        # From a quarter of a step on, a triangle could turn over.
        x[inner] += rng.uniform(-0.2, 0.2, x[inner].shape) * step
        y[inner] += rng.uniform(-0.2, 0.2, y[inner].shape) * step
    height = rng.standard_normal(x.shape).clip(-3, 3)
    index = np.arange((cells + 1) ** 2, dtype=np.uint32).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    vertices = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    sigma = np.tan(np.radians(target.facet_slope_deg)) / np.sqrt(np.mean(facet_slopes(vertices, faces) ** 2))
    vertices[:, 2] = -marker.thickness_m + sigma * (vertices[:, 2] - 3)
    vertices[:, :2] += target.face_centre_m
    return vertices, faces


def edge_mesh(target: Target, marker: MarkerDesign) -> Mesh:
    """Half-round bars along the marker's four sides, one radius away from them and flush with its back.

    A cylinder has a line of specular points for any Sun in its half space: an edge that always glints somewhere.

    Args:
        target: for the radius of the bars.
        marker: beside which they stand.

    Returns:
        Vertices (n, 3) in the marker frame [m] and triangles (m, 3).
    """
    radius, reach = target.edge_radius_m, marker.size_m / 2 + 3 * target.edge_radius_m
    angle = np.linspace(0, np.pi, _EDGE_STRIPS + 1)
    profile = np.stack([-np.cos(angle), np.sin(angle)], axis=-1) * radius  # across the bar, out of the face
    across = marker.size_m / 2 + 2 * radius + profile[:, 0]
    ends = [np.stack([across, np.full_like(across, y), profile[:, 1]], axis=-1) for y in (-reach, reach)]
    bar = np.stack(ends, axis=1).reshape(-1, 3)
    k = 2 * np.arange(_EDGE_STRIPS, dtype=np.uint32)[:, None]
    strips = np.concatenate([k + np.array([0, 3, 1], np.uint32), k + np.array([0, 2, 3], np.uint32)])
    vertices, faces = [], []
    for turn in range(4):
        c, s = (1, 0, -1, 0)[turn], (0, 1, 0, -1)[turn]
        vertices.append(np.stack([c * bar[:, 0] - s * bar[:, 1], s * bar[:, 0] + c * bar[:, 1], bar[:, 2]], axis=-1))
        faces.append(strips + np.uint32(turn * len(bar)))
    points = np.concatenate(vertices)
    points[:, 2] -= marker.thickness_m
    return points, np.concatenate(faces)


def facet_slopes(vertices_m: FloatArray, faces: NDArray[np.uint32]) -> FloatArray:
    """Slopes ∂z/∂x and ∂z/∂y of every triangle of a mesh, (m, 2).

    Args:
        vertices_m: (n, 3) [m].
        faces: triangles (m, 3).
    """
    a, b, c = (vertices_m[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return -normal[:, :2] / normal[:, 2:]
