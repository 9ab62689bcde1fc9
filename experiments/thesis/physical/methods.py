"""What looks at the laboratory's frames: this project's detector and the thesis's pipeline, each with and without elements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from detector.features import Features, find_features
from experiments.studies.shared.baseline import to_eight_bits
from experiments.studies.shared.trackers import (
    TrackerFrame,
    TrackerResult,
    aruco_thesis,
    inner_aruco,
    of_features,
    thesis,
)
from scenes.marker import ELEMENT_NAMES, MarkerDesign

#: Methods by name, and what they are called.
METHODS = {
    "mantis": "Mantis, this project",
    "inner": "its inner ArUco alone, this project",
    "thesis": "Mantis, thesis's pipeline",
    "thesis_inner": "its inner ArUco alone, thesis",
    "window_inner": "its inner ArUco alone, window-refined",
    "pair": "Mantis, LEDs on less LEDs off, this project",
}
#: What looks at differences of frames with and without LEDs, and only at them.
PAIR = "pair"


@dataclass(frozen=True)
class LabShot(TrackerFrame):
    """A frame of the laboratory's camera, whose eight bits are the upper ones of its own scale."""

    @property
    def eight_bits(self) -> NDArray[np.uint8]:
        """The frame with its black level at 0 and its saturation at 255."""
        return to_eight_bits(self.image, self.noise.offset_dn, self.noise.saturation_dn)


def sights(shot: LabShot) -> Iterator[tuple[str, TrackerResult]]:
    """What every one of `METHODS` makes of a single frame."""
    marker, camera = cast(MarkerDesign, shot.design), shot.camera
    features = _features(shot)
    yield "mantis", of_features(features, marker, camera)
    bare = replace(features, blobs_px=dict.fromkeys(ELEMENT_NAMES), blob_sigma_px={}, virtual_points_px={})
    yield "inner", replace(of_features(bare, marker, camera), blobs=None)
    yield "thesis", thesis(shot)
    yield "thesis_inner", aruco_thesis(shot)
    yield "window_inner", inner_aruco(shot)


def of_pair(shot: LabShot) -> TrackerResult:
    """What this project's detector makes of a difference."""
    return of_features(_features(shot), cast(MarkerDesign, shot.design), shot.camera)


def _features(shot: LabShot) -> Features:
    return find_features(shot.image, cast(MarkerDesign, shot.design), shot.camera, shot.noise, shot.light_ring_m)
