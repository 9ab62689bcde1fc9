"""The verbs about the thesis's system: layout, field of view, power, requirements, and other markers beside this one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from experiments.cli.options import Options, RequirementNotMet, announce_variant, shared_options, with_progress
from experiments.cli.study_verb import PlanOption, StudyVerb, study_verb


def _command(verb: str, options: Options, scenario: str | None, *flags: str | None) -> str:
    """The command line that makes a page again, without its folder."""
    words = [f"mantis {verb}", scenario, *flags, *(f"--set {o}" for o in options.overrides)]
    words += [f"--seed {options.seed}"] if options.seed is not None else []
    return " ".join(word for word in words if word)


def _tell(options: Options, page: Any, out: Path, *tables: str) -> None:
    """Headline, answers, statements and the named tables on the terminal, or all of them as JSON."""
    from rich.markup import escape

    from experiments.reporting.claims import statement_rows
    from experiments.reporting.terminal import plain_table

    def shown_table(title: str, lines: Any) -> Any:
        # A unit in brackets would be taken for a style.
        head, *rest = [[escape(str(cell)) for cell in line] for line in lines]
        return plain_table(title, head, *rest)

    header, *rows = statement_rows(page.statements)
    shown = [shown_table("Printed, reproduced, right", [header, *rows])] if rows else []
    shown += [shown_table(page.table_captions[name], page.tables[name]) for name in tables]
    options.say(page.headline, *(f"→ {answer}" for answer in page.answers), *shown, f"Report and data: {out}")
    options.emit(
        {
            "headline": page.headline, "passed": page.passed, "answers": list(page.answers), "out": out,
            "statements": [dict(zip(header, row, strict=True)) for row in rows],
        }
    )  # fmt: skip


@click.command()
@click.argument("scenario", required=False)
@click.option("--quick", is_flag=True, help="A few counts and one rendered face: a first look.")
@shared_options
def layout(options: Options, scenario: str | None, quick: bool) -> None:
    """Several markers on faces of 1 to 10 m: footprint, markers in view over range, and one pose from all by rendering.

    Takes some ten minutes in full. Writes report.html, layout.nc, data and figures into the folder --out (default out/layout).
    """
    from experiments.thesis.layout import page

    chosen, out = options.scenario(scenario), options.out or Path("out/layout")
    announce_variant(options)
    command = _command("layout", options, scenario, "--quick" if quick else None)
    result = with_progress(options, lambda tell: page.study(chosen, out, command, quick, tell))
    _tell(options, result, out, "pose")


@click.command()
@click.argument("scenario", required=False)
@click.option("--quick", is_flag=True, help="Nine tilts and a cut of five: a first look.")
@shared_options
def fov(options: Options, scenario: str | None, quick: bool) -> None:
    """Field of view of an element and of the marker: equations 5.17 to 5.20, and rendered frames over pitch and yaw.

    Takes some ten minutes in full. Writes report.html, fov.nc, data and figures into the folder --out (default out/fov).
    """
    from experiments.thesis.fov import page

    chosen, out = options.scenario(scenario), options.out or Path("out/fov")
    announce_variant(options)
    command = _command("fov", options, scenario, "--quick" if quick else None)
    result = with_progress(options, lambda tell: page.study(chosen, out, command, quick, tell))
    _tell(options, result, out, "cone")


POWER = StudyVerb(
    name="power",
    package="experiments.thesis.power",
    help="Frames a second within a power limit (equation 6.10), duty, tumble between frames, and what the LEDs stand.",
    quick="Four ranges instead of twenty.",
    renders=False,
    plan=(
        PlanOption("--limit-w", "limit_w", float, "Mean power that may be drawn [W]; default the thesis's 5."),
        PlanOption("--camera-w", "camera_w", float, "What the camera draws [W]; default 2.5, an assumption."),
    ),
)


REQUIREMENTS = StudyVerb(
    name="requirements",
    package="experiments.thesis.requirements",
    help=(
        "SYS-REQ-1 to 14 and STA-REQ-1 to 9, verified from this project's own results, beside the thesis's tables 8.4 and 8.5."
    ),
    source="",
    renders=False,
    require={"met": "every system requirement is met or cannot be verified here"},
    plan=(
        PlanOption(
            "--results",
            "results",
            click.Path(path_type=Path),
            "Folder with the tables of the other studies; what is not there is not verifiable. Default docs/data.",
        ),
    ),
)


@click.command()
@click.option("--quick", is_flag=True, help="One size, two tilts, three frames of each.")
@click.option("--workers", type=click.IntRange(1), help="Processes that look at the frames; default one a core.")
@shared_options
def comparison(options: Options, quick: bool, workers: int | None) -> None:
    """Attitude error over tilt at equal pixel size: this marker, ArUco, AprilTag and a protrusion rendered, lens and moiré
    markers by closed form and as published.

    Writes report.html, comparison.nc, data and figures into the folder --out (default out/comparison).
    """
    from experiments.thesis.comparison import study

    out = options.out or Path("out/comparison")
    announce_variant(options)
    command = _command("comparison", options, None, "--quick" if quick else None)
    page = with_progress(
        options, lambda tell: study.study(out, command, quick, options.seed, options.overrides, workers, tell)
    )
    _tell(options, page, out)


@click.command()
@click.option("--quick", is_flag=True, help="Two passes of three stations, and few chessboards: a first look.")
@click.option("--workers", type=click.IntRange(1), help="Processes that look at the frames; default one a core.")
@click.option(
    "--require", type=click.Choice(["found"]), help="Exit status 4 unless every frame in eclipse is found, none wild."
)
@shared_options
def physical(options: Options, quick: bool, workers: int | None, require: str | None) -> None:
    """The physical experiment of sections 7.1 and 8.2 emulated: arm, calibrated camera, LEDs and halogen spot, all rendered.

    Takes some three minutes in full on two idle cores. Writes report.html, physical.md, physical.nc, data and figures into the
    folder --out (default out/physical).
    """
    from experiments.thesis.physical import arm, page

    scenario, out = arm.load(options.overrides, options.seed), options.out or Path("out/physical")
    announce_variant(options)
    command = _command("physical", options, None, "--quick" if quick else None)
    result = with_progress(options, lambda tell: page.study(scenario, out, command, quick, workers, tell))
    _tell(options, result, out, "camera")
    if require and not result.passed:
        raise RequirementNotMet(result.headline)


RISK = StudyVerb(
    name="risk",
    package="experiments.thesis.risk",
    help=(
        "Failure modes of section 8.3: their rates over the other studies' frames, and their places in the risk matrix.\n\n"
        "Before is the thesis's pipeline, after this project's."
    ),
    source="",
    fixed="it reads the results of other studies",
    renders=False,
    plan=(
        PlanOption(
            "--results",
            "results",
            click.Path(path_type=Path),
            "Folder with a study's tables, or a study's own folder; may be given many times, the first that has a table "
            "counts. Default docs/data.",
            multiple=True,
        ),
    ),
)


VERBS: tuple[click.Command, ...] = (
    layout,
    fov,
    study_verb(POWER),
    study_verb(REQUIREMENTS),
    comparison,
    physical,
    study_verb(RISK),
)
