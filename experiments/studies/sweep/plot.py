"""Any slice of a results file as a figure."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from experiments.studies.sweep.dataset import read_dataset
from scenes.atomic import atomic_write

#: Axes whose values are positive and span this factor are logarithmic.
_LOGARITHMIC_FROM = 100.0
#: Line style and marker of the closed form and of the rendered frames, where both are drawn.
_PAIR = {"_analytic": ("-", ""), "_rendered": ("", "o")}
#: End of the names that hold the half width of a 95 % interval.
_INTERVAL = "_ci95"


def draw_slice(results: Path, x: str, y: str, hue: str | None, select: tuple[str, ...], out: Path) -> dict[str, Any]:
    """Draw variable `y` over dimension `x`, a line for each value of `hue`; other dimensions are fixed.

    Args:
        results: the dataset's file.
        hue: dimension that separates the lines; None draws one.
        out: the figure's file.
        x: a dimension, or a key of the points that were run side by side.
        y: a variable; one that is there both in closed form and rendered, say cnr, is drawn both ways: lines and points.
        select: ``dimension=value`` for dimensions that are neither; those left out are fixed at their first value.

    Returns:
        The dimensions that were fixed, and where.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no dataset, or has no such variable, dimension or value.
    """
    dataset = read_dataset(results)
    names = _variables(dataset, y)
    for option, name in (("--x", x), ("--hue", hue)):
        dims = dataset[names[0]].dims
        if name is not None and name not in dims and not (name in dataset.coords and dataset[name].dims == ("case",)):
            raise ValueError(f"{option} {name}: not a dimension of {names[0]}; it has {', '.join(map(str, dims))}")
    if not np.issubdtype(dataset[x].dtype, np.number) or not np.issubdtype(dataset[names[0]].dtype, np.number):
        raise ValueError(f"{x} and {y} must both be numbers to be drawn as an axis")
    kept = {dim for name in (x, hue) if name is not None for dim in dataset[name].dims}
    intervals = [name + _INTERVAL for name in names if len(names) > 1 and name + _INTERVAL in dataset]
    values, fixed = _fix(dataset[[*names, *intervals]], kept, select)

    from experiments.reporting.figures import new_figure, save_svg

    figure, [[axes]] = new_figure()
    for k, value in enumerate([None] if hue is None else dict.fromkeys(values[hue].values.tolist())):
        line = (values if value is None else _with_value(values, hue, value, x)).sortby(x)
        for name in names:
            label = f"{value}" if name == names[0] and hue is not None else None
            _draw(axes, line, x, name, colour=f"C{k}", label=label, paired=len(names) > 1)
    axes.set_xlabel(_label(dataset[x]))
    axes.set_ylabel(_label(dataset[names[0]], len(names) > 1))
    for axis, shown in ((axes.set_xscale, values[x]), (axes.set_yscale, values[names[0]])):
        if shown.min() > 0 and shown.max() > _LOGARITHMIC_FROM * shown.min():
            axis("log")
    title = ", ".join(f"{k} = {v}" for k, v in fixed.items())
    axes.set_title(
        "\n".join(textwrap.wrap(title + (". Lines: closed form; points: rendered" if len(names) > 1 else ""), 90))
    )
    if hue is not None:
        figure.legend(title="\n".join(textwrap.wrap(_label(dataset[hue]), 22)), loc="outside right upper")
    if out.suffix == ".svg":
        save_svg(figure, out)
    else:
        with atomic_write(out) as temporary:
            figure.savefig(temporary)
    return fixed


def _variables(dataset: xr.Dataset, y: str) -> list[str]:
    """Names of what is to be drawn: the variable itself, or its closed form and its rendered twin."""
    if y in dataset:
        return [y]
    pair = [y + end for end in _PAIR]
    if all(name in dataset for name in pair):
        return pair
    raise ValueError(f"--y {y}: no such variable; there are {', '.join(sorted(map(str, dataset.data_vars)))}")


def _with_value(values: xr.Dataset, hue: str | None, value: Any, x: str) -> xr.Dataset:
    """What has one value of the hue, along the dimension of `x` alone."""
    [dim] = values[hue].dims
    chosen = values.isel({dim: np.flatnonzero(values[hue].values == value)})
    if dim in values[x].dims:
        return chosen
    if chosen.sizes[dim] > 1:
        raise ValueError(
            f"--hue {hue}: several of the points run side by side have {value}; --hue {dim} tells them apart"
        )
    return chosen.squeeze(dim)


def _draw(axes: Any, line: xr.Dataset, x: str, name: str, *, colour: str, label: str | None, paired: bool) -> None:
    style, marker = _PAIR[name[name.rindex("_") :]] if paired else ("-", "o")
    if line[x].dims != (x,):  # points that also differ in other keys: no line joins them
        style, marker = "", "o" if marker or not paired else "_"
    axes.plot(line[x], line[name], color=colour, linestyle=style, marker=marker, label=label)
    if name + _INTERVAL in line:
        axes.errorbar(line[x], line[name], line[name + _INTERVAL], color=colour, linestyle="", linewidth=0.8)


def _fix(values: xr.Dataset, kept: set[Any], select: tuple[str, ...]) -> tuple[xr.Dataset, dict[str, Any]]:
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


def _label(array: xr.DataArray, short: bool = False) -> str:
    """Long name, up to its first comma where it is to be short, with the unit in brackets."""
    name, unit = str(array.attrs.get("long_name", array.name)), array.attrs.get("units")
    name = name.partition(",")[0] if short else textwrap.shorten(name, 70, placeholder=" …")
    return f"{name} [{unit}]" if unit and unit != "1" else name
