"""How the pixels of a view gather their rays."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box
from scenes.render import image
from scenes.render.transport import Quality, View, render_basis
from scenes.target import Target

CAMERA = Camera(width_px=96, height_px=96)
VIEW = View(
    camera=CAMERA,
    marker=MarkerDesign(),
    target=Target(pitch_deg=12, yaw_deg=-9, roll_deg=20),
    leds=LedRing(count=12),
    sun=Sun(),
    range_m=2.6,
    nodes_nm=(850,),
)


def test_an_image_is_the_same_with_many_rays_everywhere(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mean over the image within its error over seeds, and no pixel off by more than five of its own."""
    few, many = [], []
    for seed in range(8):
        quality = Quality(frame_samples=0, seed=seed)
        few.append(render_basis(VIEW, quality).layers["led"][0])
        with monkeypatch.context() as patched:
            patched.setattr(image, "uniform_pixels", lambda _, box: np.zeros((box.height, box.width), bool))
            many.append(render_basis(VIEW, quality).layers["led"][0])
    box = marker_box(VIEW).within(marker_box(VIEW).grown(-6))
    there = (slice(None), slice(max(box.y0, 0), box.y1), slice(max(box.x0, 0), box.x1))
    ours, theirs = np.array(few, float)[there], np.array(many, float)[there]
    assert np.any(ours != theirs)
    error = np.sqrt((ours.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / 8)
    error = np.maximum(error, np.median(error))  # a pixel's own error, of eight seeds, may come out too small
    z = (ours.mean(axis=0) - theirs.mean(axis=0)) / error
    assert abs(z.mean()) < 5 / np.sqrt(z.size / 25)  # neighbours within the point spread share rays
    assert np.abs(z).max() < 6
