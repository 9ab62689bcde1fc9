"""The methods that find the marker in the laboratory's frames: this project's and the thesis's, with elements and without."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from experiments.studies.shared.baseline import to_eight_bits
from experiments.studies.shared.trackers import (
    TrackerFrame,
    TrackerResult,
    aruco_thesis,
    detection,
    inner_aruco,
    mantis,
    of_detection,
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
#: The method that is given differences of frames with and without LEDs, and only those.
PAIR = "pair"


@dataclass(frozen=True)
class LabFrame(TrackerFrame):
    """A frame of the laboratory's camera, whose eight bits are the upper ones of its own scale."""

    @property
    def eight_bits(self) -> NDArray[np.uint8]:
        """The frame with its black level at 0 and its saturation at 255."""
        return to_eight_bits(self.image, self.noise.offset_dn, self.noise.saturation_dn)


def results(frame: LabFrame) -> Iterator[tuple[str, TrackerResult]]:
    """What every one of `METHODS` but `PAIR` makes of a single frame."""
    marker = cast(MarkerDesign, frame.design)
    found = detection(frame)
    yield "mantis", of_detection(found, marker)
    bare = replace(found.features, blobs_px=dict.fromkeys(ELEMENT_NAMES), blob_sigma_px={}, virtual_points_px={})
    yield "inner", replace(of_features(bare, marker, frame.camera), blobs=None)
    yield "thesis", thesis(frame)
    yield "thesis_inner", aruco_thesis(frame)
    yield "window_inner", inner_aruco(frame)


def of_pair(difference: LabFrame) -> TrackerResult:
    """What this project's detector makes of a difference."""
    return mantis(difference)
