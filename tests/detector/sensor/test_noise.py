"""The noise model, given or estimated."""

from __future__ import annotations

import numpy as np
import pytest

from detector.sensor.noise import NoiseModel, estimate_noise


@pytest.mark.parametrize(
    "change",
    [{"gain_dn_per_electron": -1.0}, {"read_noise_dn": np.nan}, {"offset_dn": np.inf}, {"saturation_dn": 10.0}],
)
def test_refuses_an_impossible_noise_model(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        NoiseModel(**{"gain_dn_per_electron": 1.0, "read_noise_dn": 1.0, "offset_dn": 64.0, **change})


def test_the_estimated_noise_is_the_noise():
    rng = np.random.default_rng(18)
    assert estimate_noise(rng.normal(100, 3, (200, 200))).read_noise_dn == pytest.approx(3, rel=0.1)
    clipped = np.clip(rng.normal(100, 30, (200, 200)), 0, 120)
    assert estimate_noise(clipped).saturation_dn == 120


def test_a_plateau_with_noise_on_it_is_the_saturation_and_bright_unsaturated_pixels_are_none() -> None:
    rng = np.random.default_rng(19)
    electrons = np.full((100, 100), 50.0)
    electrons[20:60, 20:60] = 30_000.0
    for full_well, saturated in ((20_000.0, True), (1e9, False)):
        charge = np.minimum(rng.poisson(electrons), full_well)
        image = 16 * np.rint(64 + 0.1 * charge + 2 * rng.normal(size=charge.shape))
        found = estimate_noise(image.astype(np.uint16)).saturation_dn
        assert found == (pytest.approx(16 * 2064, abs=16) if saturated else np.inf)
