"""Where markers stand on faces of 1 to 10 m, what they cover, and which of them a camera sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiometry.geometry import FRONTAL, FloatArray
from radiometry.optics import Camera
from scenes.face import PlacedMarker
from scenes.marker import MarkerDesign

Kind = Literal["wide", "narrow", "nested"]
Sizing = Literal["scaled", "fixed", "graded"]
#: Every layout that is studied: kind and sizing.
LAYOUTS: dict[str, tuple[Kind, Sizing]] = {
    **{f"{kind} {sizing}": (kind, sizing) for kind in ("wide", "narrow") for sizing in ("scaled", "fixed", "graded")},
    "nested": ("nested", "graded"),
}

#: Those that the thesis can be taken to mean; the others are this project's.
THESIS_LAYOUTS = tuple(name for name, (_, sizing) in LAYOUTS.items() if sizing in ("scaled", "fixed"))

#: Shares of a face: SYS-REQ-6 (either side of a marker), SYS-REQ-7 (area of all markers), and the area that section 6.1 names
#: for its 1 m face while it refers to SYS-REQ-7.
SIDE_SHARE_MAX, AREA_SHARE_MAX, TEXT_AREA_M2 = 0.10, 0.05, 0.025
#: SYS-REQ-14: out-of-plane dimension, 10 mm and 5 mm of tolerance [m]. SYS-REQ-2: farthest range, 20 m less 5 m of tolerance [m].
THICKNESS_MAX_M, FARTHEST_M = 0.015, 15.0
#: Outer markers from the face's centre, over its side. Wide: listing A.4. Narrow: figure 6.1 gives no figures; assumption.
OUTER_SHARE: dict[str, float] = {"wide": 0.4, "narrow": 0.2}
#: Inner markers from the centre, over the side of a 1 m face (listing A.4), and their side over an outer one's (section 6.1).
INNER_SHARE, INNER_SIZE = 0.075, 0.5
#: Room between nested rings, and between the innermost markers and the axes, over the smaller markers' side.
NESTED_GAP = 0.1
#: The 1 m face's outer marker [m].
OUTER_M = 0.10
_SIGNS = ((-1, 1), (1, 1), (1, -1), (-1, -1))


@dataclass(frozen=True)
class Layout:
    """Markers on a square face.

    Attributes:
        kind: 'wide' and 'narrow' are the thesis's; 'nested' is rings of markers, each twice as large as those inside it.
        sizing: 'scaled' enlarges the 1 m face's layout; 'fixed' keeps its markers and spreads the outer ones; 'graded' scales the
            outer markers and keeps the inner ones where and as they are on 1 m. A nested layout is always graded.
        face_m: side of the face.
        placed: the largest markers first, clockwise from top left; identities count up from 0.
    """

    kind: Kind
    sizing: Sizing
    face_m: float
    placed: tuple[PlacedMarker, ...]

    @property
    def area_m2(self) -> float:
        """Area of all markers [m²]."""
        return sum(p.design.size_m**2 for p in self.placed)

    @property
    def area_share(self) -> float:
        """Area of all markers over the face's, for SYS-REQ-7."""
        return self.area_m2 / self.face_m**2

    @property
    def side_share(self) -> float:
        """Side of the largest marker over the face's, for SYS-REQ-6."""
        return max(p.design.size_m for p in self.placed) / self.face_m


def layout(kind: Kind, face_m: float = 1.0, sizing: Sizing = "scaled", design: MarkerDesign | None = None) -> Layout:
    """A layout on a face; `design` gives everything but sizes and identities.

    Raises:
        ValueError: for an unknown kind or sizing, or a face smaller than the layout is made for.
    """
    if kind not in (*OUTER_SHARE, "nested") or sizing not in ("scaled", "fixed", "graded"):
        raise ValueError(f"layout: {kind!r}, {sizing!r}; expected wide, narrow or nested, and scaled, fixed or graded")
    if face_m < 1 and (sizing != "scaled" or kind == "nested"):
        raise ValueError(f"face_m: {face_m:g} m, expected at least 1 m for {kind}, {sizing} markers")
    if kind == "nested":
        rings = _nested_rings(face_m, design or MarkerDesign())
    else:
        scale = face_m if sizing == "scaled" else 1.0
        outer = OUTER_M * (1.0 if sizing == "fixed" else face_m)
        rings = [(outer, OUTER_SHARE[kind] * face_m, 4), (OUTER_M * INNER_SIZE * scale, INNER_SHARE * scale, 4)]
    design = design or MarkerDesign()
    placed: list[PlacedMarker] = []
    for size, reach, count in rings:
        for sx, sy in _SIGNS[:count]:
            changes = {"size_m": size, "identity": len(placed)}
            placed.append(PlacedMarker(design.model_copy(update=changes), (sx * reach, sy * reach)))
    return Layout(kind, sizing, face_m, tuple(placed))


def _nested_rings(face_m: float, design: MarkerDesign) -> list[tuple[float, float, int]]:
    """Size, distance of the centres from the axes and number of markers of each ring, the largest first.

    The largest is as large as SYS-REQ-6 and SYS-REQ-14 allow; each further one, down to 5 cm, is half the one around it. They
    stand a tenth of the smaller one's markers apart; the largest has as many markers as SYS-REQ-7 leaves, four at most.
    """
    size = min(SIDE_SHARE_MAX * face_m, THICKNESS_MAX_M * design.size_m / design.thickness_m)
    sizes: list[float] = []
    while size >= OUTER_M * INNER_SIZE * (1 - 1e-9):
        sizes.insert(0, size)
        size /= 2
    rings: list[tuple[float, float, int]] = []
    reach, area = 0.0, 0.0
    for size in sizes:
        gap = NESTED_GAP * (rings[0][0] if rings else size)
        centre = reach + gap + size / 2
        count = min(4, int((AREA_SHARE_MAX * face_m**2 - area) / size**2 * (1 + 1e-9)))
        rings.insert(0, (size, centre, count))
        reach, area = centre + size / 2, area + count * size**2
    return rings


def most_markers(side_share: float, area_share: float = AREA_SHARE_MAX) -> int:
    """How many markers of a side over the face's fit the area rule."""
    return int(np.floor(area_share / side_share**2 * (1 + 1e-9)))


def smallest_face_m(range_m: float, camera: Camera, design: MarkerDesign, px_per_bit: float) -> float:
    """Side of the smallest face that may carry a marker whose bits are resolved at a range, seen squarely [m] (SYS-REQ-6)."""
    bit_share = design.aruco_fraction / len(design.bits)
    return float(px_per_bit * range_m / (min(camera.focal_px) * bit_share) / SIDE_SHARE_MAX)


@dataclass(frozen=True)
class InView:
    """What a camera sees of a layout at some attitudes, (attitudes, markers): wholly in the frame, and resolved besides."""

    whole: NDArray[np.bool_]
    usable: NDArray[np.bool_]


def in_view(
    placed: Sequence[PlacedMarker], camera: Camera, range_m: float, angles_rad: FloatArray, px_per_bit: float
) -> InView:
    """Which markers are in the frame, the face's centre on the optical axis, for attitudes (n, 3) pitch, yaw, roll [rad].

    A marker is usable when its bits are at least `px_per_bit` pixels along their shorter side and it is turned to the camera.
    """
    size = np.array([camera.width_px, camera.height_px])
    half = np.array([p.half_m for p in placed])[:, None, None]
    centres = np.array([p.centre_m for p in placed])[:, None]
    flat = centres + half * np.array(_SIGNS)  # (markers, corners, 2)
    rotation = FRONTAL @ Rotation.from_euler("ZYX", angles_rad[:, ::-1]).as_matrix()
    corners = np.einsum("nij,kcj->nkci", rotation[:, :, :2], flat)
    corners[..., 2] += range_m
    before = corners[..., 2].min(axis=-1) > 0
    image = camera.project(np.where(before[..., None, None], corners, [0.0, 0.0, 1.0]))
    whole = before & np.all((image > -0.5) & (image < size - 0.5), axis=(-1, -2))
    facing = np.einsum("ni,nki->nk", rotation[:, :, 2], corners.mean(axis=2)) < 0
    sides = np.linalg.norm(np.roll(image, -1, axis=2) - image, axis=-1).min(axis=-1)
    bits = np.array([len(p.design.bits) / p.design.aruco_fraction for p in placed])
    return InView(whole, whole & facing & (sides / bits >= px_per_bit))


def random_attitudes(count: int, rng: np.random.Generator, tilt_deg: float = 45.0) -> FloatArray:
    """Attitudes (count, 3) [rad]: pitch and yaw uniform within ± `tilt_deg` (SYS-REQ-1), any roll."""
    limit = np.radians([tilt_deg, tilt_deg, 180.0])
    return rng.uniform(-1, 1, (count, 3)) * limit


def seen_share(faces: int, half_angle_deg: float = 45.0) -> float:
    """Share of all directions from which a marked face of a cube is seen within an angle of its normal (at most 45°).

    Caps of 45° about a cube's normals touch but do not overlap: N (1 − cos α) / 2.
    """
    if not 0 <= faces <= 6 or not 0 < half_angle_deg <= 45:
        raise ValueError(
            f"faces: {faces}, half_angle_deg: {half_angle_deg:g}; expected 0 to 6 faces and at most 45 deg"
        )
    return faces * (1 - float(np.cos(np.radians(half_angle_deg)))) / 2
