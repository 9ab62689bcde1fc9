"""Blobs of the encoding elements on synthetic frames of known geometry."""

from __future__ import annotations

import numpy as np
import pytest
from marker_frames import MARKER, MEDIUM, POSES, SMALL, blob_error, frame
from synthetic import NOISE, expose, pose_at

from detector.elements.slits import Slits
from detector.features import find_features
from radiometry.optics import Camera


@pytest.mark.parametrize("pose", POSES)
def test_blobs_are_unbiased(pose):
    # Eight sub-pixels a pixel, as elsewhere, would themselves move a blob by 0.03 px.
    mean = frame(pose, MEDIUM, samples=20)
    rng = np.random.default_rng(3)
    found = [find_features(expose(mean, rng), MARKER, MEDIUM, NOISE, light_ring_m=0.0) for _ in range(8)]
    seen = 0
    for element in MARKER.elements:
        errors = [blob_error(f, element, pose, MEDIUM) for f in found if f.blobs_px[element.name] is not None]
        if len(errors) == len(found):
            seen += 1
            assert abs(np.mean(errors)) < 0.03
            assert max(f.blob_sigma_px[element.name] for f in found) < 0.05
    assert seen >= 2


def test_a_blob_beyond_the_end_of_its_element_is_dropped_and_said_so():
    # Turned so that the camera sees top and bottom towards opposite ends: one of a pair leaves its opening.
    image = expose(frame((3.0, 0.0, 30.0, 0.0, (0.0, 0.0)), MEDIUM), np.random.default_rng(12))
    f = find_features(image, MARKER, MEDIUM, NOISE)
    missing = [name for name in ("top", "bottom") if f.blobs_px[name] is None]
    assert len(missing) == 1
    assert f"{missing[0]} blob: cut off" in (f.reason or "") or f"{missing[0]} blob: no light" in (f.reason or "")
    assert missing[0] not in f.blob_sigma_px
    assert not any(missing[0] in key for key in f.virtual_points_px)
    assert len(f.virtual_points_px) == 2


@pytest.mark.parametrize(("yaw", "cut"), [(-19.0, (0.05, 0.2)), (-23.0, (0.2, 0.3))])
def test_a_blob_that_is_cut_by_the_end_of_its_element_stays_in_place(yaw, cut):
    pose = (3.0, 4.0, yaw, 5.0, (0.2, -0.3))
    rotation, translation = pose_at(*pose, camera=MEDIUM)
    camera_m, element = -rotation.T @ translation, MARKER.elements[0]
    assert cut[0] < Slits(MARKER, element, camera_m).cut_fraction(float(element.blob_offset_m(camera_m))) < cut[1]
    rng = np.random.default_rng(20)
    found = [find_features(expose(frame(pose, MEDIUM), rng), MARKER, MEDIUM, NOISE, 0.0) for _ in range(12)]
    errors = np.array([blob_error(f, element, pose, MEDIUM) for f in found])
    assert abs(errors.mean()) < 0.02
    assert np.sqrt(np.mean(errors**2)) < 1.25 * np.mean([f.blob_sigma_px["top"] for f in found])


@pytest.mark.parametrize("ring_m", [0.04, 0.08])
def test_a_ring_of_leds_beside_the_lens_leaves_the_blobs_in_place(ring_m):
    """Where its radius is told, to 0.03 px; where not, to what is stated then."""
    pose = (1.5, 8.0, -5.0, 15.0, (0.3, 0.2))
    camera = Camera(width_px=300, height_px=300)
    mean = frame(pose, camera, samples=6, ring_radius_m=ring_m)
    image = expose(mean, np.random.default_rng(14))
    told = find_features(image, MARKER, camera, NOISE, light_ring_m=ring_m)
    untold = find_features(image, MARKER, camera, NOISE)
    for element in MARKER.elements:
        assert abs(blob_error(told, element, pose, camera)) < 0.03
        assert abs(blob_error(untold, element, pose, camera)) < 3 * untold.blob_sigma_px[element.name]
        assert untold.blob_sigma_px[element.name] > 2 * told.blob_sigma_px[element.name]


@pytest.mark.parametrize("peak", [3.0, 0.95])
def test_blobs_are_found_from_three_sigma_to_the_edge_of_saturation(peak):
    pose = (4.4, 5.0, -4.0, 0.0, (0.3, 0.2))
    white = peak * 28.2 / 0.5 if peak > 1 else peak * 32_600  # a blob is about half as bright as the ring at this size
    rng = np.random.default_rng(15)
    mean = frame(pose, SMALL, white=white, foil_level=0.0)
    found = [find_features(expose(mean, rng), MARKER, SMALL, NOISE) for _ in range(10)]
    assert all(f.detected for f in found)
    for element in MARKER.elements:
        errors = [blob_error(f, element, pose, SMALL) for f in found if f.blobs_px[element.name] is not None]
        assert len(errors) >= 8
        assert np.sqrt(np.mean(np.square(errors))) < (1.0 if peak > 1 else 0.1)


def test_the_field_of_view_is_covered_by_one_element_or_the_other():
    reach = np.array([[-30.0, "right"], [30.0, "left"]], dtype=object)
    for pitch, name in reach:
        mean = frame((3.0, float(pitch), 0.0, 0.0, (0.0, 0.0)), MEDIUM)
        f = find_features(expose(mean, np.random.default_rng(19)), MARKER, MEDIUM, NOISE)
        assert f.blobs_px[name] is not None
        assert f.virtual_points_px
