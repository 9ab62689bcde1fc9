"""Figures of the materials: lobes and spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.reporting.figures import BLACK, BLUE, GREEN, VERMILION, new_figure
from experiments.studies.materials.study import ENTRANCES_DEG, OBSERVATION_DEG
from materials.goniometer import WAVELENGTH_NM, goniometer_scan
from materials.library import Material

_COLOURS = (BLUE, GREEN, VERMILION)
_SPECTRUM_NM = np.arange(700.0, 1001.0, 10.0)
_COLUMNS = 3


def lobe_figure(pairs: Sequence[tuple[Material, Material | None]]) -> Figure:
    """F against observation angle at three entrance angles, a panel each; dashed at the end of life."""
    figure, panels = _panels(len(pairs), "observation angle [°]", f"BRDF at {WAVELENGTH_NM:g} nm [1/sr]", share_y=True)
    for axes, (fresh, worn) in zip(panels, pairs, strict=False):
        for entrance, colour in zip(ENTRANCES_DEG, _COLOURS, strict=True):
            for material, style in ((fresh, "-"), (worn, "--")):
                if material is not None:
                    f = goniometer_scan(material, entrance, OBSERVATION_DEG)
                    axes.loglog(OBSERVATION_DEG, f, style, color=colour, linewidth=1.0)
        axes.set_title(Path(fresh.name).name, loc="left", fontweight="bold")
        axes.set_xticks([0.1, 1, 10, 90], ["0.1", "1", "10", "90"])
        axes.minorticks_off()
    for entrance, colour in zip(ENTRANCES_DEG, _COLOURS, strict=True):
        panels[0].plot([], [], color=colour, label=f"entrance angle {entrance:g}°")
    return _finish(figure, panels[0])


def spectrum_figure(pairs: Sequence[tuple[Material, Material | None]]) -> Figure:
    """Albedo against wavelength at normal incidence, a panel each; dashed at the end of life."""
    figure, panels = _panels(len(pairs), "wavelength [nm]", "albedo at normal incidence [–]", share_y=False)
    for axes, (fresh, worn) in zip(panels, pairs, strict=False):
        for material, style in ((fresh, "-"), (worn, "--")):
            if material is not None:
                shares = material.lobe_albedos(0.0)
                spectra = (material.diffuse, material.gloss, material.retro)
                albedo = sum(s(_SPECTRUM_NM) * a for s, a in zip(spectra, shares, strict=True))
                axes.plot(_SPECTRUM_NM, albedo, style, color=BLUE, linewidth=1.0)
        axes.set_title(Path(fresh.name).name, loc="left", fontweight="bold")
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])
    return _finish(figure, panels[0])


def _panels(count: int, x_label: str, y_label: str, *, share_y: bool) -> tuple[Figure, list[Axes]]:
    columns = min(count, _COLUMNS)
    rows = -(-count // columns)
    size = (2.5 * columns + 0.4, 1.7 * rows + 0.8)
    figure, grid = new_figure(rows, columns, size, sharex=True, sharey=share_y)
    figure.supxlabel(x_label, fontsize=9)
    figure.supylabel(y_label, fontsize=9)
    panels = list(grid.flat)
    for axes in panels[count:]:
        axes.remove()
    # The lowest of each column has labels, also where the last row is not full.
    for axes in panels[max(0, count - columns) : count]:
        axes.tick_params(labelbottom=True)
    return figure, panels[:count]


def _finish(figure: Figure, first: Axes) -> Figure:
    first.plot([], [], "-", color=BLACK, label="beginning of life")
    first.plot([], [], "--", color=BLACK, label="end of life")
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    return figure
