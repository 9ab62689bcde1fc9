"""The difference of an on/off pair, the noise that is told of it, and the marker in it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from synthetic import NOISE, electrons, expose, foil, pose_at

from detector.features import find_features
from detector.pose.pose import solve_pose
from detector.sensor.noise import NoiseModel
from detector.sensor.pair import difference, pair_noise
from radiometry.geometry import FloatArray, rotation_angle
from radiometry.optics import Camera
from scenes.marker import MarkerDesign

MARKER, CAMERA = MarkerDesign(), Camera(width_px=160, height_px=160)
POSE = (5.0, 15.0, -10.0, 30.0, (0.3, -0.4))


def pair(
    seed: int, noise: NoiseModel = NOISE, white: float = 4000.0, sun: float = 6000.0, led_foil: float = 0.2
) -> tuple[np.ndarray, np.ndarray]:
    """Frames with and without the LEDs under a Sun that paints crinkles brighter than the marker all over the scene."""
    rng = np.random.default_rng(seed)
    lit = electrons(MARKER, CAMERA, *pose_at(*POSE, camera=CAMERA), rng, white=white, foil_level=led_foil)
    glare = np.minimum(foil((CAMERA.height_px, CAMERA.width_px), sun, rng), 20_000.0)
    return expose(lit + glare, rng, noise), expose(glare, rng, noise)


def attitude_error_deg(image: FloatArray, noise: NoiseModel | None) -> float:
    """Of the pose from an image; infinite where the marker is not found."""
    pose = solve_pose(find_features(image, MARKER, CAMERA, noise, light_ring_m=0.0), MARKER, CAMERA)
    return (
        np.inf if pose is None else float(np.degrees(rotation_angle(pose.rotation, pose_at(*POSE, camera=CAMERA)[0])))
    )


@pytest.mark.parametrize("known", [True, False], ids=["known noise", "estimated noise"])
def test_a_marker_that_glare_hides_is_found_in_the_difference(known: bool) -> None:
    lost = 0
    for seed in range(8):
        on, off = pair(seed)
        lost += not np.isfinite(attitude_error_deg(on, NOISE))
        image, noise = difference(on, off, NOISE if known else pair_noise(on, off))
        assert attitude_error_deg(image, noise) < 1.0, seed
    assert lost >= 7


def test_the_noise_that_is_told_is_the_noise() -> None:
    """Chi-square over a flat pair: shot noise of the LEDs once, of the Sun twice, read noise twice."""
    rng = np.random.default_rng(1)
    on, off = expose(np.full((150, 150), 5000.0), rng), expose(np.full((150, 150), 3000.0), rng)
    image, noise = difference(on, off, NOISE)
    mean = 2000 * NOISE.gain_dn_per_electron
    told = noise.variance(np.full(image.shape, mean)).mean()
    assert told == pytest.approx(0.25 * (2000 + 2 * 3000) + 2 * NOISE.read_noise_dn**2, rel=0.01)
    low, high = stats.chi2.interval(0.9999, image.size - 1)
    assert low < (image.size - 1) * image.var() / told < high
    assert abs(image.mean() - mean) < 4 * np.sqrt(told / image.size)


@pytest.mark.parametrize("gain", [0.5, 0.02])
def test_gain_and_read_noise_are_estimated_from_the_pair(gain: float) -> None:
    """Within a quarter: the medians of twelve levels over two thousand pixels leave some 5 %, light that LEDs add the rest.

    Foil that the LEDs light is rough, too; it would count as noise.
    """
    camera = NoiseModel(gain, 14.1 * gain / 0.5 + 0.3, 64.0, 16383.0)
    for seed in range(4):
        found = pair_noise(*pair(seed, camera, led_foil=0.0))
        for electrons_ in (2000.0, 10_000.0):
            level = 64.0 + gain * electrons_
            assert float(found.variance(level)) == pytest.approx(float(camera.variance(level)), rel=0.25)


def test_clipped_pixels_of_either_frame_say_nothing() -> None:
    on, off = np.full((20, 20), 900, np.uint16), np.full((20, 20), 500, np.uint16)
    on[2, 3], off[10, 12] = 16383, 16383
    for motion, blind in ((None, {(2, 3), (10, 12)}), (np.array([1.0, 0.0]), {(2, 3), (10, 11)})):
        _, noise = difference(on, off, NOISE, motion)
        assert noise.extra_variance_dn2 is not None
        where = np.nonzero(np.isinf(noise.extra_variance_dn2))
        assert {(int(r), int(c)) for r, c in zip(*where, strict=True)} == blind


def test_an_off_frame_of_another_kind_is_refused() -> None:
    on = np.zeros((20, 30), np.uint16)
    for off in (np.zeros((20, 31), np.uint16), np.zeros((20, 30), np.uint8)):
        with pytest.raises(ValueError, match="expected 30×20 px of uint16"):
            difference(on, off, NOISE)
