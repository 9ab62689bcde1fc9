"""The verbs of the thesis's own studies."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.options import Options, shared_options
from experiments.cli.study_verb import PlanOption, StudyVerb, study_verb
from experiments.cli.verbs import system


@click.command()
@shared_options
def errata(options: Options) -> None:
    """The thesis's link budget as printed, repaired slip by slip, and in full; --out FOLDER writes page, figures and data."""
    from experiments.thesis.errata import page as errata_page
    from experiments.thesis.errata import study

    if options.overrides:
        raise click.UsageError(
            "errata: its settings are the thesis's, so --set has nothing to change; use mantis budget"
        )
    dataset = study.run(options.out)
    options.say(*errata_page.tables(dataset))
    if options.out is not None:
        from experiments.reporting.files import write_text
        from experiments.thesis.errata.report import html

        write_text(html(dataset, "mantis errata"), options.out / "report.html")
        options.say(f"Report: {options.out / 'report.html'}   Page: {options.out / 'thesis-errata.md'}")
    options.emit(errata_page.facts(dataset))


@click.command()
@click.argument("problem", metavar="[PROBLEM.toml]", required=False, type=click.Path(path_type=Path))
@shared_options
def tradeoff(options: Options, problem: Path | None) -> None:
    """Analytic hierarchy process: the thesis's chapter 4 cell by cell, or the decision problem of a TOML file.

    Writes scores, sensitivities and figures into the folder --out (default out/tradeoff).
    """
    from experiments.reporting.files import write_text
    from experiments.reporting.terminal import plain_table
    from experiments.thesis.tradeoff import report, study

    out = options.out or Path("out/tradeoff")
    result = study.run(out, problem)
    cells = study.thesis_cells() if problem is None else []
    text = (problem or study.THESIS_PROBLEM).read_text(encoding="utf-8")
    command = f"mantis tradeoff {problem}" if problem else "mantis tradeoff"
    write_text(report.html(result, text, cells, command), out / "report.html")
    rows = {"Scores": study.summary_rows(result)}
    if problem is None:
        rows["The thesis's printed cells, by verdict"] = study.verdict_rows(cells)
    options.say(
        *(plain_table(title, *lines) for title, lines in rows.items()), f"Report and data: {out / 'report.html'}"
    )
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
    from experiments.reporting.files import write_text
    from experiments.reporting.terminal import plain_table
    from experiments.thesis.montecarlo import report, study
    from experiments.thesis.montecarlo.figures import summary_rows

    out, seed = options.out or Path("out/montecarlo"), 1 if options.seed is None else options.seed
    tree = study.run(out, seed, quick)
    parts = {name: node.to_dataset() for name, node in tree.children.items()}
    command = " ".join(
        ["mantis montecarlo", *(["--quick"] if quick else []), *([f"--seed {seed}"] if seed != 1 else [])]
    )
    write_text(report.html(parts, seed, command), out / "report.html")
    header, *rows = summary_rows(parts)
    options.say(plain_table("Outliers of pose from points", header, *rows), f"Report and data: {out / 'report.html'}")
    options.emit({"out": out, "outliers": [dict(zip(header, row, strict=True)) for row in rows]})


virtual = study_verb(
    StudyVerb(
        name="virtual",
        package="experiments.thesis.virtual",
        help="The virtual experiment of table 8.1: pitch, range and detection over tilt, Mantis against other fiducials, all "
        "rendered.\n\nTakes some fifteen minutes in full.",
        source="",
        load="experiments.thesis.virtual.targets.load",
        quick="Three tests of some frames each: a first look.",
        workers=True,
        require={"targets": "Mantis meets its targets of error and detection"},
        resume="Go on from the finished runs of a command that was interrupted.",
        plan=(
            PlanOption(
                "--step", "step_deg", click.FloatRange(0.01, 30), "Steps of tilt [deg]; default the thesis's 0.1."
            ),
        ),
    )
)


VERBS: tuple[click.Command, ...] = (errata, tradeoff, montecarlo, virtual, *system.VERBS)
