"""Result files: exact, labelled, and whole or absent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.reporting.files import read_image, write_netcdf, write_png, write_text
from scenes.files import exr


def dataset() -> xr.Dataset:
    return xr.Dataset(
        {
            "cnr": (
                ("range_m", "illumination"),
                np.array([[1.5, np.nan], [1e-30, 7e20]]),
                {"units": "1", "long_name": "contrast"},
            ),
            "closes": (("range_m", "illumination"), np.array([[True, False], [False, True]]), {"units": "1"}),
            "reason": (("range_m",), np.array(["", "no marker found"], object)),
        },
        {"range_m": ("range_m", [1.0, 2.0], {"units": "m"}), "illumination": ["eclipse", "sunlit"]},
        {"Conventions": "CF-1.11", "title": "Δ a test"},
    )


def test_a_dataset_comes_back_from_netcdf_as_it_was(tmp_path: Path) -> None:
    write_netcdf(dataset(), tmp_path / "new" / "results.nc")
    with xr.open_dataset(tmp_path / "new" / "results.nc") as read:
        xr.testing.assert_identical(read.load(), dataset())
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["results.nc"]


@pytest.mark.parametrize("largest", [255, 4095, 65535])
def test_png_keeps_every_number(tmp_path: Path, largest: int) -> None:
    kind = np.uint8 if largest == 255 else np.uint16
    image = np.random.default_rng(0).integers(0, largest, (37, 53), endpoint=True).astype(kind)
    image[0, :2] = 0, largest
    write_png(image, tmp_path / "frame.png")
    read = read_image(tmp_path / "frame.png")
    assert read.dtype == kind
    np.testing.assert_array_equal(read, image)


@pytest.mark.parametrize("suffix", ["tiff", "pgm", "png", "exr"])
def test_images_of_other_programs_keep_their_numbers(tmp_path: Path, suffix: str) -> None:
    image = np.arange(600, dtype=np.uint16).reshape(20, 30) * 100
    path = tmp_path / f"image.{suffix}"
    if suffix == "exr":
        exr.write_channels({"Y": image.astype(np.float32)}, {}, path)
    else:
        cv2.imwrite(str(path), image)
    np.testing.assert_array_equal(read_image(path), image)


def test_colour_becomes_luminance(tmp_path: Path) -> None:
    grey = np.arange(200, dtype=np.uint8).reshape(10, 20)
    cv2.imwrite(str(tmp_path / "colour.png"), cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    np.testing.assert_array_equal(read_image(tmp_path / "colour.png"), grey)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.binary(max_size=200), st.integers(0, 199), st.sampled_from(["png", "exr"]))
def test_no_damage_to_a_file_does_more_than_raise_a_value_error(
    tmp_path_factory: pytest.TempPathFactory, junk: bytes, at: int, suffix: str
) -> None:
    """Either the format does not notice the damage, and an image comes back, or one clear error names the file."""
    path = tmp_path_factory.mktemp("damage") / f"image.{suffix}"
    if suffix == "png":
        write_png(np.arange(1024, dtype=np.uint16).reshape(32, 32), path)
    else:
        exr.write_channels({"Y": np.ones((32, 32), np.float32)}, {}, path)
    data = path.read_bytes()
    path.write_bytes(data[:at] + junk + data[at + len(junk) :])
    outcome = ""
    try:
        outcome = f"{path}: {read_image(path).ndim} dimensions"
    except ValueError as error:
        outcome = str(error)
    assert str(path) in outcome


WRITERS: list[tuple[str, Callable[[Path], None]]] = [
    ("results.nc", lambda path: write_netcdf(dataset(), path)),
    ("frame.png", lambda path: write_png(np.zeros((8, 8), np.uint16), path)),
    ("report.html", lambda path: write_text("text", path)),
    ("basis.exr", lambda path: exr.write_channels({"Y": np.zeros((8, 8), np.float32)}, {}, path)),
]


@pytest.mark.parametrize(("name", "write"), WRITERS, ids=[name for name, _ in WRITERS])
def test_a_write_that_fails_at_the_end_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, write: Callable[[Path], None]
) -> None:
    (tmp_path / name).write_text("earlier result")
    monkeypatch.setattr(
        "scenes.atomic.os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device"))
    )
    with pytest.raises(OSError, match="No space"):
        write(tmp_path / name)
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {name: "earlier result"}


@pytest.mark.parametrize(("name", "write"), WRITERS, ids=[name for name, _ in WRITERS])
def test_a_folder_in_the_way_is_named(tmp_path: Path, name: str, write: Callable[[Path], None]) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(IsADirectoryError) as error:
        write(tmp_path / name)
    assert error.value.filename == str(tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == [name]
