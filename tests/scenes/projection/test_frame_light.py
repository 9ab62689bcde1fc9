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


def test_a_frame_of_one_brightness_has_that_mean() -> None:
    """Face, tape and absorber alike, and a face that fills the frame: what the marker hides, it replaces.

    To 4 %: the face is sampled on a grid, and of the openings only the visible floors count as tape.
    """
    scenario = load_scenario().at(range_m=3.0)
    view = chain.view(scenario.at(target=scenario.target.model_dump() | {"face_m": 5.0}))
    assert mean_frame_rate(view, lambda points, name: np.full(len(points), 7.0)) == pytest.approx(7.0, rel=0.04)


def test_light_of_the_tape_goes_with_its_area_in_the_image() -> None:
    """Tape alone shines: twice as far, a quarter of the light, in the limit in which slits are seen alike."""
    near, far = (chain.view(load_scenario().at(range_m=r)) for r in (8.0, 16.0))
    light = [mean_frame_rate(v, lambda points, name: np.full(len(points), float("tape" in name))) for v in (near, far)]
    assert light[0] / light[1] == pytest.approx(4.0, rel=0.02)
