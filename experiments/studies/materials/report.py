"""The report of `mantis materials`: what each material returns, whether more than it receives, and where its figures come "
"from."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.reporting.blocks import Card, Cell, Figures, Section, Table, Text
from experiments.reporting.formatting import number
from experiments.reporting.html import Report, figure, render
from experiments.reporting.sections import digest, made_by, versions_text
from experiments.studies.materials import page as materials_page
from experiments.studies.materials.page import MaterialRow
from materials.observed import WAVELENGTH_NM

_LOBES = "BRDF against observation angle at three entrance angles, dashed at the end of life."
_SPECTRA = "Albedo at normal incidence over wavelength; dashed at the end of life."


def html(rows: Sequence[MaterialRow], command: str) -> str:
    """The report as one HTML text that loads nothing from elsewhere.

    Args:
        rows: of `materials_page.run`.
        command: the command line that made it.
    """
    pairs = materials_page.fresh_and_worn([row.name for row in rows])
    brightest = max(rows, key=lambda row: max(row.albedo_0, row.albedo_30, row.albedo_60))
    most = max(brightest.albedo_0, brightest.albedo_30, brightest.albedo_60)
    assumed = [row for row in rows if row.assumption]
    cards = (
        Card("Energy", number(most), f"largest albedo, of {brightest.name}; 1 returns all light", (), most <= 1),
        Card("Sources", f"{len(rows) - len(assumed)} of {len(rows)}", "have no figure that is an assumption", (), None),
    )
    numbers = Table(
        ("material", "what it is", "peak f [sr⁻¹]", "albedo, 0°", "albedo, 30°", "albedo, 60°"),
        tuple(
            (
                Cell(row.name), Cell(row.title, style="left"), Cell(f"{row.peak_per_sr:.3g}", row.peak_per_sr),
                *(Cell(f"{a:.3f}", a, a <= 1) for a in (row.albedo_0, row.albedo_30, row.albedo_60)),
            )
            for row in rows
        ),
        f"At {WAVELENGTH_NM:g} nm",
    )  # fmt: skip
    origins = Table(
        ("material", "source", "date", "uncertainty", "status"),
        tuple(
            (
                Cell(row.name), Cell(row.source), Cell(row.date), Cell(row.uncertainty),
                Cell("assumption" if row.assumption else "", style="flagged" if row.assumption else ""),
            )
            for row in rows
        ),
        "Where every material's figures come from",
    )  # fmt: skip
    lobes = figure(materials_page.lobe_figure(pairs), "lobes", _LOBES)
    spectra = figure(materials_page.spectrum_figure(pairs), "spectra", _SPECTRA)
    evidence = (
        Section("numbers", "What each returns", (numbers,)),
        Section("lobes", "Lobes", (Figures((lobes,), _LOBES),)),
        Section("spectra", "Spectra", (Figures((spectra,), _SPECTRA),)),
    )
    versions = versions_text("numpy")
    hashes = {"Rows": digest(materials_page.as_csv(rows))}
    return render(
        Report(
            f"{len(rows)} materials at {WAVELENGTH_NM:g} nm",
            "Mantis materials",
            f"No material returns more light than it receives: {number(most)} of it at most."
            if most <= 1
            else f"{brightest.name} returns {number(most)} times the light that it receives.",
            most <= 1,
            cards,
            (),
            evidence,
            (
                Text(
                    (
                        "Each material is the sum of up to three lobes, the same for the budget and for the renderer: "
                        "Lambertian, a GGX mirror, and retroreflection by a table of ASTM E810's coefficient over "
                        "observation and entrance angle.",
                    )
                ),
                origins,
            ),
            tuple(made_by(command, None, hashes, versions)),
            versions,
        )
    )
