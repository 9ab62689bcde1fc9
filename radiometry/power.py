"""Power of a pulsed illuminator: frame rate, junction temperature of the LEDs, and motion of the target between frames.

Equation 6.10 of the thesis, P = P_LED · n · t · fps, is `link.frames_per_second` solved for the rate. This module adds what
the equation leaves out: the loss of the driver, the constant power of the camera, the pulse that a junction withstands, and
the motion of the target from one frame to the next.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, model_validator

from radiometry import link
from radiometry.geometry import FloatArray
from radiometry.parameters import Positive, PositiveFraction
from radiometry.sources import LedRing


class PowerPlan(BaseModel):
    """What the navigation sensor may draw, and what it draws beside its LEDs.

    Raises:
        ValueError: when the camera leaves nothing for the LEDs.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    limit_w: Positive = Field(5.0, description="mean power that may be drawn [W]; thesis section 6.2")
    driver_efficiency: PositiveFraction = Field(
        0.85, description="power into the LEDs over power into their driver; assumption: a switching current source"
    )
    camera_w: Annotated[float, Field(ge=0)] = Field(
        2.5, description="camera and its electronics, always [W]; assumption: a small monochrome space camera"
    )
    frame_rate_max: Positive = Field(
        7.18, description="frames a second that the camera reads out; thesis table 7.1, at full resolution"
    )
    latency_s: Annotated[float, Field(ge=0)] = Field(
        0.05, description="features and pose of one frame on the chaser's processor [s]; assumption"
    )

    @model_validator(mode="after")
    def _something_is_left(self) -> PowerPlan:
        if self.camera_w >= self.limit_w:
            raise ValueError(
                f"camera_w: {self.camera_w:g} W leaves nothing of limit_w, {self.limit_w:g} W, for the LEDs; expected less [W]"
            )
        return self

    def frame_rate_by_power(self, leds: LedRing, pulse_s: ArrayLike) -> FloatArray:
        """Frame rate that the power budget and the duty cycle of the LEDs allow [s⁻¹].

        Args:
            leds: the illuminator.
            pulse_s: pulse of one frame, any shape [s].
        """
        usable = self.driver_efficiency * (self.limit_w - self.camera_w)
        return link.frames_per_second(usable, leds.energy_per_frame_j(pulse_s), pulse_s, leds.duty_max)

    def frame_rate(self, leds: LedRing, pulse_s: ArrayLike) -> FloatArray:
        """Frame rate that power, duty cycle, readout of the camera and the processor allow [s⁻¹].

        Args:
            leds: the illuminator.
            pulse_s: pulse of one frame, any shape [s].
        """
        readout = min(self.frame_rate_max, 1 / self.latency_s if self.latency_s else np.inf)
        return np.minimum(self.frame_rate_by_power(leds, pulse_s), readout)


def junction_rise_k(
    heat_w: ArrayLike, resistance_k_w: float, capacity_j_k: float, pulse_s: ArrayLike, period_s: ArrayLike = np.inf
) -> FloatArray:
    """Highest junction temperature above the solder point under a train of equal pulses, in its steady state [K].

    One thermal node: ΔT = P R (1 − e^(−t/τ)) / (1 − e^(−T/τ)) with τ = R C. A single short pulse heats by P t / C, a long
    one by P R. With C of the chip alone the result is on the hot side, because the chip's carrier takes up heat, too.

    Args:
        heat_w: electrical power less light, while the LED is on [W].
        resistance_k_w: thermal resistance R from junction to solder point [K/W].
        capacity_j_k: heat capacity C of the heated part [J/K].
        pulse_s: time on, t [s].
        period_s: time T from pulse to pulse, at least as long as the pulse [s]; infinite for a single pulse.

    Raises:
        ValueError: when a period is shorter than its pulse.
    """
    pulse, period = np.asarray(pulse_s, float), np.asarray(period_s, float)
    if np.any(period < pulse):
        raise ValueError(f"period_s: {np.min(period):g} s, expected at least pulse_s, {np.max(pulse):g} s")
    constant = resistance_k_w * capacity_j_k
    heating = -np.expm1(-pulse / constant)
    return np.asarray(heat_w, float) * resistance_k_w * heating / -np.expm1(-period / constant)


def longest_pulse_s(heat_w: float, resistance_k_w: float, capacity_j_k: float, rise_k: float) -> float:
    """Length of a single pulse that heats the junction by a given rise [s]; infinite where no pulse does.

    The inverse of `junction_rise_k` for one pulse: t = −R C ln(1 − ΔT / (P R)).

    Args:
        heat_w: electrical power less light, while the LED is on [W].
        resistance_k_w: thermal resistance R from junction to solder point [K/W].
        capacity_j_k: heat capacity C of the heated part [J/K].
        rise_k: rise ΔT above the solder point [K].
    """
    share = rise_k / (heat_w * resistance_k_w)
    return float(-resistance_k_w * capacity_j_k * np.log1p(-share)) if share < 1 else float("inf")


def swing_px(focal_px: float, lever_m: float, range_m: ArrayLike, turn_rad: ArrayLike) -> FloatArray:
    """How far a marker moves across the image, at most, when the target turns [px].

    The marker sits at a lever arm r from the axis of rotation. It moves along the chord 2 r sin(φ/2), taken square to the
    line of sight and seen from the range.

    Args:
        focal_px: focal length [px].
        lever_m: lever arm r [m].
        range_m: distance of the marker [m].
        turn_rad: angle φ of the turn [rad]; broadcasts with the range.
    """
    chord = 2 * lever_m * np.sin(np.asarray(turn_rad, float) / 2)
    return focal_px * chord / np.asarray(range_m, float)


def turn_rate_deviation(attitude_rad: float, frame_rate: ArrayLike, seconds: float) -> FloatArray:
    """Standard deviation of a steady turn rate, from the attitudes of all frames within a time [rad/s].

    It is the slope of a least-squares line through N equally spaced, independent readings of standard deviation σ:
    σ √(12 / (N (N² − 1))) / Δt. It is infinite with fewer than two frames.

    Args:
        attitude_rad: standard deviation σ of one attitude [rad].
        frame_rate: frames per second, any shape [s⁻¹].
        seconds: the time [s].
    """
    rate = np.asarray(frame_rate, float)
    count = np.floor(rate * seconds) + 1
    with np.errstate(divide="ignore"):
        return attitude_rad * rate * np.sqrt(12 / (count * (count**2 - 1)))
