"""Ranges of the power study, and what the navigation sensor may draw."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import ValidationError

from experiments.scenario.errors import explain
from radiometry.power import PowerPlan


@dataclass(frozen=True)
class Plan:
    """What is walked through, and within which limit.

    Attributes:
        ranges_m: ranges [m].
        led_counts: LEDs that are on. The thesis has 100 and would switch some off at short range.
        limit_w: mean power that may be drawn [W].
        camera_w: what the camera draws [W].
        frame_rate_max: frames a second that the camera reads out.
        latency_s: features and pose of one frame on the chaser's processor [s].

    Raises:
        ValueError: one line that says what is wrong with the power.
    """

    ranges_m: tuple[float, ...]
    led_counts: tuple[int, ...] = (1, 10, 100)
    limit_w: float = PowerPlan().limit_w
    camera_w: float = PowerPlan().camera_w
    frame_rate_max: float = PowerPlan().frame_rate_max
    latency_s: float = PowerPlan().latency_s

    def __post_init__(self) -> None:
        """Refuse what leaves no power for the LEDs."""
        _ = self.power

    @property
    def power(self) -> PowerPlan:
        """The power that may be drawn, with driver, readout and processor."""
        try:
            return PowerPlan(
                limit_w=self.limit_w,
                camera_w=self.camera_w,
                frame_rate_max=self.frame_rate_max,
                latency_s=self.latency_s,
            )
        except ValidationError as error:
            raise ValueError(explain(error, PowerPlan)) from None


FULL = Plan(ranges_m=tuple(float(r) for r in range(1, 21)))
QUICK = Plan(ranges_m=(1.0, 5.0, 10.0, 20.0))
