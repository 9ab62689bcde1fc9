"""The verbs about the thesis's system: layout, field of view, power, requirements, and other markers beside this one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from experiments.cli.options import Options, RequirementNotMet, shared_options
from experiments.cli.study_verb import StudyVerb, study_verb


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


layout = study_verb(
    StudyVerb(
        name="layout",
        package="experiments.thesis.layout",
        help="Several markers on faces of 1 to 10 m: footprint, markers in view over range, and one pose from all by "
        "rendering.\n\nTakes some ten minutes in full.",
        quick="A few counts and one rendered face: a first look.",
    )
)


fov = study_verb(
    StudyVerb(
        name="fov",
        package="experiments.thesis.fov",
        help="Field of view of an element and of the marker: equations 5.17 to 5.20, and rendered frames over pitch and "
        "yaw.\n\nTakes some ten minutes in full.",
        quick="Nine tilts and a cut of five: a first look.",
    )
)


@click.command()
@click.argument("scenario", required=False)
@click.option("--quick", is_flag=True, help="Four ranges instead of twenty.")
@click.option("--limit-w", type=float, help="Mean power that may be drawn [W]; default the thesis's 5.")
@click.option("--camera-w", type=float, help="What the camera draws [W]; default 2.5, an assumption.")
@shared_options
def power(options: Options, scenario: str | None, quick: bool, limit_w: float | None, camera_w: float | None) -> None:
    """Frames a second within a power limit (equation 6.10), duty, tumble between frames, and what the LEDs stand.

    Writes report.html, power.nc, data and figures into the folder --out (default out/power).
    """
    from pydantic import ValidationError

    from experiments.scenario.errors import explain
    from experiments.thesis.power import study
    from radiometry.power import PowerPlan

    given = {key: value for key, value in (("limit_w", limit_w), ("camera_w", camera_w)) if value is not None}
    try:
        plan = PowerPlan.model_validate(given)
    except ValidationError as error:
        raise ValueError(explain(error, PowerPlan)) from None
    chosen, out = options.scenario(scenario), options.out or Path("out/power")
    flags = [f"--{key.replace('_', '-')} {value:g}" for key, value in given.items()]
    command = _command("power", options, scenario, "--quick" if quick else None, *flags)
    _tell(options, study.study(chosen, plan, out, command, quick), out, "thesis")


@click.command()
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    default=Path("docs/data"),
    show_default=True,
    help="Folder with the tables of the other studies; what is not there is not verifiable.",
)
@click.option("--require", type=click.Choice(["met"]), help="Exit status 4 where a requirement is not met.")
@shared_options
def requirements(options: Options, results: Path, require: str | None) -> None:
    """SYS-REQ-1 to 14 and STA-REQ-1 to 9, verified from this project's own results, beside the thesis's tables 8.4 and 8.5.

    Writes report.html, requirements.nc, data and figures into the folder --out (default out/requirements).
    """
    from experiments.thesis.requirements import study

    if not results.is_dir():
        raise click.UsageError(f"--results {results}: no such folder; expected one with tables, as docs/data")
    out = options.out or Path("out/requirements")
    command = _command("requirements", options, None, None if results == Path("docs/data") else f"--results {results}")
    page = study.study(options.scenario(None), results, out, command)
    _tell(options, page, out, "requirements")
    if require and not page.passed:
        raise RequirementNotMet(page.headline)


comparison = study_verb(
    StudyVerb(
        name="comparison",
        package="experiments.thesis.comparison",
        help="Attitude error over tilt at equal pixel size: this marker, ArUco, AprilTag and a protrusion rendered, lens and "
        "moiré markers by closed form and as published.",
        source="",
        load="experiments.thesis.virtual.targets.load",
        quick="One size, two tilts, three frames of each.",
        workers=True,
    )
)


physical = study_verb(
    StudyVerb(
        name="physical",
        package="experiments.thesis.physical",
        help="The physical experiment of sections 7.1 and 8.2 emulated: arm, calibrated camera, LEDs and halogen spot, all "
        "rendered.\n\nTakes some three minutes in full on two idle cores.",
        source="",
        load="experiments.thesis.physical.arm.load",
        quick="Two passes of three stations, and few chessboards: a first look.",
        workers=True,
        require={"found": "every frame in eclipse is found, and none is an outlier"},
    )
)


@click.command()
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    multiple=True,
    default=(Path("docs/data"),),
    show_default=True,
    help="Folder with a study's tables, or a study's own folder; may be given many times, the first that has a table counts.",
)
@shared_options
def risk(options: Options, results: tuple[Path, ...]) -> None:
    """Failure modes of section 8.3: their rates over the other studies' frames, and their places in the risk matrix.

    Before is the thesis's pipeline, after this project's. Writes report.html, risk.md, risk.nc, data and figures into the folder
    --out (default out/risk).
    """
    from experiments.thesis.risk import page

    if options.overrides:
        raise click.UsageError(
            "risk: it reads results, so --set has nothing to change; give it to the studies that make them"
        )
    out = options.out or Path("out/risk")
    flags = () if results == (Path("docs/data"),) else tuple(f"--results {folder}" for folder in results)
    result = page.study(results, out, _command("risk", options, None, *flags))
    _tell(options, result, out, "places")


VERBS: tuple[click.Command, ...] = (layout, fov, power, requirements, comparison, physical, risk)
