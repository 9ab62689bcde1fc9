"""What is said of an image, as data and in words."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from detector.features import Features
from detector.sensor.noise import noise_of
from experiments import chain
from experiments.reporting import detection
from experiments.reporting.files import write_png
from experiments.scenario import Scenario
from scenes.marker import ELEMENT_NAMES
from scenes.render.transport import TransportBasis

KEYS = {
    "detected",
    "id",
    "corners_px",
    "blobs_px",
    "virtual_points_px",
    "pose",
    "blur_px",
    "blur_deviation_px",
    "reason",
}


@pytest.fixture(scope="module")
def seen(small: Scenario, small_basis: TransportBasis) -> chain.Detection:
    rate = chain.electron_rate(small, small_basis, "sunlit")
    return chain.detect(chain.Belief.of(small), chain.expose(small, rate, "sunlit", 5e-7).dn)


def test_a_record_is_plain_data_of_the_documented_shape(small: Scenario, seen: chain.Detection) -> None:
    record = detection.as_record(seen)
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
    record = detection.as_record(chain.detect(chain.Belief.of(small), np.full((160, 160), 64, np.uint16)))
    assert set(record) == KEYS
    assert (record["detected"], record["id"], record["corners_px"], record["pose"]) == (False, None, None, None)
    assert record["blobs_px"] == dict.fromkeys(ELEMENT_NAMES)
    assert record["reason"]


def test_words_name_marker_position_and_tilt_or_the_reason(small: Scenario, seen: chain.Detection) -> None:
    text = "\n".join(detection.describe(seen))
    assert "Marker 0, corners" in text
    assert "Position" in text
    assert "Tilt" in text
    blind = chain.detect(chain.Belief.of(small), np.full((160, 160), 64, np.uint16))
    assert detection.describe(blind) == [f"Not detected: {blind.features.reason}"]


def test_features_without_a_pose_say_so(seen: chain.Detection) -> None:
    blind = chain.Detection(seen.features, None)
    assert isinstance(seen.features, Features)
    record = detection.as_record(blind)
    assert record["pose"] is None
    assert "no pose" in record["reason"]
    assert "No pose" in detection.describe(blind)[-1]


@pytest.mark.parametrize("distorted", [False, True], ids=["ideal lens", "distorted lens"])
def test_an_on_off_pair_of_files_is_seen_as_its_difference(
    distorted: bool,
    small: Scenario,
    small_basis: TransportBasis,
    tmp_path: Path,
    mantis: Callable[..., tuple[int, str, str]],
) -> None:
    """With and without the noise known: frames in the sensor's numbers, and those stretched by some other camera."""
    lens = ("camera.k1=-0.05",) if distorted else ()
    camera = small.changed(*lens)
    bare = chain.electron_rate(small, small_basis, "sunlit") - chain.electron_rate(small, small_basis, "eclipse")
    rates = {"on": chain.electron_rate(small, small_basis, "sunlit"), "off": np.maximum(bare, 0.0)}
    frames = {name: chain.expose(small, rate, "sunlit", 5e-7, k).dn for k, (name, rate) in enumerate(rates.items())}
    seen = {}
    for kind, stretch in (("own", 1), ("stretched", 16)):
        images = {name: (frame * stretch).astype(np.uint16) for name, frame in frames.items()}
        for name, image in images.items():
            write_png(image, tmp_path / f"{name}.png")
        assert (noise_of(small.sensor, images["on"]) is None) == (kind == "stretched")
        overrides = [
            part
            for key in (*lens, "range_m=3", "camera.width_px=160", "camera.height_px=160")
            for part in ("--set", key)
        ]
        status, out, error = mantis("detect", tmp_path / "on.png", "--off", tmp_path / "off.png", "--json", *overrides)
        assert (status, error) == (0, "")
        seen[kind] = json.loads(out)
        expected = detection.as_record(chain.detect(chain.Belief.of(camera), images["on"], images["off"]))
        np.testing.assert_allclose(seen[kind]["corners_px"], expected["corners_px"], atol=1e-9)
        truth = chain.view(small).to_image(small.marker.corners_m)
        assert np.abs(np.array(seen[kind]["corners_px"]) - truth).max() < (0.5 if distorted else 0.05)
        assert not np.array_equal(
            seen[kind]["corners_px"],
            detection.as_record(chain.detect(chain.Belief.of(camera), images["on"]))["corners_px"],
        )
    np.testing.assert_allclose(seen["own"]["corners_px"], seen["stretched"]["corners_px"], atol=0.02)


def test_an_off_frame_of_another_kind_is_refused(small: Scenario) -> None:
    on = np.full((160, 160), 64, np.uint16)
    with pytest.raises(ValueError, match="off: 160×160 px of uint8; expected 160×160 px of uint16"):
        chain.detect(chain.Belief.of(small), on, on.astype(np.uint8))
