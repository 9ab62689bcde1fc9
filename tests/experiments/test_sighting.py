"""What is said of an image, as data and in words."""

from __future__ import annotations

import json

import numpy as np
import pytest

from detector.features import Features
from experiments import chain, sighting
from experiments.scenario import Scenario
from scenes.marker import ELEMENT_NAMES
from scenes.transport import TransportBasis

KEYS = {"detected", "id", "corners_px", "blobs_px", "virtual_points_px", "pose", "reason"}


@pytest.fixture(scope="module")
def seen(small: Scenario, small_basis: TransportBasis) -> chain.Sighting:
    rate = chain.electron_rate(small, small_basis, "sun")
    return chain.look(small, chain.take_frame(small, rate, "sun", 5e-7).dn)


def test_a_record_is_plain_data_of_the_documented_shape(small: Scenario, seen: chain.Sighting) -> None:
    record = sighting.as_record(seen)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert set(record) == KEYS
    assert record["detected"] is True
    assert record["id"] == small.marker.identity
    assert set(record["blobs_px"]) == set(ELEMENT_NAMES)
    assert set(record["virtual_points_px"]) <= set(small.marker.virtual_points_m)
    assert set(record["pose"]) == {"R", "t_m", "covariance", "ambiguous"}
    assert np.shape(record["pose"]["R"]) == (3, 3)
    assert np.shape(record["pose"]["covariance"]) == (6, 6)
    # The marker's top left corner first, then clockwise as seen; at no tilt that is the image's, too.
    expected = chain.view(small).to_image(small.marker.corners_m)
    assert np.abs(np.array(record["corners_px"]) - expected).max() < 0.5


def test_an_empty_image_is_recorded_with_a_reason(small: Scenario) -> None:
    record = sighting.as_record(chain.look(small, np.full((160, 160), 64, np.uint16)))
    assert set(record) == KEYS
    assert (record["detected"], record["id"], record["corners_px"], record["pose"]) == (False, None, None, None)
    assert record["blobs_px"] == dict.fromkeys(ELEMENT_NAMES)
    assert record["reason"]


def test_words_name_marker_position_and_tilt_or_the_reason(small: Scenario, seen: chain.Sighting) -> None:
    text = "\n".join(sighting.describe(seen))
    assert "Marker 0, corners" in text
    assert "Position" in text
    assert "Tilt" in text
    blind = chain.look(small, np.full((160, 160), 64, np.uint16))
    assert sighting.describe(blind) == [f"Not detected: {blind.features.reason}"]


def test_features_without_a_pose_say_so(seen: chain.Sighting) -> None:
    blind = chain.Sighting(seen.features, None)
    assert isinstance(seen.features, Features)
    record = sighting.as_record(blind)
    assert record["pose"] is None
    assert "no pose" in record["reason"]
    assert "No pose" in sighting.describe(blind)[-1]
