"""Hot, dead and listed pixels."""

from __future__ import annotations

import numpy as np

from detector.sensor.defects import isolated, mended, without
from detector.sensor.noise import NoiseModel

NOISE = NoiseModel(0.5, 3.0, 64.0)


def test_a_pixel_that_stands_alone_is_a_defect_and_a_spot_of_light_is_none() -> None:
    image = np.random.default_rng(0).normal(100, 3, (60, 60))
    image[10, 20] = 4000
    image[0, 5] = 4000
    v, u = np.mgrid[:60, :60]
    image += 3000 * np.exp(-0.5 * ((u - 40) ** 2 + (v - 40) ** 2) / 0.6**2)
    for kind in (np.uint16, np.float64):
        assert np.argwhere(isolated(image.astype(kind), NOISE)).tolist() == [[0, 5], [10, 20]]


def test_bad_pixels_are_filled_from_good_ones_and_say_nothing() -> None:
    image = np.tile(np.arange(20, dtype=np.uint16) * 10, (20, 1))
    bad = np.zeros(image.shape, bool)
    bad[:, 7] = True
    broken = np.where(bad, 60_000, image).astype(np.uint16)
    assert np.abs(mended(broken, bad).astype(int) - image).max() <= 1
    extra = without(NOISE, bad).extra_variance_dn2
    assert extra is not None
    assert np.isinf(extra[:, 7]).all()
    assert not extra[:, :7].any()
