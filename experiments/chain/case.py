"""A case: a scenario in one illumination, with what several stages need worked out once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from experiments.chain.illumination import SOURCES, responsivity, source_spectra, sun_stray_rate
from experiments.chain.link_budget import Bits, FaceRates, LinkBudget, solve_exposure, solve_link_budget
from experiments.chain.view import view
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from scenes.view import View


@dataclass(frozen=True)
class Case:
    """A scenario in one illumination. What is asked for is worked out at the first time, and kept.

    Attributes:
        scenario: camera, lights, target and sensor.
        illumination: 'eclipse' or 'sunlit'.
    """

    scenario: Scenario
    illumination: str

    @classmethod
    def of(cls, scenario: Scenario) -> Case:
        """The case that the scenario itself names."""
        return cls(scenario, scenario.illumination)

    def __getstate__(self) -> dict[str, object]:
        """What another process needs: the parts are worked out again there, which is cheaper than sending them."""
        return {"scenario": self.scenario, "illumination": self.illumination}

    @cached_property
    def view(self) -> View:
        """Where the marker is seen."""
        return view(self.scenario)

    @cached_property
    def bright(self) -> Bits:
        """The reflective bits."""
        return Bits.of(self.view, self.scenario.marker.white_bit_centres_m())

    @cached_property
    def dark(self) -> Bits:
        """The absorbing cells beside them."""
        return Bits.of(self.view, self.scenario.marker.black_bit_centres_m())

    @cached_property
    def faces(self) -> FaceRates:
        """Closed-form electron rates of points on the face."""
        return FaceRates(self.view, responsivity(self.scenario), source_spectra(self.scenario))

    @cached_property
    def link_budget(self) -> LinkBudget:
        """The closed-form budget; veiling glare spreads the closed form's own estimate of the frame's light."""
        return solve_link_budget(self.scenario, self.faces, self.bright, self.dark, self.illumination)

    def link_budget_beside(self, rate: FloatArray) -> LinkBudget:
        """The closed-form budget, with the veil that a rendered frame's own mean rate (height, width) spreads."""
        if self.scenario.camera.veiling_glare == 0:
            return self.link_budget
        stray_rate = sun_stray_rate(self.scenario) if "sun" in SOURCES[self.illumination] else 0.0
        return self.link_budget_of(float(rate.mean()) - stray_rate)

    def link_budget_of(self, mean_rate: float) -> LinkBudget:
        """The closed-form budget where the whole frame's mean rate is known [e-/s]."""
        return solve_link_budget(
            self.scenario, self.faces, self.bright, self.dark, self.illumination, mean_rate=mean_rate
        )

    def exposure_s(self, exposure: float | str, rate: FloatArray | None = None) -> float:
        """An exposure in seconds; 'auto' is solved from the closed form, beside a rendered frame's rate where it is given.

        Raises:
            ValueError: for 'auto' where no bit is in the frame.
        """
        budget = self.link_budget if rate is None else self.link_budget_beside(rate)
        return solve_exposure(self.scenario, budget, exposure)


def link_budget(scenario: Scenario, illumination: str, mean_rate: float | None = None) -> LinkBudget:
    """The closed-form budget of the scenario's range in an illumination.

    Args:
        scenario: camera, lights, target and sensor.
        illumination: 'eclipse' or 'sunlit'.
        mean_rate: electrons per second and pixel of the whole imaged frame, without stray light from outside it, for veiling
            glare to spread; absent, the closed form's own estimate (`scenes.projection.frame_light`).
    """
    case = Case(scenario, illumination)
    return case.link_budget if mean_rate is None else case.link_budget_of(mean_rate)


def link_budget_beside(scenario: Scenario, illumination: str, rate: FloatArray) -> LinkBudget:
    """As `Case.link_budget_beside`."""
    return Case(scenario, illumination).link_budget_beside(rate)
