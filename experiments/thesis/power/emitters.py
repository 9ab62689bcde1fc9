"""LEDs of the thesis's class and what they stand, from `leds.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

from radiometry.geometry import FloatArray
from radiometry.power import junction_rise_k, longest_pulse_s

#: Temperature of the board the LEDs are soldered to [°C]; assumption: the hot end of an electronics box.
BOARD_C = 60.0


@dataclass(frozen=True)
class Emitter:
    """One LED at the current it is used at, and its limits; units are in the names.

    `power_max_w` and `current_max_a` hold for continuous operation, `surge_a` for single pulses up to `surge_pulse_s`.
    """

    name: str
    source: str
    electrical_w: float
    light_w: float
    resistance_k_w: float
    junction_max_c: float
    power_max_w: float
    current_a: float
    current_max_a: float
    surge_a: float
    surge_pulse_s: float
    capacity_j_k: float

    @property
    def heat_w(self) -> float:
        """Power that stays in the chip while it is on [W]."""
        return self.electrical_w - self.light_w

    def rise_k(self, pulse_s: FloatArray, period_s: FloatArray) -> FloatArray:
        """Highest junction temperature above the board under a train of pulses [K]."""
        return junction_rise_k(self.heat_w, self.resistance_k_w, self.capacity_j_k, pulse_s, period_s)

    @property
    def steady_c(self) -> float:
        """Junction temperature when always on [°C]."""
        return BOARD_C + self.heat_w * self.resistance_k_w

    def overdrive(self, pulse_s: float) -> float:
        """Heat that a single pulse may put into the junction, over that of the current it is used at.

        Thermal only; the surge current binds first where it is smaller.
        """
        room = self.junction_max_c - BOARD_C
        return room / float(junction_rise_k(self.heat_w, self.resistance_k_w, self.capacity_j_k, pulse_s))

    def longest_pulse_s(self) -> float:
        """Single pulse that brings the junction to its limit [s]; infinite where none does."""
        room = self.junction_max_c - BOARD_C
        return longest_pulse_s(self.heat_w, self.resistance_k_w, self.capacity_j_k, room)


def emitters() -> tuple[Emitter, ...]:
    """Every LED of the data file."""
    data = tomllib.loads((files("experiments") / "thesis" / "power" / "leds.toml").read_text(encoding="utf-8"))
    chip = data["chip"]
    volume = chip["side_m"] ** 2 * chip["thickness_m"]
    capacity = volume * chip["density_kg_m3"] * chip["heat_j_kg_k"]
    return tuple(Emitter(**led, capacity_j_k=capacity) for led in data["led"])
