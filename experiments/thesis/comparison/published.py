"""Markers that are not rendered: closed forms, and accuracies as published."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from experiments.scenario import Scenario
from radiometry.encoding import RAYLEIGH_MEDIAN, lens_deviation, slit_deviation
from radiometry.geometry import FloatArray


@dataclass(frozen=True)
class Published:
    """A marker that is not rendered; see `published.toml`.

    Attributes:
        name: what it is called.
        source: where its numbers come from.
        model: closed form of `radiometry.encoding`, 'lens' or 'slits'; empty where there is none.
        field_deg: field of a lens [deg].
        sigma_px: standard deviation of what is located in the image [px].
        per_axis: patterns for each axis.
        level_deg: accuracy as its authors state it, where there is no model [deg].
    """

    name: str
    source: str
    model: str = ""
    field_deg: float = 0.0
    sigma_px: float = 0.0
    per_axis: int = 1
    level_deg: float = 0.0

    def median_deg(self, tilt_deg: FloatArray, scenario: Scenario, size_px: float) -> FloatArray:
        """Median attitude error over tilt [deg], two axes alike, for an outer side in pixels; a level where there is no model."""
        if not self.model:
            return np.full(np.shape(tilt_deg), self.level_deg)
        marker = scenario.marker
        length = size_px * marker.element_length_m / marker.size_m
        tilt = np.radians(tilt_deg)
        if self.model == "lens":
            deviation = lens_deviation(tilt, np.radians(self.field_deg), length, self.sigma_px)
        else:
            deviation = slit_deviation(tilt, marker.virtual_depth_fraction * length, self.sigma_px)
        return np.degrees(RAYLEIGH_MEDIAN * deviation / np.sqrt(self.per_axis))


def published() -> tuple[Published, ...]:
    """Markers of the data file."""
    text = (files("experiments") / "thesis" / "comparison" / "published.toml").read_text(encoding="utf-8")
    return tuple(Published(**entry) for entry in tomllib.loads(text)["marker"])
