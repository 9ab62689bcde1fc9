"""Other fiducials in the marker's place: their meshes, and that the camera sees their points where geometry says."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from experiments import chain
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from scenes.marker import Mesh
from scenes.render.transport import Quality, render_basis
from scenes.tags import DotPlate, TagPlate, view_of

TAGS = [TagPlate(side_m=0.1), TagPlate(side_m=0.1, dictionary="APRILTAG_36h11", identity=3)]


def normals_and_areas(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    vertices, faces = mesh
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    return cross / area[:, None], area / 2


@pytest.mark.parametrize("tag", TAGS, ids=lambda tag: tag.dictionary)
def test_a_tag_is_its_bits_its_quiet_zone_and_a_rim(tag: TagPlate) -> None:
    cells = len(tag.bits)
    areas = {}
    for material, mesh in tag.meshes().items():
        normal, area = normals_and_areas(mesh)
        np.testing.assert_allclose(normal, np.tile([0.0, 0.0, 1.0], (len(normal), 1)), atol=1e-12)
        areas[material] = area.sum()
    bright = tag.bits.sum() + 4 * (cells + 1)
    assert areas["retro"] == pytest.approx(bright * tag.bit_m**2)
    assert areas["retro"] + areas["absorber"] == pytest.approx(tag.size_m**2)
    assert tag.size_m == pytest.approx((cells + 4) * tag.bit_m)


def test_dots_are_round_and_the_post_closes_the_gap_below_its_dot() -> None:
    plate = DotPlate(side_m=0.1)
    normal, area = normals_and_areas(plate.meshes()["retro"])
    assert normal[:, 2].min() > 0.999
    # 48 sides: sin(x)/x below the circle's area.
    assert area.sum() == pytest.approx(5 * np.pi * plate.dot_radius_m**2, rel=0.004)
    vertices, faces = plate.meshes()["absorber"]
    assert vertices[:, 2].max() == pytest.approx(plate.height_fraction * plate.side_m, abs=2e-5)
    normal, _ = normals_and_areas((vertices, faces))
    wall = np.abs(normal[:, 2]) < 0.5
    middle = vertices[faces[wall]].mean(axis=1)
    assert (np.sum(normal[wall] * middle, axis=1) > 0).all()


@pytest.fixture(scope="module")
def tilted(small: Scenario) -> Scenario:
    target = {**small.target.model_dump(), "pitch_deg": 25.0, "yaw_deg": -15.0}
    return small.at(target=target, render={**small.render.model_dump(), "marker_rays": 100_000})


def image_of(plate: TagPlate | DotPlate, scenario: Scenario) -> FloatArray:
    view = view_of(plate, chain.view(scenario))
    return chain.electron_rate(scenario, render_basis(view, Quality(0, 100_000)), "eclipse")


def test_a_rendered_tag_is_decoded_where_its_corners_are(tilted: Scenario) -> None:
    tag = TagPlate(side_m=0.15)
    rate = image_of(tag, tilted)
    eight = np.rint(255 * (rate / rate.max())).astype(np.uint8)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, identities, _ = detector.detectMarkers(eight)
    assert identities is not None
    assert int(identities.ravel()[0]) == tag.identity
    # Corners to the pixel, which the contours of a threshold give.
    truth = chain.view(tilted).to_image(tag.corners_m)
    assert np.linalg.norm(corners[0].reshape(4, 2) - truth, axis=1).max() < 1.5


def test_the_posts_dot_is_seen_above_the_plate(tilted: Scenario) -> None:
    plate = DotPlate(side_m=0.2)
    rate = image_of(plate, tilted)
    points = chain.view(tilted).to_image(plate.points_m)
    row, column = np.indices(rate.shape)
    radius = 0.8 * plate.dot_radius_m * tilted.camera.focal_px[0] / tilted.range_m
    for x, y in points:
        near = np.hypot(column - x, row - y) <= 1.5 * radius + 2
        light = rate * near
        centroid = np.array([(light * column).sum(), (light * row).sum()]) / light.sum()
        np.testing.assert_allclose(centroid, (x, y), atol=0.1)
    # Without its height the dot would stand several pixels elsewhere.
    flat = chain.view(tilted).to_image(plate.points_m * [1, 1, 0])
    assert np.linalg.norm(flat[4] - points[4]) > 3


def test_a_plate_takes_the_markers_place_and_nothing_else(small: Scenario) -> None:
    view, plate = chain.view(small), DotPlate()
    assert replace(view_of(plate, view), marker=view.marker) == view
