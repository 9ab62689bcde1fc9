"""The verbs of the thesis's own studies."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli import Options, shared_options


@click.command()
@shared_options
def errata(options: Options) -> None:
    """The thesis's link budget as printed, repaired slip by slip, and in full; --out FOLDER writes page, figures and data."""
    from experiments.errata import page as errata_page
    from experiments.errata import study

    if options.overrides:
        raise click.UsageError(
            "errata: its settings are the thesis's, so --set has nothing to change; use mantis budget"
        )
    dataset = study.run(options.out)
    options.say(*errata_page.tables(dataset))
    if options.out is not None:
        options.say(f"Page, figures and data: {options.out / 'thesis-errata.md'}")
    options.emit(errata_page.facts(dataset))


@click.command()
@click.argument("problem", metavar="[PROBLEM.toml]", required=False, type=click.Path(path_type=Path))
@shared_options
def tradeoff(options: Options, problem: Path | None) -> None:
    """Analytic hierarchy process: the thesis's chapter 4 cell by cell, or the decision problem of a TOML file.

    Writes scores, sensitivities and figures into the folder --out (default out/tradeoff).
    """
    from experiments.console import plain_table
    from experiments.tradeoff import study

    out = options.out or Path("out/tradeoff")
    result = study.run(out, problem)
    rows = {"Scores": study.summary_rows(result)}
    if problem is None:
        rows["The thesis's printed cells, by verdict"] = study.verdict_rows(study.thesis_cells())
    options.say(*(plain_table(title, *lines) for title, lines in rows.items()), f"Figures and data: {out}")
    options.emit(
        {
            "out": out,
            **{title: [dict(zip(lines[0], r, strict=False)) for r in lines[1:]] for title, lines in rows.items()},
        }
    )


@click.command()
@click.option("--quick", is_flag=True, help="A fiftieth of the scenes, at four ranges.")
@shared_options
def montecarlo(options: Options, quick: bool) -> None:
    """Pose from points over random scenes: the thesis's Monte Carlo as listed and as meant, solver by solver.

    Takes some ten minutes in full. Writes tables, figures and montecarlo.nc into the folder --out (default out/montecarlo).
    """
    from experiments.console import plain_table
    from experiments.montecarlo import study
    from experiments.montecarlo.figures import summary_rows

    out = options.out or Path("out/montecarlo")
    tree = study.run(out, 1 if options.seed is None else options.seed, quick)
    header, *rows = summary_rows({"performance": tree["performance"].to_dataset()})
    options.say(plain_table("Outliers of pose from points", header, *rows), f"Tables, figures and data: {out}")
    options.emit({"out": out, "outliers": [dict(zip(header, row, strict=True)) for row in rows]})


VERBS: tuple[click.Command, ...] = (errata, tradeoff, montecarlo)
