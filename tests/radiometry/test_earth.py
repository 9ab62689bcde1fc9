"""Light of the Earth's disc on a plane, against view factors in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray


def _direction(polar_deg: float, azimuth_deg: float) -> FloatArray:
    polar, azimuth = np.radians([polar_deg, azimuth_deg])
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def _lambert(normal: FloatArray, to_source: FloatArray, to_viewer: FloatArray, wavelength: FloatArray) -> FloatArray:
    return np.full(np.broadcast_shapes(to_source.shape[:-1], wavelength.shape), 0.5 / np.pi)


@pytest.mark.parametrize(
    ("radius_deg", "earth_deg", "viewer_deg"), [(70, 0, 0), (70, 15, 60), (30, 50, 20), (85, 0, 70), (10, 70, 70)]
)
def test_light_of_the_earth_on_a_lambert_plane_is_its_view_factor(
    radius_deg: float, earth_deg: float, viewer_deg: float
) -> None:
    """Albedo · sin²(radius) · cos(earth) where the whole disc stands above the horizon."""
    seen = earth_transport(
        _direction(viewer_deg, 20.0), _direction(earth_deg, 70.0), np.radians(radius_deg), _lambert, np.array([850.0])
    )
    exact = 0.5 * np.sin(np.radians(radius_deg)) ** 2 * np.cos(np.radians(earth_deg))
    np.testing.assert_allclose(seen, exact, rtol=3e-4)


def test_half_an_earth_on_the_horizon_lights_a_plane_by_its_upper_half() -> None:
    """View factor of a half disc of radius ρ centred on the horizon: (ρ − sin ρ cos ρ)/π."""
    radius = np.radians(70.0)
    seen = earth_transport(_direction(30.0, 0.0), _direction(90.0, 0.0), radius, _lambert, np.array([850.0]))
    np.testing.assert_allclose(seen, 0.5 * (radius - np.sin(radius) * np.cos(radius)) / np.pi, rtol=3e-3)
