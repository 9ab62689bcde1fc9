"""Transport bases on disk: what is written comes back bit for bit, and what is no basis is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scenes.atomic import atomic_write
from scenes.files.exr import read_basis, read_channels, write_basis, write_channels
from scenes.render.transport import TransportBasis

NODES = (807, 833, 867, 893)


def basis(shape: tuple[int, int] = (5, 7), nodes: tuple[int, ...] = NODES) -> TransportBasis:
    rng = np.random.default_rng(2)
    layers = {light: rng.random((len(nodes), *shape), dtype=np.float32) for light in ("led", "sun")}
    return TransportBasis(nodes, layers, {"seed": 7.0, "scenario": '{"range_m": 2.0, "name": "Übung °"}'})


def refusal(path: Path) -> str:
    with pytest.raises(ValueError, match=path.name) as error:
        read_basis(path)
    message = str(error.value)
    assert "\n" not in message
    return message


def test_a_basis_comes_back_bit_for_bit_with_its_attributes(tmp_path: Path) -> None:
    written = basis()
    write_basis(written, tmp_path / "basis.exr")
    found = read_basis(tmp_path / "basis.exr")
    assert found.nodes_nm == written.nodes_nm
    assert set(found.layers) == {"led", "sun"}
    for light, images in written.layers.items():
        assert found.layers[light].dtype == np.float32
        assert np.array_equal(found.layers[light], images)
    assert found.attributes == written.attributes


images = arrays(np.float32, (2, 4, 3, 5), elements=st.floats(0, 3.0000000054977558e38, width=32))


@settings(deadline=None, derandomize=True, max_examples=30)
@given(images)
def test_every_finite_radiance_survives(tmp_path_factory: pytest.TempPathFactory, values: np.ndarray) -> None:
    """Float32 is stored as float32: denormals, large values and all."""
    path = tmp_path_factory.mktemp("exr") / "basis.exr"
    write_basis(TransportBasis(NODES, {"led": values[0], "sun": values[1]}), path)
    found = read_basis(path)
    assert np.array_equal(np.stack([found.layers["led"], found.layers["sun"]]), values)


def test_layers_are_named_by_light_and_wavelength_and_carry_their_units(tmp_path: Path) -> None:
    write_basis(basis(nodes=(850,)), tmp_path / "basis.exr")
    channels, attributes = read_channels(tmp_path / "basis.exr")
    assert set(channels) == {"led.nm0850", "sun.nm0850"}
    assert attributes["unit_led"] == "m-2"
    assert attributes["unit_sun"] == "sr-1"


def test_a_slice_of_a_larger_array_is_written_as_it_looks(tmp_path: Path) -> None:
    whole = basis((10, 14))
    part = TransportBasis(NODES, {light: images[:, 2:9:2, 3:12:3] for light, images in whole.layers.items()})
    write_basis(part, tmp_path / "part.exr")
    found = read_basis(tmp_path / "part.exr")
    assert all(np.array_equal(found.layers[light], part.layers[light]) for light in part.layers)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"absent\.exr: no such file"):
        read_basis(tmp_path / "absent.exr")


@pytest.mark.parametrize("content", [b"", b"not an image", b"\x76\x2f\x31\x01" + b"\x00" * 40, b"\x89PNG\r\n\x1a\n"])
def test_what_is_no_exr_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "odd.exr"
    path.write_bytes(content)
    assert "not a readable OpenEXR file" in refusal(path)


def test_a_file_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.exr"
    write_basis(basis((64, 64)), path)
    path.write_bytes(path.read_bytes()[:-2000])
    assert "not a readable OpenEXR file" in refusal(path)


def test_an_image_without_transport_layers_is_refused_with_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "photo.exr"
    write_channels({name: np.zeros((4, 4), np.float32) for name in "RGB"}, {}, path)
    message = refusal(path)
    assert "layers B, G, R" in message
    assert "expected led.nmNNNN and sun.nmNNNN" in message


def test_a_basis_without_one_of_its_lights_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "half.exr"
    write_channels({f"led.nm{node:04d}": np.zeros((4, 4), np.float32) for node in NODES}, {}, path)
    assert "sun.nmNNNN" in refusal(path)


def test_lights_at_different_wavelengths_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mixed.exr"
    image = np.zeros((4, 4), np.float32)
    write_channels({"led.nm0850": image, "sun.nm0851": image}, {}, path)
    assert "different wavelengths" in refusal(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-30])
@pytest.mark.parametrize("light", ["led", "sun"])
def test_a_layer_that_is_no_radiance_is_refused(tmp_path: Path, light: str, value: float) -> None:
    path = tmp_path / "bad.exr"
    damaged = basis()
    damaged.layers[light][2, 3, 4] = value
    write_basis(damaged, path)
    message = refusal(path)
    assert f"layer {light} holds NaN, infinite or negative radiance" in message
    assert {"led": "[m-2]", "sun": "[sr-1]"}[light] in message


# --- whole or not at all


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "data.txt"
    path.parent.mkdir()
    path.write_text("old", "utf-8")

    def failing() -> None:
        with atomic_write(path) as temporary:
            temporary.write_text("half of the n", "utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        failing()
    assert [p.name for p in path.parent.iterdir()] == ["data.txt"]
    assert path.read_text("utf-8") == "old"


def test_an_exr_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "basis.exr"
    with pytest.raises(Exception):  # noqa: B017, PT011 - the binding's own, of whatever type
        write_channels(
            {"led.nm0850": np.zeros((4, 4), np.float32), "sun.nm0850": np.zeros((5, 4), np.float32)}, {}, path
        )
    assert not list(tmp_path.iterdir())


def test_a_write_replaces_the_old_file_and_makes_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "data.png"
    for text in ("one", "two"):
        with atomic_write(path) as temporary:
            assert temporary.suffix == ".png"
            assert temporary.parent == path.parent
            temporary.write_text(text, "utf-8")
    assert path.read_text("utf-8") == "two"
    assert [p.name for p in path.parent.iterdir()] == ["data.png"]


def test_a_block_that_writes_nothing_is_an_error_and_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "data.txt"
    path.write_text("old", "utf-8")
    with pytest.raises(FileNotFoundError), atomic_write(path):
        pass
    assert path.read_text("utf-8") == "old"
