"""Errors of estimated poses, which of them are outliers, and how sure a rate is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from detector.pnp.epnp import BoolArray, Poses
from detector.pnp.pnp import geodesic_angles
from experiments.thesis.montecarlo.scenes import Scenes, angles
from radiometry.geometry import FloatArray

QUANTITIES = {"pitch": "deg", "yaw": "deg", "roll": "deg", "lateral": "m", "range": "m"}
Criterion = Literal["geodesic", "listing"]


@dataclass(frozen=True)
class Errors:
    """Errors of n poses, NaN without a pose: `attitude_rad` geodesic, `absolute` the five of `QUANTITIES` in their units."""

    attitude_rad: FloatArray
    absolute: dict[str, FloatArray]
    range_m: FloatArray

    @classmethod
    def of(cls, scenes: Scenes, poses: Poses) -> Errors:
        """Absolute errors of `poses` against the truth of `scenes`, angles wrapped to 180°."""
        rotation, translation = poses
        difference = angles(rotation, scenes.order) - scenes.angles_rad
        wrapped = np.rad2deg(np.abs((difference + np.pi) % (2 * np.pi) - np.pi))
        off = translation - scenes.translation_m
        lengths = {"lateral": np.hypot(off[:, 0], off[:, 1]), "range": np.abs(off[:, 2])}
        absolute = dict(zip(QUANTITIES, wrapped.T, strict=False)) | lengths
        return cls(geodesic_angles(scenes.rotation, rotation), absolute, scenes.range_m)

    @property
    def unsolved(self) -> BoolArray:
        """Scenes without a pose, (n,)."""
        return np.isnan(self.absolute["range"])

    def outliers(self, criterion: Criterion) -> BoolArray:
        """Wrong poses (n,), those without a pose among them.

        'geodesic': attitude off by more than 10°, or range by more than 5 %. 'listing': range off by more than itself, or
        the angle it calls roll by more than 60°; flips in the other two angles are no outliers there.
        """
        relative = self.absolute["range"] / self.range_m
        if criterion == "listing":
            return ~((relative <= 1) & (self.absolute["roll"] <= 60))
        return ~((self.attitude_rad <= np.deg2rad(10)) & (relative <= 0.05))

    def folded(self) -> Errors:
        """As the listing counts them: pitch and yaw errors beyond 170° become their distance from 180°."""
        fold = {k: np.where(self.absolute[k] > 170, 180 - self.absolute[k], self.absolute[k]) for k in ("pitch", "yaw")}
        return Errors(self.attitude_rad, self.absolute | fold, self.range_m)


def summary(errors: Errors, back: BoolArray, criterion: Criterion) -> dict[str, float]:
    """Counts, and mean and standard deviation of the absolute errors of all but the outliers."""
    out = errors.outliers(criterion)
    kept = errors.folded() if criterion == "listing" else errors
    found = errors.attitude_rad[~errors.unsolved]
    row = {
        "outliers": out.sum(),
        "outliers_back": (out & back).sum(),
        "wrong": errors.outliers("geodesic").sum(),
        "wrong_back": (errors.outliers("geodesic") & back).sum(),
        "unsolved": errors.unsolved.sum(),
        "median_attitude_deg": np.rad2deg(np.median(found)) if found.size else np.nan,
    }
    for name, values in kept.absolute.items():
        remaining = values[~out]
        row[f"mean_{name}"] = remaining.mean() if remaining.size else np.nan
        row[f"std_{name}"] = remaining.std(ddof=1) if remaining.size > 1 else np.nan
    return row
