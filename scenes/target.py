"""The debris face that carries the marker: a square of crinkled foil behind the marker plane."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from scenes.marker import MarkerDesign, Mesh


class Target(BaseModel):
    """Face of the target spacecraft and how it stands and turns before the camera."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    face_m: Annotated[float, Field(gt=0, le=50, allow_inf_nan=False)] = Field(
        1.0, description="side of the square face [m]"
    )
    face_material: str = Field("mli_foil", description="material of the face, a name of the library")
    tape_material: str = Field("tape_type_xi", description="material of the marker's reflective parts")
    absorber_material: str = Field("black_coating", description="material of the marker's absorbing parts")
    facet_m: Annotated[float, Field(gt=0)] = Field(
        0.02, description="side of a facet of the crinkled foil [m]; assumption"
    )
    facet_slope_deg: Annotated[float, Field(ge=0, le=30)] = Field(
        4.0, description="standard deviation of the facets' slope [deg]; 0 is a flat sheet; assumption"
    )
    facet_seed: int = Field(1, ge=0, description="which crinkle")
    pitch_deg: Annotated[float, Field(ge=-80, le=80)] = Field(0.0, description="tilt about the marker's x axis [deg]")
    yaw_deg: Annotated[float, Field(ge=-80, le=80)] = Field(0.0, description="tilt about the marker's y axis [deg]")
    roll_deg: Annotated[float, Field(ge=-180, le=180)] = Field(0.0, description="turn about the marker's normal [deg]")
    tumble_deg_s: Annotated[float, Field(ge=0, le=360)] = Field(5.0, description="rate of turn, SYS-REQ-5 [deg/s]")
    tumble_lever_m: Annotated[float, Field(ge=0, le=50)] = Field(
        0.57,
        description="distance of the marker from the axis of turn [m]; assumption: near half a 1 m face's diagonal",
    )


def face_mesh(target: Target, marker: MarkerDesign) -> Mesh:
    """Crinkled sheet as flat triangles: vertices (n, 3) in the marker frame [m], faces (m, 3), facing the viewer.

    Heights are independent and Gaussian at the grid's vertices. A facet's slope along an edge is the difference of two of
    them over the edge, so σ_height = slope · facet / √2. All of it stays behind the marker's mounting plane.
    """
    cells = max(1, round(target.face_m / target.facet_m)) if target.facet_slope_deg > 0 else 1
    rng = np.random.default_rng(target.facet_seed)
    edge = np.linspace(-target.face_m / 2, target.face_m / 2, cells + 1)
    x, y = np.meshgrid(edge, edge)
    step = target.face_m / cells
    sigma = np.tan(np.radians(target.facet_slope_deg)) * step / np.sqrt(2)
    if cells > 1:
        inner = (slice(1, -1), slice(1, -1))
        x[inner] += rng.uniform(-0.3, 0.3, x[inner].shape) * step
        y[inner] += rng.uniform(-0.3, 0.3, y[inner].shape) * step
    height = rng.standard_normal(x.shape).clip(-3, 3) * sigma
    z = -marker.thickness_m - 3 * sigma + height
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    index = np.arange((cells + 1) ** 2, dtype=np.uint32).reshape(cells + 1, cells + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return vertices, faces
