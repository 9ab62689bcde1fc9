"""Visible tape and the hidden face, against areas that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from radiometry.geometry import FloatArray
from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.visible import hidden_face, visible_tape
from scenes.target import Target
from scenes.view import View

RANGE_M = 5.0
VIEW = View(
    camera=Camera(),
    marker=MarkerDesign(),
    target=Target(),
    leds=LedRing(),
    sun=Sun(phase_deg=60.0, azimuth_deg=0.0),
    range_m=RANGE_M,
    nodes_nm=(850,),
)
PX2_PER_M2 = float(np.prod(VIEW.camera.focal_px)) / RANGE_M**2


def areas(polygons: FloatArray) -> FloatArray:
    """Shoelace areas of polygons (n, k, 2)."""
    x, y = polygons[..., 0], polygons[..., 1]
    return np.abs(np.sum(x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1), axis=-1)) / 2


def test_printed_tape_of_a_frontal_marker_covers_its_area_in_the_image() -> None:
    cells, shares = visible_tape(VIEW)
    rectangles = VIEW.marker.reflective_rectangles_m()
    printed = np.sum((rectangles[:, 1] - rectangles[:, 0]) * (rectangles[:, 3] - rectangles[:, 2]))
    assert areas(cells[: len(rectangles)]).sum() == pytest.approx(printed * PX2_PER_M2, rel=1e-9)
    np.testing.assert_array_equal(shares[: len(rectangles)], 1.0)


def test_the_slit_over_the_virtual_line_shows_all_of_its_opening() -> None:
    """From straight above the line that slit is not tilted; all others show less, and those further off show nothing."""
    cells, shares = visible_tape(VIEW)
    marker, top = VIEW.marker, VIEW.marker.elements[0]
    middles = VIEW.to_plane(cells.mean(axis=1))
    slits = np.arange(len(cells)) >= len(marker.reflective_rectangles_m())
    of_top = slits & (middles[:, 1] > 0) & (np.abs(middles[:, 0]) < top.length_m / 2)
    of_top &= np.abs(middles[:, 1] - top.centre_m[1]) < top.width_m / 2
    blob = float(top.blob_offset_m(VIEW.to_marker(np.zeros(3))))
    pitch = top.length_m / marker.slit_count
    best = middles[of_top, 0][np.argmax(shares[of_top])]
    assert best == pytest.approx(blob, abs=pitch / 2 * 1.001)
    assert shares[of_top].max() <= 1 - marker.slat_fraction + 1e-12
    assert of_top.sum() < marker.slit_count


def test_what_a_frontal_marker_hides_from_the_camera_is_its_front() -> None:
    outline = hidden_face(VIEW)["led"]
    assert areas(outline[None])[0] == pytest.approx(VIEW.marker.size_m**2 * PX2_PER_M2, rel=1e-9)


def test_the_suns_shadow_widens_what_is_hidden_on_its_far_side() -> None:
    """A Sun to the right throws the shadow to the left, by depth · tan(phase)."""
    outlines = hidden_face(VIEW)
    left = {light: outline[:, 0].min() for light, outline in outlines.items()}
    right = {light: outline[:, 0].max() for light, outline in outlines.items()}
    assert left["sun"] < left["led"]
    assert right["sun"] == pytest.approx(right["led"], abs=1e-9)
    for outline in outlines.values():
        assert len(ConvexHull(outline).vertices) == len(outline)


def test_a_sun_behind_the_face_throws_no_shadow() -> None:
    outlines = hidden_face(replace(VIEW, sun=Sun(phase_deg=120.0)))
    np.testing.assert_array_equal(outlines["sun"], outlines["led"])
