"""Equations 5.17 to 5.20 for a marker's dimensions: as printed, and right; limits of a blob that is found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detector.elements.blobs import MAX_CUT_FRACTION
from radiometry import field_of_view as fov
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

#: What the thesis takes by estimate: its margin on either side, and its lateral field.
THESIS_MARGIN_RAD, THESIS_LATERAL_RAD = np.radians(18.0), np.radians(100.0)
#: Share of the floor's width that must show for the blob still to be measured; assumption, held against rendering.
LATERAL_SHARE = 0.1


@dataclass(frozen=True)
class Limits:
    """Limits of one element of a marker.

    Attributes:
        sides: without a margin, the two terms of equation 5.18.
        whole: where the whole blob lies on the opening.
        found: where the detector accepts it, `MAX_CUT_FRACTION` of its light beyond the end at most.
        thesis: 18° off either side.
        lateral: of the floor, by `LATERAL_SHARE`.
        half_base_m: of the blob.
        margin_share: how far the blob's middle must stay from an end to be found, over the element's length.
    """

    sides: fov.Sides
    whole: fov.Sides
    found: fov.Sides
    thesis: fov.Sides
    lateral: float
    half_base_m: float
    margin_share: float

    @property
    def printed_marker(self) -> float:
        """Equation 5.19 with the thesis's margin [rad]."""
        return fov.combined_field(self.thesis)

    @property
    def marker(self) -> float:
        """Equation 5.19 with one margin in length [rad]."""
        return fov.combined_field(self.found)


def limits(marker: MarkerDesign) -> Limits:
    """Closed-form limits of a marker's elements, for a far camera."""
    length, depth = marker.element_length_m, marker.virtual_depth_fraction * marker.element_length_m
    near = (0.5 - marker.virtual_offset_fraction) * length
    slit = length / marker.slit_count * (1 - marker.slat_fraction)
    half = fov.blob_half_base(slit, marker.element_depth_m, depth)
    margin = fov.margin_of_cut(half, MAX_CUT_FRACTION)
    sides = fov.element_sides(length, near, depth)
    return Limits(
        sides=sides,
        whole=fov.element_sides(length, near, depth, half),
        found=fov.element_sides(length, near, depth, margin),
        thesis=fov.with_margin(sides, THESIS_MARGIN_RAD),
        lateral=fov.lateral_limit(
            marker.element_width_fraction * marker.aruco_m, marker.element_depth_m, LATERAL_SHARE
        ),
        half_base_m=half,
        margin_share=margin / length,
    )


#: Coordinate along the element and the sense in which its far end lies: 'x' for top and bottom.
_ALONG = {"top": ("x", -1.0), "right": ("y", -1.0), "bottom": ("x", 1.0), "left": ("y", 1.0)}


def element_slopes(name: str, pitch_rad: FloatArray, yaw_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes along an element, towards the far end of its opening, and across it."""
    x, y = fov.slopes(pitch_rad, yaw_rad)
    axis, sense = _ALONG[name]
    along, across = (x, y) if axis == "x" else (y, x)
    return sense * along, across


def seen(found: Limits, name: str, pitch_rad: FloatArray, yaw_rad: FloatArray) -> NDArray[np.bool_]:
    """Where an element's blob is found, by the closed form."""
    return fov.in_field(*element_slopes(name, pitch_rad, yaw_rad), found.found, found.lateral)


def in_ellipse(
    found: Limits, name: str, pitch_rad: FloatArray, yaw_rad: FloatArray, printed: bool
) -> NDArray[np.bool_]:
    """Where equation 5.20 sees an element's blob, with the thesis's limits.

    Angles along and across the element are pitch and yaw, as the thesis takes them. As printed the lateral semi-axis is the full
    lateral field; else half of it.
    """
    axis, sense = _ALONG[name]
    # Yaw turns x away from the camera: its sense is the opposite of the slope's.
    along = -sense * np.asarray(yaw_rad) if axis == "x" else sense * np.asarray(pitch_rad)
    across = np.asarray(pitch_rad) if axis == "x" else np.asarray(yaw_rad)
    side = np.where(along > 0, found.thesis.far, found.thesis.near)
    lateral = THESIS_LATERAL_RAD if printed else THESIS_LATERAL_RAD / 2
    return np.asarray(fov.ellipse(across, along, lateral, side) <= 1)
