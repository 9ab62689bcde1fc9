"""What the estimator is told, apart from what is true (a verdict may rest on nothing else)."""

from __future__ import annotations

from dataclasses import dataclass

from detector.sensor.sensor import Sensor
from experiments.scenario import Scenario
from radiometry.optics import Camera
from scenes.marker import MarkerDesign


@dataclass(frozen=True)
class Belief:
    """What a flight computer knows: the marker as designed, camera and sensor as calibrated, the LED ring.

    It has no range, no pose, no Sun and no blur of a range, so that nothing computed from them can reach the detector.

    Attributes:
        marker: the design that is looked for.
        camera: as calibrated; its point spread is the lens's in focus, whatever the range.
        sensor: as calibrated.
        led_ring_radius_m: radius of the LED ring about the lens.
    """

    marker: MarkerDesign
    camera: Camera
    sensor: Sensor
    led_ring_radius_m: float

    @classmethod
    def of(cls, scenario: Scenario) -> Belief:
        """What is known of a scenario before a frame is taken."""
        return cls(scenario.marker, scenario.camera, scenario.sensor, scenario.leds.ring_radius_m)
