"""What shines on a scenario's target, and how the camera answers."""

from __future__ import annotations

import numpy as np

from experiments.scenario import Scenario
from radiometry import stray
from radiometry.optics import electron_responsivity
from radiometry.spectrum import Spectrum

#: Which lights shine in each illumination.
SOURCES = {"eclipse": ("led",), "sunlit": ("led", "sun")}


def active_sources(scenario: Scenario, illumination: str) -> tuple[str, ...]:
    """Lights that shine in an illumination; the sunlit Earth with the Sun, where the scenario has one."""
    return (
        (*SOURCES[illumination], "earth")
        if illumination == "sunlit" and scenario.earth is not None
        else SOURCES[illumination]
    )


def source_spectra(scenario: Scenario) -> dict[str, Spectrum]:
    """Spectral strength of each light.

    Returns:
        The LED ring's intensity [W sr⁻¹ nm⁻¹], the Sun's irradiance [W m⁻² nm⁻¹] and, where there is one, the Earth's
        radiance [W m⁻² sr⁻¹ nm⁻¹].
    """
    earth = {} if scenario.earth is None else {"earth": scenario.earth.radiance(scenario.sun)}
    return {"led": scenario.leds.spectral_intensity(), "sun": scenario.sun.irradiance(), **earth}


def responsivity(scenario: Scenario, incidence_rad: float = 0.0) -> Spectrum:
    """Electron rate per spectral radiance of the scenario's camera, filter and sensor, at a field angle before the lens."""
    transmission = scenario.filter.spectrum(incidence_rad)
    return electron_responsivity(scenario.camera, transmission, scenario.sensor.qe_spectrum())


def sun_stray_rate(scenario: Scenario) -> float:
    """Electrons per second that a Sun outside the field adds to every pixel; its angle from the axis is π − phase."""
    angle = np.pi - np.radians(scenario.sun.phase_deg)
    quantum_efficiency = scenario.sensor.qe_spectrum()
    return stray.stray_rate(
        scenario.camera, angle, scenario.sun.irradiance(), scenario.filter.spectrum(), quantum_efficiency
    )
