"""The page of `mantis materials`: what each material returns, whether more than it receives, and where its figures come from."""

from __future__ import annotations

from dataclasses import asdict, fields

from matplotlib.figure import Figure

from experiments.reporting.blocks import Block, Card, Cell, Code, Plot, Plots, Section, Table, Text, csv_text
from experiments.reporting.formatting import number
from experiments.reporting.page import Page
from experiments.studies.materials.figures import lobe_figure, spectrum_figure
from experiments.studies.materials.study import MaterialRow, MaterialsResult
from materials.goniometer import WAVELENGTH_NM

_LOBES = "BRDF of each material against observation angle at three entrance angles; dashed at the end of life."
_SPECTRA = "Albedo of each material at normal incidence from 700 to 1000 nm; dashed at the end of life."
#: A data file of a user's own.
EXAMPLE = """title = "My tape"
source = "goniometer of my laboratory"
date = "2026-11"
uncertainty = "5 percent"
assumption = false

[diffuse]
albedo = [[700, 0.30], [1000, 0.28]]   # one number, or [wavelength in nm, value]; held constant beyond the ends

[gloss]                                # optional: a GGX mirror
albedo = 0.04
ggx_alpha = 0.2

[retro]                                # optional: R_A in cd lx⁻¹ m⁻², a row for each entrance angle
observation_deg = [0.1, 0.2, 0.5, 1.0]
entrance_deg = [4.0, 30.0]
coefficient_cd_per_lx_m2 = [[800.0, 600.0, 300.0, 90.0], [400.0, 300.0, 150.0, 45.0]]
tail_exponent = 3.0                    # fall-off beyond the last observation angle, above 2
spectral_factor = 1.0                  # on the table, over wavelength

[end_of_life]                          # optional: factors on each lobe
retro = 0.5
source = "lamp ageing"
date = "2026-11"
uncertainty = "20 percent"
assumption = true"""


def page(result: MaterialsResult, command: str, named: bool = False) -> Page:
    """What each material returns, as table and figures, and where its figures come from.

    Args:
        result: of `study.run`.
        command: the command line that makes it again.
        named: whether the materials were asked for by name; their sources are then told first.
    """
    rows = result.rows
    brightest = max(rows, key=lambda row: row.albedo)
    most = brightest.albedo
    known = sum(not row.assumption for row in rows)
    return Page(
        study="materials",
        title=f"Materials at {WAVELENGTH_NM:g} nm",
        headline=f"No material returns more light than it receives: {number(most)} of it at most."
        if most <= 1
        else f"{brightest.short_name} returns {number(most)} times the light that it receives.",
        passed=most <= 1,
        command=command,
        sections=(
            Section("table", "What each returns", (_numbers(rows), *_figures(result))),
            Section("own", "A material of your own", _own(), wordy=True),
            Section("sources", "Where the figures come from", (_sources(rows),), wordy=True),
        ),
        findings=tuple(map(_source, rows)) if named else (),
        cards=(
            Card(
                "Energy", number(most), f"largest albedo, of {brightest.short_name}; 1 returns all light", (), most <= 1
            ),
            Card("Sources", f"{known} of {len(rows)}", "have no figure that is an assumption", (), None),
        ),
        about=(
            "Each material is the sum of up to three lobes, each a BRDF f in sr⁻¹ that is the same for the budget and for the "
            "renderer (materials/brdf.py): Lambertian; a GGX mirror; and retroreflection, a table of ASTM E810's "
            "R_A = f cosθ_i cosθ_o over observation and entrance angle. Each lobe is scaled by a spectrum.",
            "No material returns more light than arrives, at any angle and wavelength. One that would is refused when it is "
            "loaded, with the arithmetic: a top-hat lobe of 200 sr⁻¹, for one, can be at most 2.29° wide (half angle, f₀ π sin²θ "
            "≤ 1).",
            "A name that ends in _eol is the same material at the end of its life: each lobe times a factor.",
        ),
        limits=_limits(rows),
        extra={"wavelength_nm": WAVELENGTH_NM, "materials": [asdict(row) for row in rows]},
        files={"data/materials.csv": as_csv(rows)},
    )


def _limits(rows: tuple[MaterialRow, ...]) -> tuple[str, ...]:
    assumed = [row.short_name for row in rows if row.assumption]
    names = f"These materials have a figure that is an assumption: {', '.join(assumed)}." if assumed else ""
    return (
        names or "No material shown here has a figure that is an assumption.",
        "A spectrum is held constant beyond its first and last wavelength.",
        "Retroreflection depends on observation and entrance angle alone, not on how a tape is turned about its normal.",
    )


def _numbers(rows: tuple[MaterialRow, ...]) -> Table:
    return Table(
        ("material", "peak f [sr⁻¹]", "albedo 0°", "30°", "60°", "assumption", "what it is"),
        tuple(
            (
                Cell(row.short_name, style="left"),
                Cell(f"{row.peak_per_sr:.3g}", row.peak_per_sr),
                *(Cell(f"{a:.3f}", a, a <= 1) for a in (row.albedo_0, row.albedo_30, row.albedo_60)),
                Cell("yes" if row.assumption else "", style="flagged" if row.assumption else ""),
                Cell(row.title, style="left"),
            )
            for row in rows
        ),
        f"Materials at {WAVELENGTH_NM:g} nm",
        terminal=True,
    )


def _figures(result: MaterialsResult) -> tuple[Block, ...]:
    return (
        Text(
            (
                "Peak f is the largest BRDF at 5° entrance angle, from 0.05° observation angle on. Albedo is the "
                "directional-hemispherical reflectance at 0, 30 and 60° incidence. An assumption is a material some figure of "
                "which is one. The same rows with their sources are in data/materials.csv.",
            )
        ),
        _plot("lobes", lobe_figure(result.pairs), _LOBES),
        Text(
            (
                "The viewer moves away from the source through the normal, so that a mirror glints at twice the entrance angle. "
                "Lambertian lobes do not depend on the entrance angle: their lines lie on one another.",
            )
        ),
        _plot("spectra", spectrum_figure(result.pairs), _SPECTRA),
    )


def _plot(key: str, figure: Figure, caption: str) -> Plots:
    return Plots((Plot(key, figure, caption),), caption)


def _own() -> tuple[Block, ...]:
    return (
        Text(
            (
                'Give the path of a TOML file instead of a name: tape_material = "my_tape.toml" in a scenario, beside which the '
                "file is looked for, or --set target.tape_material=my_tape.toml. my_tape.toml_eol is its end of life. "
                "mantis materials my_tape.toml checks and plots it.",
            )
        ),
        Code(EXAMPLE),
    )


def _sources(rows: tuple[MaterialRow, ...]) -> Table:
    return Table(
        ("material", "source", "date", "uncertainty", "status"),
        tuple(
            (
                Cell(row.short_name),
                Cell(row.source),
                Cell(row.date),
                Cell(row.uncertainty),
                Cell("assumption" if row.assumption else "", style="flagged" if row.assumption else ""),
            )
            for row in rows
        ),
    )


def _source(row: MaterialRow) -> str:
    assumed = " (an assumption)" if row.assumption else ""
    return f"{row.short_name}{assumed}: {row.source} ({row.date}). Uncertainty: {row.uncertainty}."


def as_csv(rows: tuple[MaterialRow, ...]) -> str:
    """The rows as comma-separated values with a heading."""
    records = [asdict(row) for row in rows]
    return csv_text({field.name: [_six_digits(r[field.name]) for r in records] for field in fields(MaterialRow)})


def _six_digits(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value
