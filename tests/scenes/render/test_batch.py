"""Many views rendered together are each what it is alone, and keep their memory to themselves."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.files.cache import checksum
from scenes.marker import MarkerDesign
from scenes.projection.regions import marker_box
from scenes.render import batch
from scenes.render.transport import Quality, TransportBasis, View, render_bases, render_basis, render_cases
from scenes.target import Target

NODES = (807, 833, 867, 893)
CAMERA = Camera(width_px=48, height_px=40)
VIEW = View(
    camera=CAMERA,
    marker=MarkerDesign(size_m=0.05),
    target=Target(pitch_deg=12, yaw_deg=-15),
    leds=LedRing(count=6),
    sun=Sun(),
    range_m=2.6,
    nodes_nm=NODES,
)
QUALITY = Quality(marker_rays=300_000)
#: Views that differ in everything that lanes carry, and two that need a scene or a kernel of their own.
VIEWS = [
    VIEW,
    replace(VIEW, range_m=4.0, leds=LedRing(count=9, ring_radius_m=0.08, half_angle_deg=20)),
    replace(VIEW, target=Target(pitch_deg=-20, roll_deg=50), sun=Sun(phase_deg=20, azimuth_deg=-70)),
    replace(VIEW, camera=Camera(width_px=40, height_px=40, focal_length_m=0.012, psf_sigma_px=0.7), range_m=1.4),
    replace(VIEW, camera=Camera(width_px=48, height_px=40, psf_sigma_px=2.0)),
    replace(VIEW, target=Target(pitch_deg=12, face_material="white_paint")),
    replace(VIEW, earth=Earth(phase_deg=120.0, azimuth_deg=30.0)),
    replace(VIEW, nodes_nm=(803, 815, *NODES, 895, 897)),
]


def assert_same(one: TransportBasis, other: TransportBasis) -> None:
    assert one.layers.keys() == other.layers.keys()
    for light in one.layers:
        assert np.array_equal(one.layers[light], other.layers[light])
        assert np.array_equal(one.noise[light], other.noise[light])
    assert one.attributes == other.attributes


@pytest.fixture(scope="module")
def alone(mi: ModuleType) -> list[TransportBasis]:
    return [render_basis(view, QUALITY) for view in VIEWS]


def test_a_view_renders_to_the_same_bits_whatever_is_rendered_beside_it(alone: list[TransportBasis]) -> None:
    together = list(render_bases(VIEWS, QUALITY))
    backwards = list(render_bases(VIEWS[::-1], QUALITY))[::-1]
    for one, two, three in zip(alone, together, backwards, strict=True):
        assert_same(one, two)
        assert_same(one, three)


def test_a_view_renders_to_the_same_bits_however_its_lanes_are_cut(
    alone: list[TransportBasis], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "LANES", 20_000)
    for one, other in zip(alone, render_bases(VIEWS, QUALITY), strict=True):
        assert_same(one, other)


def test_every_view_may_have_a_quality_of_its_own(mi: ModuleType) -> None:
    qualities = [Quality(1, 200_000, 1), Quality(2, 50_000, 2), Quality(1, 400_000, 3, electrons=1000.0)]
    cases = list(zip(VIEWS[:3], qualities, strict=True))
    for case, basis in zip(cases, render_cases(cases), strict=True):
        assert_same(basis, render_basis(*case))


def test_views_are_taken_as_they_are_needed(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a thousand views two launches' worth has been asked for when the first is handed over."""
    monkeypatch.setattr(batch, "LANES", 400_000)
    taken = []

    def views():
        for k in range(1000):
            taken.append(k)
            yield replace(VIEW, range_m=2.0 + k / 1000)

    list(islice(render_bases(views(), Quality(marker_rays=100_000)), 1))
    assert len(taken) < 40


def test_pixels_that_are_too_noisy_get_more_rays(mi: ModuleType) -> None:
    """The largest fraction meets the target, where few rays to begin with miss it, and only some pixels paid for it."""
    view = replace(VIEW, marker=MarkerDesign(size_m=0.1), camera=Camera(width_px=64, height_px=64), range_m=3.3)
    wanted = Quality()
    rounds = batch.ViewImage.more
    before = []

    def more(image: batch.ViewImage):
        before.append(image._statement())
        return rounds(image)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch.ViewImage, "more", more)
        basis = render_basis(view, wanted)
    first, last = before[0], basis.attributes
    parts = ("aruco", "blob", "slats")
    assert max(float(first[f"{part}_variance_fraction"]) for part in parts) > wanted.variance_fraction
    assert max(float(last[f"{part}_variance_fraction"]) for part in parts) <= wanted.variance_fraction
    grew = float(last["blob_rays_per_pixel"]) / float(first["blob_rays_per_pixel"])
    assert 1 < grew < 4


def test_a_marker_out_of_the_frame_leaves_the_face(mi: ModuleType) -> None:
    aside = replace(VIEW)
    object.__setattr__(aside, "translation_m", np.array([0.3, 0.0, 2.6]))
    basis = render_basis(aside, QUALITY)
    assert basis.layers["led"].min() > 0
    assert not basis.noise["led"].any()
    assert not any(name.endswith("fraction") for name in basis.attributes)


def test_a_target_that_fills_part_of_the_frame_costs_its_part(mi: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes of a view whose face is a tenth of the frame's area; beyond it all is black."""
    view = replace(VIEW, camera=Camera(width_px=400, height_px=400), target=Target(face_m=0.12), range_m=2.4)
    lanes = []
    launch = batch._launch

    def counted(jobs):
        lanes.append(sum(job.lanes for job in jobs if isinstance(job.tiles, batch.Box)))
        return launch(jobs)

    monkeypatch.setattr(batch, "_launch", counted)
    basis = render_basis(view, Quality(2, 10_000))
    side = 0.12 / 2.4 * max(view.camera.focal_px)
    assert sum(lanes) < 4 * (side + 40) ** 2 + 2 * 10_000
    assert not basis.layers["sun"][:, :50].any()


def test_without_frame_samples_the_surroundings_stay_dark(mi: ModuleType) -> None:
    view = replace(VIEW, camera=Camera(width_px=120, height_px=100))
    lit, dark = (render_basis(view, Quality(samples, 100_000)) for samples in (1, 0))
    box = marker_box(view)
    inner = (slice(box.y0 + 3, box.y1 - 3), slice(box.x0 + 3, box.x1 - 3))
    np.testing.assert_allclose(dark.layers["led"][0][inner], lit.layers["led"][0][inner], rtol=1e-6)
    assert not dark.layers["led"][:, : box.y0 - 3].any()
    assert lit.layers["led"][:, : box.y0 - 3].all()


def test_a_view_renders_to_the_same_bits_however_many_threads_blas_has(alone: list[TransportBasis]) -> None:
    """In a process with one thread for BLAS: no sum is left to threads to order."""
    code = (
        "import sys; sys.path[:0] = ['tests/scenes/render']\n"
        "from test_batch import QUALITY, VIEWS\n"
        "from scenes.files.cache import checksum\n"
        "from scenes.render.transport import render_bases\n"
        "print(*(checksum(basis) for basis in render_bases(VIEWS[:3], QUALITY)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.split() == [checksum(basis) for basis in alone[:3]]
