"""Files appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenes.atomic import atomic_write


def test_a_file_appears_when_the_block_succeeds_in_a_folder_that_is_made(tmp_path: Path) -> None:
    path = tmp_path / "new" / "picture.png"
    with atomic_write(path) as temporary:
        assert temporary.suffix == ".png"
        assert temporary.parent == path.parent
        temporary.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert list(path.parent.iterdir()) == [path]


def write_half(path: Path) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text("half")
        raise KeyError("stopped")


def test_a_block_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")
    with pytest.raises(KeyError, match="stopped"):
        write_half(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_in_the_way_is_named(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as error, atomic_write(tmp_path):
        pass
    assert error.value.filename == str(tmp_path)


def test_an_error_of_writing_names_the_file_that_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "data.nc"
    with pytest.raises(OSError, match="No space left") as error, atomic_write(path) as temporary:
        raise OSError(28, "No space left on device", str(temporary))
    assert error.value.filename == str(path)
