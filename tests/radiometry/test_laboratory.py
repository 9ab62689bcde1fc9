"""Lights of the laboratory: places of the clusters, and the lamp's spectrum and level."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import constants

from radiometry.laboratory import EFFICACY_LM_W, HalogenSpot, LedClusters, photopic, planck
from radiometry.sources import LedRing, am0_spectrum


def test_clusters_stand_around_their_places_on_the_ring() -> None:
    leds = LedClusters(count=9, clusters=3, ring_radius_m=0.09, cluster_radius_m=0.01)
    places = leds.positions_m().reshape(3, 3, 3)
    middles = places.mean(axis=1)
    assert np.linalg.norm(middles, axis=1) == pytest.approx(0.09)
    assert np.linalg.norm(places - middles[:, None], axis=-1) == pytest.approx(0.01)
    assert np.degrees(np.arctan2(middles[:, 1], middles[:, 0])) % 360 == pytest.approx([0, 120, 240])
    assert (places[..., 2] == 0).all()


def test_clusters_of_one_are_a_ring() -> None:
    ring = LedRing(count=5, ring_radius_m=0.05)
    assert LedClusters(count=5, clusters=5, ring_radius_m=0.05).positions_m() == pytest.approx(ring.positions_m())


def test_leds_that_do_not_fill_the_clusters_are_refused() -> None:
    with pytest.raises(ValidationError, match="10 LEDs, expected a multiple of clusters, 3"):
        LedClusters(count=10, clusters=3)


def test_planck_gives_stefan_and_boltzmanns_law_and_wiens() -> None:
    grid = np.geomspace(100, 1e6, 40_001)
    radiance = planck(grid, 3200.0)
    assert np.trapezoid(radiance, grid) == pytest.approx(constants.sigma * 3200**4 / np.pi, rel=1e-4)
    assert grid[np.argmax(radiance)] == pytest.approx(
        1e9 * constants.value("Wien wavelength displacement law constant") / 3200, rel=1e-3
    )


def test_photopic_fit_gives_the_definition_and_sunlights_known_level() -> None:
    assert photopic(555.0) == pytest.approx(1.0, abs=0.02)
    # The Sun outside the atmosphere: 133 klx (C. W. Allen, Astrophysical Quantities: 13.7 lm/cm² from older data).
    sun = am0_spectrum()
    assert EFFICACY_LM_W * np.trapezoid(sun.values * photopic(sun.wavelength_nm), sun.wavelength_nm) == pytest.approx(
        134e3, rel=0.03
    )


def test_lamp_has_the_level_that_a_light_meter_tells() -> None:
    spot = HalogenSpot(illuminance_lx=5000.0)
    light = spot.irradiance()
    assert EFFICACY_LM_W * np.trapezoid(
        light.values * photopic(light.wavelength_nm), light.wavelength_nm
    ) == pytest.approx(5000)
    warmer = HalogenSpot(illuminance_lx=5000.0, temperature_k=2800.0).irradiance()
    assert warmer(850.0) > light(850.0)  # redder, so more near infrared for the same eye
    assert np.tan(spot.angular_radius_rad) == pytest.approx(spot.lamp_radius_m / spot.lamp_distance_m)
