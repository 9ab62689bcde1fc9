"""The record of a lane: what is packed is unpacked, and the samples of lanes lie where their lattice says."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.marker import MarkerDesign
from scenes.render.lanes import BLOCK, CHOICES, LaneRecord, Sample, Segment, fraction, pack, unpack
from scenes.target import Target
from scenes.view import View

VIEW = View(
    camera=Camera(width_px=64, height_px=48, k1=-0.11, k2=0.02, p1=1e-3, p2=-2e-3, k3=0.003),
    marker=MarkerDesign(),
    target=Target(pitch_deg=12.0, yaw_deg=-25.0, roll_deg=40.0),
    leds=LedRing(count=9),
    sun=Sun(phase_deg=50.0),
    range_m=2.5,
    nodes_nm=(850,),
    earth=Earth(phase_deg=70.0, angular_radius_deg=60.0),
)


def segment(view: View = VIEW, count: int = 48, generator: int = 13) -> Segment:
    rng = np.random.default_rng(1)
    return Segment(view, count, generator, rng.random(2), rng.random(CHOICES))


def unpacked(mi: ModuleType, segments: list[Segment], index: int) -> LaneRecord:
    table = mi.Float(np.concatenate([pack(s, 100 + k) for k, s in enumerate(segments)]))
    return unpack(table, mi.UInt32([index]))


def numbers(values: Any) -> np.ndarray:
    return np.array(values, float).ravel()


@pytest.mark.parametrize("index", [0, 1])
def test_every_field_comes_back_as_it_was_packed(mi: ModuleType, index: int) -> None:
    """In single precision, of the first record of a table and of the one after it."""
    other = replace(VIEW, camera=Camera(focal_length_m=0.03), leds=LedRing(count=5), range_m=4.0, earth=None)
    segments = [segment(), segment(other, 16, 5)]
    record, packed = unpacked(mi, segments, index), segments[index]
    view, camera = packed.view, packed.view.camera
    expected = {
        "origin": view.to_marker(np.zeros(3)) * 1e3,
        "axes": view.rotation.ravel(),
        "tangent_per_px": 1 / np.array(camera.focal_px),
        "principal_point_px": camera.principal_point_px,
        "count": packed.count,
        "generator": packed.generator,
        "shift": packed.shift,
        "offsets": packed.offsets,
        "first_led": 100 + index,
        "led_count": view.leds.count,
        "led_exponent": view.leds.exponent,
        "to_sun": view.sun_in_marker,
        "sun_tangent": np.tan(view.sun.angular_radius_rad),
        "to_earth": view.earth_in_marker if view.earth else np.zeros(3),
        "earth_radius_rad": view.earth.angular_radius_rad if view.earth else 0.0,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(numbers(getattr(record, name)), numbers(value), rtol=1e-6, atol=1e-6, err_msg=name)
    for name in ("k1", "k2", "p1", "p2", "k3"):
        assert float(getattr(record.distortion, name)[0]) == pytest.approx(getattr(camera, name), rel=1e-6)
    assert {*expected, "distortion"} == set(LaneRecord.__dataclass_fields__)


def samples(mi: ModuleType, packed: Segment, pixel: tuple[int, int], lanes: int) -> Sample:
    """Samples of the first lanes of a pixel."""
    import drjit as dr

    lane = dr.arange(mi.UInt32, lanes)
    first = (lane >> 4) * BLOCK
    block = mi.Vector4i(0, pixel[0], pixel[1], mi.Int32(first))
    return Sample.of(lane, block, unpack(mi.Float(pack(packed, 0)), mi.UInt32(0)))


def test_the_samples_of_a_pixel_are_its_lattice(mi: ModuleType) -> None:
    packed, (column, row) = segment(), (40, 11)
    x, y = samples(mi, packed, (column, row), packed.count).position()
    (fx, fy), (cx, cy) = VIEW.camera.focal_px, VIEW.camera.principal_point_px
    middle = np.array([column - cx, row - cy])
    expected = (middle + packed.positions) / (fx, fy)
    np.testing.assert_allclose(np.column_stack([np.array(x), np.array(y)]), expected, atol=2e-6 / fx * 64)


def test_lanes_beyond_a_pixels_last_ray_go_on_in_the_next_column(mi: ModuleType) -> None:
    sample = samples(mi, segment(count=4, generator=1), (7, 3), BLOCK)
    np.testing.assert_array_equal(np.array(sample.column), np.repeat([7, 8, 9, 10], 4))
    np.testing.assert_array_equal(np.array(sample.index), np.tile(np.arange(4), 4))


def test_choices_of_light_step_evenly_through_the_unit_interval(mi: ModuleType) -> None:
    """From ray to ray, column to column and row to row each choice moves by a step of its own, from the segment's offset on."""
    packed = segment()
    here, right, below = (samples(mi, packed, pixel, packed.count) for pixel in ((5, 6), (6, 6), (5, 7)))
    start = samples(mi, packed, (0, 0), packed.count)
    steps = set()
    for k in range(CHOICES):
        chosen = numbers(here.choice(k))
        assert chosen.min() >= 0
        assert chosen.max() < 1
        moves = [np.diff(chosen) % 1.0, *((numbers(other.choice(k)) - chosen) % 1.0 for other in (right, below))]
        for move in moves:
            np.testing.assert_allclose(move, move[0], atol=2e-7)
        assert numbers(start.choice(k))[0] == pytest.approx(packed.offsets[k], abs=2e-7)
        steps.add(tuple(round(float(move[0]), 4) for move in moves))
    assert len(steps) == CHOICES


def test_the_fractional_part_lies_in_the_unit_interval(mi: ModuleType) -> None:
    np.testing.assert_allclose(np.array(fraction(mi.Float([2.25, -0.25, 3.0]))), [0.25, 0.75, 0.0])
