"""The result of a sweep as one labelled dataset, written whole or not at all, and read back."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments import chain
from experiments.chain.trials import VARIABLES
from experiments.reporting.files import write_netcdf
from experiments.scenario import describe
from experiments.studies.sweep.plan import Sweep
from experiments.studies.sweep.work import Record, software

#: Of each case, beside the variables of `experiments.chain.trials`.
OF_CASES = {
    "px_per_bit": ("pixel", "pixels along a bit's shorter side"),
    "renderer_variance_fraction": (
        "1",
        "largest variance of the renderer over that of shot noise, on ArUco and elements",
    ),
}
#: Of each noise draw.
OF_DRAWS = {
    "detected": ("1", "marker found"),
    "attitude_error_deg": ("degree", "geodesic attitude error"),
    "range_error": ("1", "range error over range"),
}
#: Rows and columns of the pose's covariance.
POSE_COMPONENTS = ("rotation_x", "rotation_y", "rotation_z", "translation_x", "translation_y", "translation_z")

ZARR = ".zarr"


def make_dataset(sweep: Sweep, records: Sequence[Record]) -> xr.Dataset:
    """Records of every case of a sweep, in its order, as a dataset whose dimensions are named after the keys.

    Points that are run side by side lie along the dimension ``case``, their keys are coordinates along it.
    """
    plan, beside = sweep.plan, sweep.plan.side_by_side()
    dims = (*plan.grid, *(("case",) if beside else ()))
    trials = sweep.scenarios[0].budget.trials
    data: dict[str, Any] = {}
    for name, (unit, long_name) in {**VARIABLES, **OF_CASES}.items():
        values = [record.get("values", {}).get(name, np.nan) for record in records]
        # The exposure that was used, beside the swept key of that name, which may be 'auto'.
        name = "exposure_used_s" if name == "exposure_s" else name
        data[name] = (dims, np.array(values, float).reshape(sweep.shape), {"units": unit, "long_name": long_name})
    for name, (unit, long_name) in OF_DRAWS.items():
        drawn = np.array([record.get(name, [np.nan] * trials) for record in records], float)
        attributes = {
            "units": unit,
            "long_name": f"{long_name}, by noise draw; missing where the case could not be computed",
        }
        if name != "detected":
            attributes["long_name"] = f"{long_name}, by noise draw; missing without a pose"
        data[name] = ((*dims, "trial"), drawn.reshape(*sweep.shape, trials), attributes)
    stated = np.array([record.get("pose_covariance", np.full((6, 6), np.nan)) for record in records], float)
    data["pose_covariance"] = (
        (*dims, "pose_row", "pose_column"),
        stated.reshape(*sweep.shape, 6, 6),
        {
            "units": "1",
            "long_name": "covariance of a pose as the solver states it, mean over the noise draws; "
            "rotation vector [radian] and translation [m] in the camera frame",
        },
    )
    reasons = np.array([record["reason"] for record in records], dtype=object).reshape(sweep.shape)
    data["reason"] = (dims, reasons.astype(str), {"long_name": "what is missing and why; empty where nothing is"})
    return xr.Dataset(data, _coordinates(sweep, beside, trials), _attributes(sweep))


def _coordinates(sweep: Sweep, beside: dict[str, list[Any]], trials: int) -> dict[str, Any]:
    components = {"long_name": "component of the pose"}
    return {
        **{key: (key, _axis(values), _about(key)) for key, values in sweep.plan.grid.items()},
        **{key: ("case", _axis(values), _about(key)) for key, values in beside.items()},
        "trial": ("trial", np.arange(trials), {"units": "1", "long_name": "noise draw"}),
        "pose_row": ("pose_row", list(POSE_COMPONENTS), components),
        "pose_column": ("pose_column", list(POSE_COMPONENTS), components),
    }


def _attributes(sweep: Sweep) -> dict[str, Any]:
    """Provenance: what gives the same bytes again. No date, for the same input then gives other bytes."""
    base = sweep.scenarios[0]
    known = chain.provenance(base)
    return {
        "Conventions": "CF-1.11",
        "title": base.title,
        "history": "mantis sweep",
        "source": f"{known['software']}, {known['versions']}",
        "software_hash": software(),
        "sweep": sweep.plan.model_dump_json(by_alias=True),
        "sweep_hash": sweep.digest(),
        "first_scenario": known["scenario"],
        "seed": known["seed"],
    }


def _axis(values: list[Any]) -> np.ndarray:
    """Coordinate values: numbers where all are numbers, else text."""
    if all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
        return np.array(values)
    return np.array([str(v) for v in values])


def _about(key: str) -> dict[str, str]:
    """Long name and unit of a scenario key, from its description."""
    text = describe(key.split("."))
    unit = text[text.rfind("[") + 1 : text.rfind("]")] if "]" in text else ""
    return {"long_name": text.rsplit("[", 1)[0].strip() or key, **({"units": unit} if unit else {})}


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write NetCDF, or Zarr where the name ends in .zarr, whole or not at all; on disk when this returns.

    Raises:
        ImportError: for Zarr when it is not installed.
        OSError: when it cannot be written.
    """
    if path.suffix != ZARR:
        write_netcdf(dataset, path)
        _flush(path)
        return
    try:
        import zarr  # noqa: F401
    except ImportError as error:
        raise ImportError(
            f"{path}: Zarr needs the extra 'cluster': pip install 'mantis-radiometry[cluster]'"
        ) from error
    path.parent.mkdir(parents=True, exist_ok=True)
    new, old = (path.with_name(f".{path.stem}.{secrets.token_hex(4)}{end}") for end in (ZARR, ".old"))
    try:
        dataset.to_zarr(new, mode="w-", zarr_format=2, consolidated=True)
        if path.exists():  # a folder cannot be replaced in one step, so the old one steps aside
            os.replace(path, old)
        os.replace(new, path)
        for file in path.rglob("*"):
            _flush(file)
    finally:
        shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _flush(path: Path) -> None:
    """Force a file or folder to disk, so that no power failure takes it away."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_dataset(path: Path) -> xr.Dataset:
    """A results file in memory.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no dataset.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        if path.suffix == ZARR:
            return xr.open_zarr(path).load()
        return xr.load_dataset(path, engine="h5netcdf")
    except Exception as error:  # the engines raise errors of many kinds for what is no dataset
        raise ValueError(f"{path}: not a NetCDF or Zarr dataset that can be read ({error})") from error
