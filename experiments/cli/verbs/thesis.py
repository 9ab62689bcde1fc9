"""The verbs of the thesis's own studies."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.options import Options, RequirementNotMet, announce_variant, shared_options, with_progress
from experiments.cli.study_verb import StudyVerb, study_verb
from experiments.cli.verbs import system

ERRATA = StudyVerb(
    name="errata",
    package="experiments.thesis.errata",
    help="The thesis's link budget as printed, with its errors corrected one by one, and in full.",
    source="",
    load="experiments.thesis.errata.study.load",
    fixed="its settings are the thesis's",
    renders=False,
)


TRADEOFF = StudyVerb(
    name="tradeoff",
    package="experiments.thesis.tradeoff",
    help="Analytic hierarchy process: the thesis's chapter 4 cell by cell, or the decision problem of a TOML file.",
    source="PROBLEM.toml",
    load="experiments.thesis.tradeoff.problem.load",
    fixed="a decision problem is as its file says",
    renders=False,
)


MONTECARLO = StudyVerb(
    name="montecarlo",
    package="experiments.thesis.montecarlo",
    help=(
        "Pose from points over random scenes: the thesis's Monte Carlo as listed and as meant, solver by solver.\n\n"
        "Takes some ten minutes in full."
    ),
    source="",
    load="experiments.thesis.montecarlo.study.load",
    quick="A fiftieth of the scenes, at four ranges.",
    renders=False,
)


@click.command()
@click.option("--quick", is_flag=True, help="Three tests of some frames each: a first look.")
@click.option(
    "--step", "step_deg", type=click.FloatRange(0.01, 30), help="Steps of tilt [deg]; default the thesis's 0.1."
)
@click.option("--workers", type=click.IntRange(1), help="Processes that look at the frames; default one a core.")
@click.option("--resume", is_flag=True, help="Go on from the finished runs of a command that was interrupted.")
@click.option("--require", type=click.Choice(["targets"]), help="Exit status 4 where Mantis misses a target.")
@shared_options
def virtual(
    options: Options, quick: bool, step_deg: float | None, workers: int | None, resume: bool, require: str | None
) -> None:
    """The virtual experiment of table 8.1: pitch, range and detection over tilt, Mantis against other fiducials, all rendered.

    Takes some fifteen minutes in full. Writes report.html, virtual.md, virtual.nc, data and figures into the folder --out
    (default out/virtual).
    """
    from experiments.reporting.terminal import plain_table
    from experiments.thesis.virtual import page as virtual_page
    from experiments.thesis.virtual import summary, targets

    scenario, out = targets.load(options.overrides, options.seed), options.out or Path("out/virtual")
    announce_variant(options)
    words = [
        "mantis virtual",
        "--quick" if quick else "",
        f"--step {step_deg:g}" if step_deg else "",
        *(f"--set {o}" for o in options.overrides),
    ]
    words += [f"--seed {options.seed}"] if options.seed is not None else []
    command = " ".join(word for word in words if word)
    page, result = with_progress(
        options, lambda tell: virtual_page.run(scenario, out, command, quick, workers, tell, step_deg, resume)
    )
    header, *rows = summary.rows(result.summary)
    shown = [[row[k].replace("[", "(").replace("]", ")") for k in summary.TERMINAL] for row in (header, *rows)]
    options.say(
        page.headline, *(f"→ {line}" for line in page.answers), plain_table("Tests", *shown),
        f"Report and data: {out / 'report.html'}",
    )  # fmt: skip
    short = summary.missed(result.summary)
    tests = [dict(zip(header, row, strict=True)) for row in rows]
    options.emit({"headline": page.headline, "missed": short, "out": out, "tests": tests})
    if require and short:
        raise RequirementNotMet(short[0])


VERBS: tuple[click.Command, ...] = (
    study_verb(ERRATA),
    study_verb(TRADEOFF),
    study_verb(MONTECARLO),
    virtual,
    *system.VERBS,
)
