"""The materials: what each returns, at the beginning and at the end of its life, as table, figures and documentation page."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from io import StringIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from experiments.reporting.figures import BLACK, BLUE, GREEN, VERMILION, new_figure, save_svg
from experiments.reporting.files import write_text
from materials import library
from materials.goniometer import WAVELENGTH_NM, goniometer_scan
from materials.library import END_OF_LIFE, Material

ENTRANCES_DEG = (5.0, 30.0, 60.0)
_COLOURS = (BLUE, GREEN, VERMILION)
_OBSERVATION_DEG = np.unique(np.concatenate([np.geomspace(0.05, 90.0, 100), [10.0, 60.0]]))
_SPECTRUM_NM = np.arange(700.0, 1001.0, 10.0)
_COLUMNS = 3


@dataclass(frozen=True)
class MaterialRow:
    """One material at one end of its life.

    `peak_per_sr` is the largest f at 5° entrance over 0.05–90° observation angle; albedos are directional-hemispherical
    reflectances at 0, 30 and 60° incidence; all at 850 nm.
    """

    name: str
    title: str
    life: str
    peak_per_sr: float
    albedo_0: float
    albedo_30: float
    albedo_60: float
    assumption: bool
    source: str
    date: str
    uncertainty: str


def run(out_dir: Path | None = None, names: Sequence[str] = ()) -> list[MaterialRow]:
    """Tabulate the materials and, into a folder, write `materials.md`, `figures/materials-*.svg` and `data/materials.csv`.

    Args:
        out_dir: where the files go; None writes none. `docs` renews this project's own page.
        names: materials of the library, or paths of data files; none means the whole library.

    Raises:
        ValueError: when a material does not exist, its file is wrong, or it would return more light than it receives.
    """
    rows = [_row(library.load(name)) for name in names or library.available()]
    if out_dir is not None:
        pairs = fresh_and_worn([row.name for row in rows])
        write_text(as_csv(rows), out_dir / "data" / "materials.csv")
        save_svg(lobe_figure(pairs), out_dir / "figures" / "materials-lobes.svg")
        save_svg(spectrum_figure(pairs), out_dir / "figures" / "materials-spectra.svg")
        write_text(page(rows), out_dir / "materials.md")
    return rows


def _row(material: Material) -> MaterialRow:
    at_0, at_30, at_60 = (material.albedo(np.radians(angle), WAVELENGTH_NM) for angle in (0.0, 30.0, 60.0))
    return MaterialRow(
        name=material.name,
        title=material.title,
        life="end" if material.name.endswith(END_OF_LIFE) else "beginning",
        peak_per_sr=float(goniometer_scan(material, ENTRANCES_DEG[0], _OBSERVATION_DEG).max()),
        albedo_0=at_0,
        albedo_30=at_30,
        albedo_60=at_60,
        assumption=material.assumption,
        source=material.source,
        date=material.date,
        uncertainty=material.uncertainty,
    )


def fresh_and_worn(names: Sequence[str]) -> list[tuple[Material, Material | None]]:
    """Each material with its own end of life, where that was asked for too; one asked for alone stands alone."""
    pairs = []
    for name in names:
        if name.endswith(END_OF_LIFE) and name.removesuffix(END_OF_LIFE) in names:
            continue
        worn = name + END_OF_LIFE
        pairs.append((library.load(name), library.load(worn) if worn in names else None))
    return pairs


def lobe_figure(pairs: Sequence[tuple[Material, Material | None]]) -> Figure:
    """f against observation angle at three entrance angles, a panel each; dashed at the end of life."""
    figure, panels = _panels(len(pairs), "observation angle [°]", f"BRDF at {WAVELENGTH_NM:g} nm [1/sr]", share_y=True)
    for axes, (fresh, worn) in zip(panels, pairs, strict=False):
        for entrance, colour in zip(ENTRANCES_DEG, _COLOURS, strict=True):
            for material, style in ((fresh, "-"), (worn, "--")):
                if material is not None:
                    f = goniometer_scan(material, entrance, _OBSERVATION_DEG)
                    axes.loglog(_OBSERVATION_DEG, f, style, color=colour, linewidth=1.0)
        axes.set_title(_short(fresh.name), loc="left", fontweight="bold")
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
        axes.set_title(_short(fresh.name), loc="left", fontweight="bold")
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


def _short(name: str) -> str:
    """A path's last part."""
    return Path(name).name


def as_table(rows: Sequence[MaterialRow]) -> Table:
    """The rows for a terminal of 110 columns."""
    table = Table(
        title=f"Materials at {WAVELENGTH_NM:g} nm",
        caption="f peak: largest BRDF at 5° entrance from 0.05° observation angle on. Albedo: at 0, 30 and 60° incidence. "
        "a: some figure is an assumption. Names are those of target.face_material, tape_material and absorber_material.",
        title_style="bold", box=None, padding=(0, 1, 0, 0), pad_edge=False,
    )  # fmt: skip
    for heading in ("material", "f peak\n1/sr", "albedo\n0°", "\n30°", "\n60°", "\na"):
        table.add_column(heading, justify="left" if heading == "material" else "right", no_wrap=heading != "material")
    table.add_column("\nwhat it is")
    titles = {row.name: row.title for row in rows}
    for row in rows:
        albedos = (f"{a:.3f}" for a in (row.albedo_0, row.albedo_30, row.albedo_60))
        fresh_beside_it = row.life == "end" and row.name.removesuffix(END_OF_LIFE) in titles
        what = "  the same, end of life" if fresh_beside_it else row.title
        table.add_row(_short(row.name), f"{row.peak_per_sr:.3g}", *albedos, "a" if row.assumption else "", what)
    return table


def sources(rows: Sequence[MaterialRow]) -> list[str]:
    """Source, date and uncertainty of each material, a paragraph each."""
    return [
        f"{_short(r.name)}{', an assumption' if r.assumption else ''}: {r.source} ({r.date}). Uncertainty: {r.uncertainty}."
        for r in rows
    ]


def as_csv(rows: Sequence[MaterialRow]) -> str:
    """The rows as comma-separated values with a heading."""
    buffer = StringIO()
    writer = csv.DictWriter(buffer, [f.name for f in fields(MaterialRow)], lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(asdict(row) | {k: f"{v:.6g}" for k, v in asdict(row).items() if isinstance(v, float)})
    return buffer.getvalue()


def page(rows: Sequence[MaterialRow]) -> str:
    """The documentation page."""
    cells = [
        f"| `{_short(r.name)}` | {r.title}{' *' if r.assumption else ''} | {r.peak_per_sr:.3g} | {r.albedo_0:.3f} | "
        f"{r.albedo_30:.3f} | {r.albedo_60:.3f} |"
        for r in rows
    ]
    origins = [
        f"- **`{_short(r.name)}`**{' (assumption)' if r.assumption else ''}: {r.source}. *{r.date}; "
        f"uncertainty: {r.uncertainty}.*"
        for r in rows
    ]
    template = (files("experiments") / "studies" / "materials" / "page.md").read_text(encoding="utf-8")
    return template.format(table="\n".join(cells), sources="\n".join(origins))
