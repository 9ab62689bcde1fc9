"""The closed form's estimate of the light in a whole frame."""

from __future__ import annotations

import numpy as np
import pytest

from experiments import chain
from experiments.scenario import load_scenario
from radiometry.geometry import FloatArray
from scenes.projection.frame_light import mean_frame_rate


def face_only(points_m: FloatArray, material: str) -> FloatArray:
    """One electron a second from the face, none from the marker."""
    return np.full(len(points_m), float(material == "white_paint"))


@pytest.mark.parametrize(("centre_m", "share"), [((0.0, 0.0), 1.0), ((0.1, 0.0), 0.5), ((0.2, 0.0), 0.0)])
def test_the_face_counts_where_it_stands(centre_m: tuple[float, float], share: float) -> None:
    """A face twice as wide as the frame, and as high, whose edge is moved to the frame's middle and to its side."""
    scenario = load_scenario().at(range_m=2.0)
    width_m = scenario.camera.width_px * 2.0 / scenario.camera.focal_px[0]
    target = {"face_material": "white_paint", "face_m": 2 * width_m}
    middle, moved = (
        chain.view(scenario.at(target=scenario.target.model_dump() | target | {"face_centre_m": at}))
        for at in ((0.0, 0.0), (centre_m[0] / 0.1 * width_m, 0.0))
    )
    assert mean_frame_rate(moved, face_only) == pytest.approx(share * mean_frame_rate(middle, face_only), abs=0.03)
