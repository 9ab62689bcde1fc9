"""Several markers on one face. Each is rendered by itself from where it stands, and the images are put together into one frame.

The front planes lie in one plane, so no marker shades another. Light from one marker to another is indirect light, which
the renderer leaves out. The foil behind is the same for all of them, except for its depth, which follows each marker's own
thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign
from scenes.render.transport import Quality, TransportBasis, View, render_cases

#: How much of a marker's surroundings is copied with it into the frame: four pixels, but less than half the gap to its neighbour.
_MARGIN_PX, _SHARE_OF_GAP = 4.0, 0.45


@dataclass(frozen=True)
class PlacedMarker:
    """A marker on a face, its sides parallel to those of the face.

    Attributes:
        design: the marker.
        centre_m: its centre on the face, x to the right and y up [m].
    """

    design: MarkerDesign
    centre_m: tuple[float, float]

    @property
    def half_m(self) -> float:
        """Half the side of the marker [m]."""
        return self.design.size_m / 2


@dataclass(frozen=True)
class FaceView(View):
    """A view of one marker of a face. The centre of the face stands on the optical axis, at the range.

    Attributes:
        place_m: the marker's centre on the face, x to the right and y up [m].
    """

    place_m: tuple[float, float] = (0.0, 0.0)

    @cached_property
    def translation_m(self) -> FloatArray:
        """Marker's origin in the camera frame, (3,) [m]."""
        return np.array([0.0, 0.0, self.range_m]) + self.rotation @ np.array([*self.place_m, 0.0])


def face_view(view: View, placed: PlacedMarker) -> FaceView:
    """The view of one marker of the face that `view` looks at.

    Args:
        view: camera, lights, target and range; its own marker is ignored.
        placed: the marker.
    """
    x, y = placed.centre_m
    shared = {f.name: getattr(view, f.name) for f in fields(View)}
    target = view.target.model_copy(update={"face_centre_m": (-x, -y)})
    return FaceView(**{**shared, "marker": placed.design, "target": target}, place_m=placed.centre_m)


def check_apart(placed: Sequence[PlacedMarker]) -> None:
    """Check that no two markers overlap.

    Args:
        placed: the markers of one face.

    Raises:
        ValueError: when two markers overlap.
    """
    for k, one in enumerate(placed):
        for other in placed[:k]:
            if _gap(one, other) < 0:
                raise ValueError(
                    f"markers at {one.centre_m} and {other.centre_m} m overlap by {-_gap(one, other):g} m; expected them apart"
                )


def _gap(one: PlacedMarker, other: PlacedMarker) -> float:
    apart = np.abs(np.subtract(one.centre_m, other.centre_m))
    return float(apart.max() - one.half_m - other.half_m)


def in_frame(view: View, placed: PlacedMarker) -> bool:
    """Whether all corners of a marker lie within the frame.

    Args:
        view: of the face.
        placed: the marker.
    """
    return bool(np.all(_corners_inside(view, placed)))


def _corners_inside(view: View, placed: PlacedMarker) -> NDArray[np.bool_]:
    seen = face_view(view, placed)
    half = placed.half_m
    corners = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    before = corners @ seen.rotation[2] + seen.translation_m[2] > 0
    image = seen.to_image(np.where(before[:, None], corners, 0.0))
    size = np.array([view.camera.width_px, view.camera.height_px])
    return before & np.all((image > -0.5) & (image < size - 0.5), axis=1)


def render_face(view: View, placed: Sequence[PlacedMarker], quality: Quality | None = None) -> TransportBasis:
    """Transport basis of a face with several markers. The first marker in the frame also supplies the rest of the image.

    Args:
        view: camera, lights, target and range; the centre of the face is on its axis, its own marker is ignored.
        placed: at least one marker, none overlapping another.
        quality: how densely to sample; default `Quality()`.

    Raises:
        ValueError: when there is no marker, or two overlap.
        RuntimeError: when no Mitsuba variant can run here.
    """
    if not placed:
        raise ValueError("placed: no marker, expected at least one")
    check_apart(placed)
    quality = quality or Quality()
    seen = [(k, face_view(view, one)) for k, one in enumerate(placed) if _corners_inside(view, one).any()]
    seen = seen or [(0, face_view(view, placed[0]))]
    first = seen[0][0]
    cases = [
        (one, replace(quality, frame_samples=quality.frame_samples if k == first else 0, seed=quality.seed + k))
        for k, one in seen
    ]
    bases = render_cases(cases)
    whole = next(bases)
    for (k, one), basis in zip(seen[1:], bases, strict=True):
        mask = _surroundings(one, placed, k)
        for light, images in whole.layers.items():
            images[:, mask] = basis.layers[light][:, mask]
    return TransportBasis(whole.nodes_nm, whole.layers, {"markers": float(len(placed))})


def _surroundings(view: FaceView, placed: Sequence[PlacedMarker], k: int) -> NDArray[np.bool_]:
    """Pixels (height, width) whose centres lie on a marker or near it."""
    camera = view.camera
    others = [_gap(placed[k], other) for other in placed if other is not placed[k]]
    margin = min(_MARGIN_PX * view.translation_m[2] / max(camera.focal_px), _SHARE_OF_GAP * min(others, default=np.inf))
    column, row = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    place = view.to_plane(np.stack([column, row], axis=-1).reshape(-1, 2).astype(float))
    inside = np.all(np.abs(place) <= placed[k].half_m + margin, axis=1)
    return inside.reshape(camera.height_px, camera.width_px)
