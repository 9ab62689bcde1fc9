"""The transport cache renders once, notices damage, and keeps within its bounds."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from radiometry.optics import Camera
from radiometry.sources import Earth, LedRing, Sun
from scenes.files import cache
from scenes.marker import MarkerDesign
from scenes.render.transport import Quality, TransportBasis, View
from scenes.target import Target

CAMERA = Camera(width_px=48, height_px=40, focal_length_m=2e-3)
QUALITY = Quality(1, 10_000, 1)
ROOT = Path(__file__).parents[3]


def _view(range_m: float = 2.0, **changes) -> View:
    parts = {"camera": CAMERA, "marker": MarkerDesign(), "target": Target(), "leds": LedRing(), "sun": Sun()}
    return View(**{**parts, **changes}, range_m=range_m, nodes_nm=(807, 833, 867, 893))


@pytest.fixture
def fake_renderer(monkeypatch):
    """Counts renderings; the image depends on the range alone."""
    calls = []

    def render(cases: Iterable[tuple[View, Quality]]) -> Iterator[TransportBasis]:
        for view, _ in cases:
            calls.append(view.range_m)
            image = np.full((4, 40, 48), view.range_m, np.float32)
            layers = {"led": image, "sun": 2 * image}
            yield TransportBasis(
                view.nodes_nm, layers, {"rays": 4.0}, {light: i[0] / 100 for light, i in layers.items()}
            )

    monkeypatch.setattr(cache, "render_cases", render)
    monkeypatch.setattr("scenes.llvm.select_variant", lambda requested=None: "llvm_ad_spectral")
    return calls


NODES = (807, 833, 867, 893)


def view(
    camera: Camera, target: Target, earth: Earth | None = None, range_m: float = 2.0, marker: MarkerDesign | None = None
) -> View:
    sun = Sun(phase_deg=30.0, azimuth_deg=90.0)
    return View(
        camera=camera,
        marker=marker or MarkerDesign(),
        target=target,
        leds=LedRing(count=6),
        sun=sun,
        range_m=range_m,
        nodes_nm=NODES,
        earth=earth,
    )


SMALL = Camera(width_px=96, height_px=96)


def test_a_view_is_rendered_once_and_read_back_bit_for_bit(tmp_path, fake_renderer):
    store = cache.TransportCache(tmp_path)
    first = store.basis(_view(), QUALITY)
    again = cache.TransportCache(tmp_path)
    second = again.basis(_view(), QUALITY)
    assert fake_renderer == [2.0]
    assert (store.rendered, again.reused) == (1, 1)
    for light in first.layers:
        np.testing.assert_array_equal(first.layers[light], second.layers[light])
    assert second.attributes == first.attributes


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": CAMERA.model_copy(update={"f_number": 5.6})},
        {"camera": CAMERA.model_copy(update={"lens_transmission": 0.9})},
        {"leds": LedRing(intensity_w_sr=1.0)},
        {"leds": LedRing(centroid_nm=810, fwhm_nm=10, electrical_power_w=3)},
    ],
    ids=["aperture", "transmission", "power", "spectrum"],
)
def test_what_does_not_change_transport_shares_a_rendering(changes):
    assert cache.key(_view(**changes), QUALITY, "v") == cache.key(_view(), QUALITY, "v")


@pytest.mark.parametrize(
    "changes",
    [
        {"range_m": 2.5},
        {"camera": CAMERA.model_copy(update={"psf_sigma_px": 0.7})},
        {"marker": MarkerDesign(identity=3)},
        {"target": Target(pitch_deg=5)},
        {"target": Target(tape_material="tape_type_iii")},
        {"leds": LedRing(ring_radius_m=0.03)},
        {"sun": Sun(phase_deg=46)},
    ],
    ids=["range", "psf", "marker", "pose", "material", "ring", "sun"],
)
def test_what_changes_transport_is_rendered_anew(changes):
    assert cache.key(_view(**changes), QUALITY, "v") != cache.key(_view(), QUALITY, "v")


def test_quality_and_variant_are_part_of_the_key():
    keys = {
        cache.key(_view(), q, v) for q in (QUALITY, Quality(1, 10_000, 2), Quality(2, 10_000, 1)) for v in ("a", "b")
    }
    assert len(keys) == 6


@pytest.mark.parametrize("damage", ["truncated", "foreign", "altered"])
def test_a_damaged_file_is_found_out_and_rendered_again(tmp_path, fake_renderer, damage):
    store = cache.TransportCache(tmp_path)
    store.basis(_view(), QUALITY)
    [(path, _)] = store.entries()
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:-40])
    elif damage == "foreign":
        path.write_text("not an image")
    else:
        other = TransportBasis(
            (807, 833, 867, 893), {k: np.ones((4, 40, 48), np.float32) for k in ("led", "sun")}, {"checksum": "0"}
        )
        cache.write_basis(other, path)
    basis = store.basis(_view(), QUALITY)
    assert fake_renderer == [2.0, 2.0]
    assert basis.layers["led"][0, 0, 0] == 2.0
    assert cache.TransportCache(tmp_path).basis(_view(), QUALITY).layers["sun"][0, 0, 0] == 4.0
    assert len(fake_renderer) == 2


def test_the_least_recently_used_make_room(tmp_path, fake_renderer):
    store = cache.TransportCache(tmp_path)
    for r in (1.0, 2.0, 3.0):
        store.basis(_view(r), QUALITY)
    size = max(s for _, s in store.entries())
    store.basis(_view(1.0), QUALITY)  # used again, so 2 m is now the oldest
    small = cache.TransportCache(tmp_path, limit_bytes=3 * size)
    small.basis(_view(4.0), QUALITY)
    assert sum(s for _, s in small.entries()) <= 3 * size
    del fake_renderer[:]
    for r in (1.0, 3.0, 4.0):
        small.basis(_view(r), QUALITY)
    assert fake_renderer == []


def test_a_cache_that_cannot_be_written_still_gives_the_basis(tmp_path, fake_renderer):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    assert cache.TransportCache(blocked).basis(_view(), QUALITY).layers["led"].max() == 2.0


def test_clear_removes_everything(tmp_path, fake_renderer):
    store = cache.TransportCache(tmp_path)
    store.basis(_view(1.0), QUALITY)
    store.basis(_view(2.0), QUALITY)
    assert store.clear() == 2
    assert store.entries() == []


def test_what_killed_writers_left_behind_is_removed(tmp_path, fake_renderer):
    store = cache.TransportCache(tmp_path)
    old, young = tmp_path / ".abc.0123abcd.exr", tmp_path / ".def.0123abcd.exr"
    for path in (old, young):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    store.basis(_view(), QUALITY)
    assert not old.exists()
    assert young.exists()  # it may still be being written
    assert store.clear() == 1
    assert not young.exists()


def test_many_bases_come_in_order_from_cache_and_renderer(tmp_path, fake_renderer):
    store = cache.TransportCache(tmp_path)
    ranges = [2.0 + k / 10 for k in range(20)]
    list(store.bases((_view(r), QUALITY) for r in ranges[::3]))
    fake_renderer.clear()
    bases = list(store.bases((_view(r), QUALITY) for r in ranges))
    assert [basis.layers["led"][0, 0, 0] for basis in bases] == [np.float32(r) for r in ranges]
    assert fake_renderer == [r for k, r in enumerate(ranges) if k % 3]
    assert (store.rendered, store.reused) == (20, 7)


@pytest.mark.parametrize(
    ("changes", "anew"),
    [
        ({"vignetting": 0.3}, False),
        ({"veiling_glare": 0.1}, False),
        ({"point_source_transmittance": ((20.0, 1e-4), (40.0, 1e-5))}, False),
        ({"k1": -0.1}, True),
        ({"p2": 1e-3}, True),
        ({"psf_sigma_px": 0.7}, True),
    ],
)
def test_the_cache_renders_anew_what_changes_transport_alone(changes: dict[str, float], anew: bool) -> None:
    plain, changed = view(SMALL, Target()), view(SMALL.model_copy(update=changes), Target())
    assert (cache.key(plain, Quality(), "v") != cache.key(changed, Quality(), "v")) == anew


def test_the_cache_tells_earths_apart_by_place_not_by_albedo() -> None:
    keys = [
        cache.key(view(SMALL, Target(), earth), Quality(), "v")
        for earth in (None, Earth(), Earth(albedo=0.6), Earth(phase_deg=80.0), Earth(angular_radius_deg=60.0))
    ]
    assert keys[1] == keys[2]
    assert len(set(keys)) == 4


def module_file(module: str) -> Path | None:
    """A module's file relative to the project, or None where there is no such module."""
    path = Path(*module.split(".")).with_suffix(".py")
    return path if (ROOT / path).is_file() else None


def imported(path: Path) -> set[Path]:
    """Files of this project that a file imports, deferred imports included."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            inside = [module_file(f"{node.module}.{alias.name}") for alias in node.names]
            found |= {file for file in (*inside, module_file(node.module)) if file is not None}
    return found


def test_the_key_hashes_every_file_that_the_renderer_imports_and_no_other() -> None:
    """A file left out would serve stale renderings; a file that is gone would stop every rendering."""
    hashed = {Path(folder) / name for folder, names in cache._CODE.items() for name in names}
    assert all((ROOT / path).is_file() for path in hashed)
    reached, todo = set[Path](), [Path("scenes/render/batch.py")]
    while todo:
        path = todo.pop()
        if path not in reached:
            reached.add(path)
            todo.extend(imported(path))
    # They choose the variant, which is part of the key by its name.
    assert reached - hashed == {Path("scenes/llvm.py"), Path("scenes/atomic.py")}
    assert hashed <= reached
