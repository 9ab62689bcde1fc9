"""The verbs about measuring: how good the features are, and calibrating marker and camera from images."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.options import Options, shared_options
from experiments.cli.study_verb import StudyVerb, study_verb

#: Endings of the files of a folder that count as images.
IMAGE_ENDINGS = frozenset((".png", ".tif", ".tiff", ".pgm", ".jpg", ".jpeg", ".exr"))


features = study_verb(
    StudyVerb(
        name="features",
        package="experiments.studies.features",
        help="Corners, blobs and pose beside their Cramér–Rao bounds; detection beside other detectors; marker-free frames; "
        "calibrations.\n\nTakes some ten minutes in full on two idle cores.",
        quick="One geometry and few frames: whether it works, within half a minute.",
        workers=True,
        require={"targets": "no target is missed"},
    )
)


@click.command()
@click.argument("what", type=click.Choice(["elements", "camera"]))
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("scenario", required=False)
@click.option(
    "--squares", default="12x9", metavar="CxR", help="The chessboard's squares along both sides; default 12x9."
)
@click.option("--square-m", type=click.FloatRange(min=0, min_open=True), default=0.03, help="Side of a square [m].")
@click.option("--no-distortion", is_flag=True, help="Take the lens to have none.")
@shared_options
def calibrate(
    options: Options, what: str, folder: Path, scenario: str | None, squares: str, square_m: float, no_distortion: bool
) -> None:
    """Calibrate from the images of a FOLDER: a marker's 'elements', by the SCENARIO's camera, or a 'camera', by a chessboard.

    Prints the keys to put into a scenario file, and writes them to --out FILE.toml.
    """
    from experiments.reporting.files import read_image, write_text
    from experiments.studies.shared import calibrations

    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_ENDINGS)
    if not paths:
        raise click.UsageError(f"{folder}: no image in it; expected {', '.join(sorted(IMAGE_ENDINGS))}")
    images, chosen = [read_image(path) for path in paths], options.scenario(scenario)
    if what == "elements":
        report = calibrations.report_elements(calibrations.elements_from_images(images, chosen), chosen)
    else:
        board = calibrations.board_of(squares, square_m)
        found = calibrations.camera_from_images(images, board, chosen.camera.psf_sigma_px, not no_distortion)
        report = calibrations.report_camera(found, chosen)
    options.say(*report.lines, "", report.toml)
    options.emit({**report.values, "images": len(paths), "toml": report.toml})
    if options.out is not None:
        write_text(report.toml, options.out)
