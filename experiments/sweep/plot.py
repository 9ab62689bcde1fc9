"""Any slice of a results file as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from scenes.atomic import atomic_write


def draw_slice(results: Path, x: str, y: str, hue: str | None, select: tuple[str, ...], out: Path) -> dict[str, Any]:
    """Draw variable `y` over dimension `x`, a line for each value of `hue`; other dimensions are fixed.

    Args:
        select: ``dimension=value`` for dimensions that are neither; those left out are fixed at their first value.

    Returns:
        The dimensions that were fixed, and where.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no dataset, or has no such variable, dimension or value.
    """
    if not results.is_file():
        raise FileNotFoundError(f"{results}: no such file")
    try:
        dataset = xr.load_dataset(results, engine="h5netcdf")
    except Exception as error:  # the engines raise errors of many kinds for what is no NetCDF file
        raise ValueError(f"{results}: not a NetCDF dataset that can be read ({error})") from error
    if y not in dataset:
        raise ValueError(f"--y {y}: no such variable; there are {', '.join(sorted(map(str, dataset.data_vars)))}")
    values = dataset[y]
    for option, name in (("--x", x), ("--hue", hue)):
        if name is not None and name not in values.dims:
            raise ValueError(f"{option} {name}: not a dimension of {y}; it has {', '.join(map(str, values.dims))}")
    if not np.issubdtype(dataset[x].dtype, np.number) or not np.issubdtype(values.dtype, np.number):
        raise ValueError(f"{x} and {y} must both be numbers to be drawn as an axis")
    values, fixed = _fix(values.sortby(x), {x, hue}, select)

    from experiments.figures import new_figure

    figure, [[axes]] = new_figure()
    lines = [(None, values)] if hue is None else [(v, values.sel({hue: v})) for v in values[hue].values]
    for value, line in lines:
        axes.plot(line[x], line.values, marker="o", label=None if value is None else f"{value}")
    axes.set_xlabel(_label(dataset[x]))
    axes.set_ylabel(_label(values))
    if fixed:
        axes.set_title(", ".join(f"{k} = {v}" for k, v in fixed.items()))
    if hue is not None:
        axes.legend(title=_label(dataset[hue]))
    with atomic_write(out) as temporary:
        figure.savefig(temporary)
    return fixed


def _fix(values: xr.DataArray, kept: set[str | None], select: tuple[str, ...]) -> tuple[xr.DataArray, dict[str, Any]]:
    """The slice at the selected, else first, value of every dimension that is not kept."""
    wanted = dict(part.partition("=")[::2] for part in select)
    free = [str(d) for d in values.dims if d not in kept]
    for name in wanted:
        if name not in free:
            raise ValueError(f"--select {name}: not a free dimension; free are {', '.join(free) or 'none'}")
    fixed: dict[str, Any] = {}
    for dim in free:
        options = values[dim].values
        chosen = options[0]
        if dim in wanted:
            matches = [o for o in options if str(o) == wanted[dim] or _same_number(o, wanted[dim])]
            if not matches:
                raise ValueError(f"--select {dim}={wanted[dim]}: not among {', '.join(map(str, options))}")
            chosen = matches[0]
        fixed[dim] = chosen.item() if hasattr(chosen, "item") else chosen
        values = values.sel({dim: chosen})
    return values, fixed


def _same_number(value: Any, text: str) -> bool:
    try:
        return bool(np.isclose(float(value), float(text)))
    except (TypeError, ValueError):
        return False


def _label(array: xr.DataArray) -> str:
    """Long name with the unit in brackets."""
    name, unit = array.attrs.get("long_name", array.name), array.attrs.get("units")
    return f"{name} [{unit}]" if unit and unit != "1" else str(name)
