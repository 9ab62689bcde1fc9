"""The verbs about the thesis's system: layout, field of view, power, requirements, and other markers beside this one."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.study_verb import PlanOption, StudyVerb, study_verb

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
