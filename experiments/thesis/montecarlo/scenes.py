"""Synthetic pose problems of the thesis's Monte Carlo simulation (sections 3.7 and 8.4, listing A.4).

A scene is a set of points on or near a 1 m spacecraft face, a pose, and noisy image positions. Two angle orders:

'intended'  R = R_0 Rz(roll) Ry(yaw) Rx(pitch), pitch and yaw within ±45°, any roll: every scene shows the face.
'listing'   R = (Rz(pitch) Ry(yaw) Rx(roll))ᵀ, what the listing's eul2rotm([pitch, yaw, roll]) and Matlab's row vectors
            amount to: "pitch" turns the face in its own plane, "roll" turns it over, and half the scenes show its back.

Both are expressed in the project's marker frame, z out of the face. In the listing R = 1 shows the face, so its z runs
into it: R_here = R_listing R_0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiometry.geometry import FRONTAL, FloatArray
from radiometry.optics import Camera

BoolArray = NDArray[np.bool_]
AngleOrder = Literal["intended", "listing"]
#: Standard deviation per axis [px] of every point, from range (n,) [m] and whether the point is virtual (m,); (n, m).
#: NaN: the feature is not seen.
NoiseLaw = Callable[[FloatArray, BoolArray], FloatArray]

#: Table 3.1 and listing A.4.
TILT_LIMIT_RAD = np.deg2rad(45.0)
FEWEST_POINTS = 6

_NOISE_NEAR_PX, _NOISE_FAR_PX, _NOISE_FAR_M = 0.1, 0.5, 100.0


def noise_listing(range_m: FloatArray, virtual: BoolArray) -> FloatArray:
    """σ = 0.1 + 0.4 (R/100 m)³ px, as coded in listing A.4: 0.100 to 0.103 px over 1–20 m."""
    sigma = _NOISE_NEAR_PX + (_NOISE_FAR_PX - _NOISE_NEAR_PX) * (range_m / _NOISE_FAR_M) ** 3
    return np.broadcast_to(sigma[:, None], (len(range_m), len(virtual)))


def noise_text(range_m: FloatArray, virtual: BoolArray) -> FloatArray:
    """σ = 0.1 + (0.4/100) R³ px, equation 3.1 with R in metres as printed: 32 px at 20 m. Its units do not agree."""
    sigma = _NOISE_NEAR_PX + (_NOISE_FAR_PX - _NOISE_NEAR_PX) / _NOISE_FAR_M * range_m**3
    return np.broadcast_to(sigma[:, None], (len(range_m), len(virtual)))


def noise_constant(sigma_px: float) -> NoiseLaw:
    """The same standard deviation [px] for every point at every range."""
    return lambda range_m, virtual: np.full((len(range_m), len(virtual)), sigma_px)


@dataclass(frozen=True)
class Layout:
    """Points on the face, (m, 3) [m] with z out of the face, and which of them are virtual (m,).

    `random` draws them anew for each scene: `points_m` is then the box, its two opposite corners.
    """

    name: str
    points_m: FloatArray
    virtual: BoolArray
    random: bool = False


def random_layout(count: int = 8) -> Layout:
    """Points uniform in 0.5 × 0.5 × 0.1 m (section 3.7), at least 10 mm apart, protruding from the face.

    The text has 8 and, once, 12 points; the listing 8. Which way they stand out is not said: assumption.
    """
    box = np.array([[-0.25, -0.25, 0.0], [0.25, 0.25, 0.1]])
    return Layout("random", box, np.zeros(count, bool), random=True)


#: Half the spacing of the outer markers [m]. Wide: listing A.4. Narrow: figure 6.1 gives no figures; assumption.
_OUTER_M = {"wide": 0.4, "narrow": 0.2}


def marker_layout(kind: Literal["wide", "narrow"], flat: bool = False, as_listed: bool = False) -> Layout:
    """Four 10 cm markers with one virtual point each, and four 5 cm ones about the centre with two (section 6.1): 44 points.

    The ArUco is half the marker wide; its virtual point lies a quarter of the marker's width behind the face (assumption:
    half an element's length, the element half a marker long; the listing prints the flat variant only). `flat` puts the
    virtual points on the face. `as_listed` keeps the listing's errors: two misplaced central markers, and central
    ArUcos half as wide as meant.
    """
    reach = _OUTER_M[kind]
    outer = reach * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    inner = 0.075 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1.0]])
    aruco, half_virtual = 0.025, 0.025 / 8
    if as_listed:
        inner = np.array([[-0.075, -0.075], [0, 0.075], [0.075, -0.075], [0.1, 0.1]])
        aruco = 0.0125
    square = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
    points, virtual = [], []
    for centres, side, heads, depth in (
        (outer, 0.05, np.zeros((1, 2)), 0.025),
        (inner, aruco, np.array([[-half_virtual, 0], [half_virtual, 0]]), 0.0125),
    ):
        for centre in centres:
            corners = np.column_stack([centre + side * square, np.zeros(4)])
            behind = np.column_stack([centre + heads, np.full(len(heads), 0.0 if flat else -depth)])
            points += [corners, behind]
            virtual += [np.zeros(4, bool), np.ones(len(heads), bool)]
    return Layout("flat" if flat else kind, np.concatenate(points), np.concatenate(virtual))


def single_marker(size_m: float, virtual_points: int) -> Layout:
    """One marker: an ArUco of half its width, and virtual points a quarter of its width behind the face.

    `virtual_points` is 0, 1 or 4. One lies at the centre; four lie at ±1/8 of the marker's width, a quarter of an element's
    length off its centre.
    """
    half = size_m / 4
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    if virtual_points not in (0, 1, 4):
        raise ValueError(f"virtual_points: {virtual_points}; expected 0, 1 or 4")
    offset = {0: np.zeros((0, 2)), 1: np.zeros((1, 2)), 4: np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * size_m / 8}[
        virtual_points
    ]
    behind = np.column_stack([offset, np.full(len(offset), -size_m / 4)])
    virtual = np.arange(4 + len(offset)) >= 4
    return Layout(f"{virtual_points} virtual", np.concatenate([corners, behind]), virtual)


@dataclass(frozen=True)
class Scenes:
    """n pose problems of m points.

    range_m (n,), angles_rad (n, 3) pitch, yaw, roll; points_m (n, m, 3); rotation (n, 3, 3) and translation_m (n, 3), marker
    to camera; pixels (n, m, 2) with noise; sigma_px (n, m); visible (n, m).
    """

    order: AngleOrder
    range_m: FloatArray
    angles_rad: FloatArray
    points_m: FloatArray
    rotation: FloatArray
    translation_m: FloatArray
    pixels: FloatArray
    sigma_px: FloatArray
    visible: BoolArray

    @property
    def shows_back(self) -> BoolArray:
        """Scenes in which the camera looks at the back of the face, (n,)."""
        return np.einsum("ni,ni->n", self.rotation[:, :, 2], self.translation_m) > 0


def rotations(angles_rad: FloatArray, order: AngleOrder) -> FloatArray:
    """Rotations marker -> camera, (n, 3, 3), of pitch, yaw, roll (n, 3)."""
    if order == "intended":
        return FRONTAL @ Rotation.from_euler("ZYX", angles_rad[:, ::-1]).as_matrix()
    return np.swapaxes(Rotation.from_euler("ZYX", angles_rad).as_matrix(), 1, 2) @ FRONTAL


def angles(rotation: FloatArray, order: AngleOrder) -> FloatArray:
    """Pitch, yaw, roll (n, 3) of rotations (n, 3, 3); the inverse of `rotations` for |yaw| < 90°."""
    m = FRONTAL @ rotation if order == "intended" else np.swapaxes(rotation @ FRONTAL, 1, 2)
    about_z = np.arctan2(m[:, 1, 0], m[:, 0, 0])
    about_y = np.arcsin(np.clip(-m[:, 2, 0], -1, 1))
    about_x = np.arctan2(m[:, 2, 1], m[:, 2, 2])
    first, last = (about_x, about_z) if order == "intended" else (about_z, about_x)
    return np.stack([first, about_y, last], axis=1)


def make_scenes(
    layout: Layout,
    range_m: FloatArray,
    camera: Camera,
    rng: np.random.Generator,
    noise: NoiseLaw = noise_listing,
    order: AngleOrder = "intended",
    swapped_field: bool = False,
    fewest_points: int = FEWEST_POINTS,
) -> Scenes:
    """One scene for each range (n,) [m], on the optical axis at that range.

    `swapped_field` keeps the points within rows × columns instead of columns × rows, as the listing does. Random points are
    drawn again until `fewest_points` are in view; a fixed layout may show fewer, and its solvers then fail.
    """
    n, m = len(range_m), len(layout.virtual)
    limit = [TILT_LIMIT_RAD, TILT_LIMIT_RAD, np.pi]
    drawn = rng.uniform(-1, 1, (n, 3)) * limit
    rotation = rotations(drawn, order)
    translation = np.stack([np.zeros(n), np.zeros(n), range_m], axis=1)
    sigma = noise(range_m, layout.virtual)
    field = (camera.height_px, camera.width_px) if swapped_field else (camera.width_px, camera.height_px)

    def project(points: FloatArray, rows: NDArray[np.intp]) -> tuple[FloatArray, BoolArray]:
        exact = camera.project(points @ np.swapaxes(rotation[rows], 1, 2) + translation[rows, None])
        inside = np.all((exact > -0.5) & (exact < np.asarray(field) - 0.5), axis=-1)
        return exact, inside & ~np.isnan(sigma[rows])

    rows = np.arange(n)
    points = np.broadcast_to(layout.points_m, (n, *layout.points_m.shape))
    if layout.random:
        points = _random_points(layout.points_m, n, m, rng)
    exact, visible = project(points, rows)
    while layout.random and (few := np.flatnonzero(visible.sum(axis=1) < fewest_points)).size:
        points[few] = _random_points(layout.points_m, len(few), m, rng)
        exact[few], visible[few] = project(points[few], few)
    pixels = exact + np.nan_to_num(sigma)[..., None] * rng.standard_normal((n, m, 2))
    return Scenes(
        order=order,
        range_m=range_m,
        angles_rad=drawn,
        points_m=points,
        rotation=rotation,
        translation_m=translation,
        pixels=pixels,
        sigma_px=sigma,
        visible=visible,
    )


def _random_points(box: FloatArray, n: int, m: int, rng: np.random.Generator) -> FloatArray:
    """(n, m, 3) uniform in a box, each set redrawn until its points are 10 mm apart (listing A.4)."""
    points = rng.uniform(box[0], box[1], (n, m, 3))
    while True:
        gap = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) + np.eye(m)
        close = np.flatnonzero(gap.min(axis=(1, 2)) < 0.01)
        if not close.size:
            return points
        points[close] = rng.uniform(box[0], box[1], (len(close), m, 3))
