"""The verbs about measuring: how good the features are, and calibrating marker and camera from images."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.options import Options, RequirementNotMet, announce_variant, shared_options, with_progress

#: Endings of the files of a folder that count as images.
IMAGE_ENDINGS = frozenset((".png", ".tif", ".tiff", ".pgm", ".jpg", ".jpeg", ".exr"))


@click.command()
@click.argument("scenario", required=False)
@click.option("--quick", is_flag=True, help="One geometry and few frames: whether it works, within half a minute.")
@click.option(
    "--workers", type=click.IntRange(0), help="Processes beside the renderer's; 0 is none, default one a core."
)
@click.option("--require", type=click.Choice(["targets"]), help="Exit status 4 where a target is not met.")
@shared_options
def features(options: Options, scenario: str | None, quick: bool, workers: int | None, require: str | None) -> None:
    """Corners, blobs and pose beside their Cramér–Rao bounds; detection beside other detectors; marker-free frames; calibrations.

    Takes some ten minutes in full on two idle cores. Writes features.md, features.nc, tables and figures into the folder --out
    (default out/features).
    """
    from experiments.reporting.terminal import plain_table
    from experiments.studies.features import study, tables

    chosen, out = options.scenario(scenario), options.out or Path("out/features")
    announce_variant(options)
    result = with_progress(options, lambda tell: study.run(chosen, quick, workers, tell))
    words = ["mantis features", scenario, "--quick" if quick else None]
    words += [f"--set {override}" for override in options.overrides]
    words += [f"--seed {options.seed}"] if options.seed is not None else []
    study.write(result, out, " ".join(word for word in words if word))
    found = tables.targets(result.accuracy, result.detection, result.clutter, result.trials)
    headline = tables.headline(found)
    options.say(
        headline, plain_table("Targets", tables.TARGET_HEADINGS, *tables.target_rows(found)), f"Page and data: {out}"
    )
    options.emit({"headline": headline, "targets": [vars(target) for target in found], "out": out})
    if require and any(target.met is False for target in found):
        raise RequirementNotMet(headline)


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
