"""The labelled dataset of a sweep, as NetCDF and Zarr, and figures of it; the records are made up, nothing is rendered."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.chain.trials import VARIABLES
from experiments.studies.sweep.dataset import OF_CASES, POSE_COMPONENTS, make_dataset, read_dataset, write_dataset
from experiments.studies.sweep.plan import Sweep, load_sweep
from experiments.studies.sweep.plot import draw_slice

GRID = """
trials = 3
[grid]
range_m = [2, 5, 10]
exposure_s = [1e-6, 1e-5, "auto"]
"""
BESIDE = """
trials = 3
[grid]
range_m = [2, 5]
[list]
"leds.count" = [10, 20, 20]
illumination = ["eclipse", "eclipse", "sunlit"]
"""


def _sweep(folder: Path, text: str = GRID) -> Sweep:
    path = folder / "sweep.toml"
    path.write_text(text)
    return load_sweep(path)


def _dataset(sweep: Sweep) -> xr.Dataset:
    """Signals fall with range squared; the last case could not be computed."""
    records = []
    for k, scenario in enumerate(sweep.scenarios[:-1]):
        values = dict.fromkeys([*VARIABLES, *OF_CASES], 1e4 * scenario.leds.count / scenario.range_m**2)
        records.append(
            {
                "values": values,
                "detected": [1, 1, 0],
                "attitude_error_deg": [0.1, 0.2, np.nan],
                "range_error": [0.0, 1e-3, np.nan],
                "pose_covariance": (np.eye(6) * (k + 1)).tolist(),
                "reason": "no marker found (1 of 3 frames)",
            }
        )
    return make_dataset(sweep, [*records, {"reason": "MemoryError: none left"}])


@pytest.mark.parametrize("name", ["out.nc", "out.zarr"])
@pytest.mark.parametrize("text", [GRID, BESIDE])
def test_a_file_opens_in_one_line_with_all_that_was_put_in(tmp_path: Path, name: str, text: str) -> None:
    if name.endswith(".zarr"):
        pytest.importorskip("zarr")
    dataset, path = _dataset(_sweep(tmp_path, text)), tmp_path / name
    write_dataset(dataset, path)
    opened = xr.open_dataset(path, engine="zarr" if name.endswith(".zarr") else "h5netcdf").load()
    opened.close()
    xr.testing.assert_identical(opened, dataset)
    xr.testing.assert_identical(read_dataset(path), dataset)


def test_every_variable_and_coordinate_says_what_it_is(tmp_path: Path) -> None:
    """As the CF conventions want it: a long name throughout, a unit on what is a number, history and source on the whole."""
    dataset = _dataset(_sweep(tmp_path))
    for name, variable in dataset.variables.items():
        assert variable.attrs["long_name"], name
        assert np.issubdtype(variable.dtype, np.str_) or variable.attrs["units"], name
    assert dataset.range_m.attrs["units"] == "m"
    assert dataset.exposure_s.attrs["units"] == "s"
    assert {
        "Conventions",
        "title",
        "history",
        "source",
        "software_hash",
        "sweep",
        "sweep_hash",
        "first_scenario",
        "seed",
    } <= set(dataset.attrs)
    assert dataset.sel(pose_row="rotation_x", pose_column="rotation_x").pose_covariance.values.ravel()[:3].tolist() == [
        1,
        2,
        3,
    ]
    assert list(dataset.pose_row.values) == list(POSE_COMPONENTS)


def test_a_case_that_could_not_be_computed_is_missing_with_its_reason(tmp_path: Path) -> None:
    last = _dataset(_sweep(tmp_path)).isel(range_m=-1, exposure_s=-1)
    assert str(last.reason.values) == "MemoryError: none left"
    for name in ("snr_rendered", "detected", "pose_covariance"):
        assert np.isnan(last[name]).all()


@pytest.mark.parametrize("name", ["out.nc", "out.zarr"])
def test_the_same_records_give_the_same_bytes(tmp_path: Path, name: str) -> None:
    if name.endswith(".zarr"):
        pytest.importorskip("zarr")
    contents = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        write_dataset(_dataset(_sweep(folder)), folder / name)
        files = sorted(p for p in (folder / name, *(folder / name).rglob("*")) if p.is_file())
        contents.append([(p.relative_to(folder), p.read_bytes()) for p in files])
    assert contents[0] == contents[1]
    assert contents[0]


def test_a_zarr_folder_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zarr")
    first, second = (_dataset(_sweep(tmp_path, text)) for text in (GRID, BESIDE))
    path = tmp_path / "out.zarr"
    write_dataset(first, path)
    write_dataset(second, path)
    xr.testing.assert_identical(read_dataset(path), second)

    def fail(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(xr.Dataset, "to_zarr", fail)
        with pytest.raises(OSError, match="No space left"):
            write_dataset(first, path)
    xr.testing.assert_identical(read_dataset(path), second)
    assert sorted(os.listdir(tmp_path)) == ["out.zarr", "sweep.toml"]


def test_both_ways_of_a_quantity_are_drawn_as_lines_and_points(tmp_path: Path) -> None:
    write_dataset(_dataset(_sweep(tmp_path)), tmp_path / "out.nc")
    fixed = draw_slice(tmp_path / "out.nc", "range_m", "cnr", "exposure_s", (), tmp_path / "a.svg")
    assert fixed == {}
    drawn = (tmp_path / "a.svg").read_text()
    assert "Lines: closed form; points: rendered" in drawn
    draw_slice(tmp_path / "out.nc", "range_m", "cnr", "exposure_s", (), tmp_path / "b.svg")
    assert (tmp_path / "b.svg").read_text() == drawn


def test_points_run_side_by_side_are_drawn_over_one_of_their_keys(tmp_path: Path) -> None:
    write_dataset(_dataset(_sweep(tmp_path, BESIDE)), tmp_path / "out.nc")
    draw = lambda *arguments: draw_slice(tmp_path / "out.nc", *arguments, tmp_path / "a.svg")  # noqa: E731
    assert draw("leds.count", "cnr_analytic", "illumination", ("range_m=5",)) == {"range_m": 5}
    assert draw("leds.count", "cnr", "range_m", ()) == {}
    assert draw("range_m", "cnr_analytic", "case", ()) == {}
    assert draw("range_m", "detected_fraction", None, ("case=1",)) == {"case": 1}
    with pytest.raises(ValueError, match="several of the points run side by side have 20; --hue case tells them apart"):
        draw("range_m", "cnr_analytic", "leds.count", ())


def test_what_is_no_dataset_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.nc").write_bytes(b"no")
    (tmp_path / "b.zarr").mkdir()
    for name in ("a.nc", "b.zarr"):
        with pytest.raises(ValueError, match=f"{name}: not a NetCDF or Zarr dataset"):
            read_dataset(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"c\.nc: no such file"):
        read_dataset(tmp_path / "c.nc")
