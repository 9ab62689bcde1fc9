"""What the estimator is told: a belief, by type, and never anything that follows from the true pose."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import fields
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import detector.detect
from experiments import chain
from experiments.chain.shoot import shoot
from experiments.scenario import load_scenario

ROOT = Path(str(files("radiometry"))).parent
#: Calls by which a study hands an image to the detector.
ENTRANCES = {"detect", "detect_face"}


def handed_over() -> Iterator[tuple[str, str]]:
    """Where a module of the studies calls the detector, and what it hands over."""
    for room in ("chain", "studies", "thesis", "explore", "cli"):
        for path in sorted((ROOT / "experiments" / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ENTRANCES:
                    given = [*node.args, *(keyword.value for keyword in node.keywords)]
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", ", ".join(map(ast.unparse, given))


def test_a_belief_has_no_range_pose_sun_or_blur_of_a_range() -> None:
    assert {field.name for field in fields(chain.Belief)} == {"marker", "camera", "sensor", "led_ring_radius_m"}


def test_no_study_hands_the_detector_what_follows_from_the_view() -> None:
    """A view knows range and pose, and its camera holds the blur that follows from them."""
    calls = list(handed_over())
    assert len(calls) >= 10
    assert [call for call in calls if "view" in call[1] or "truth" in call[1].lower()] == []


def test_two_truths_with_one_belief_give_the_detector_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Range, tilt and Sun change the frame; all that reaches the detector beside it stays as it is."""
    told: list[tuple[object, ...]] = []

    def record(image, marker, camera, *, sensor, led_ring_radius_m, off):
        told.append((marker, camera, sensor, led_ring_radius_m, off))
        return detector.detect.Detection(blind, None)

    blind = detector.detect.detect(np.full((580, 752), 64, np.uint16), load_scenario().marker, load_scenario().camera)
    blind = blind.features
    monkeypatch.setattr(detector.detect, "detect", record)
    focus = "camera.focus_m=20.0"
    shoot(load_scenario(None, (focus, "range_m=9", "render.marker_rays=200000")))
    shoot(
        load_scenario(None, (focus, "range_m=6", "target.yaw_deg=12", "sun.phase_deg=80", "render.marker_rays=200000"))
    )
    assert told[0] == told[1]
    assert told[0][1].psf_sigma_px == load_scenario().camera.psf_sigma_px
