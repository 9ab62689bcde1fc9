"""The verbs of the thesis's own studies."""

from __future__ import annotations

import click

from experiments.cli.study_verb import PlanOption, StudyVerb, study_verb
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


VERBS: tuple[click.Command, ...] = (
    study_verb(ERRATA),
    study_verb(TRADEOFF),
    study_verb(MONTECARLO),
    virtual,
    *system.VERBS,
)
