"""The verbs of the chain: doctor, budget, render, expose, detect."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli.options import (
    EnvironmentLacking,
    Options,
    RequirementNotMet,
    announce_variant,
    ready_folder,
    shared_options,
)
from experiments.cli.study_verb import StudyVerb, study_verb

SCENARIO = click.argument("scenario", required=False)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the diagnosis as one JSON object.")
def doctor(as_json: bool) -> None:
    """Check LLVM, Mitsuba's variants, EXR and threads, and say what to install."""
    import json

    from experiments.cli.doctor import FAILED, diagnose, print_report

    diagnosis = diagnose()
    if as_json:
        click.echo(json.dumps(diagnosis, indent=2))
    else:
        from rich.console import Console

        print_report(diagnosis, Console(highlight=False))
    if diagnosis["status"] == FAILED:
        raise EnvironmentLacking("; ".join(diagnosis["advice"]) or "this machine cannot run the project")


budget = study_verb(
    StudyVerb(
        name="budget",
        package="experiments.studies.budget",
        help="Eclipse and sunlight budget over range, rendered beside closed form, with a verdict and a report.\n\n"
        "SCENARIO is a TOML file or the name of a shipped one.",
        quick="Fewer ranges, noise draws and rays: a first look within 40 s.",
        workers=True,
        condition="'closes' or ILLUMINATION:RANGE, say eclipse:10",
        writes="each range's EXR and PNG",
    )
)


@click.command()
@SCENARIO
@click.option(
    "--export",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write the scene for stock Mitsuba into this folder.",
)
@shared_options
def render(options: Options, scenario: str | None, export: Path | None) -> None:
    """Render the transport basis of one geometry to a multi-layer EXR, and/or --export the scene.

    Layers are led.nmNNNN (radiance per unit intensity of the ring, 1/m²) and sun.nmNNNN (per unit irradiance, 1/sr).
    """
    from experiments import chain

    chosen = options.scenario(scenario)
    if options.out is None and export is None:
        raise click.UsageError("render: give --out FILE.exr, --export FOLDER, or both")
    if options.out is not None and options.out.suffix.lower() != ".exr":
        raise click.UsageError(f"--out {options.out}: expected a name that ends in .exr")
    if options.out is not None:
        ready_folder(options.out.parent)
    announce_variant(options)
    if export is not None:
        from scenes.files.export import export_scene

        export_scene(chain.view(chosen), chain.source_spectra(chosen), export)
        options.say(f"Scene: {export}")
    if options.out is not None:
        from scenes.files.exr import write_basis

        basis = chain.transport(chosen)
        write_basis(basis, options.out)
        options.say(f"Transport basis at {', '.join(f'{n} nm' for n in basis.nodes_nm)}: {options.out}")
    options.emit({"out": options.out, "export": export, "scenario_hash": chosen.digest()})


@click.command()
@click.argument("basis", metavar="IN.exr", type=click.Path(path_type=Path))
@SCENARIO
@click.option("--trial", type=click.IntRange(0), default=0, show_default=True, help="Which noise draw of the seed.")
@shared_options
def expose(options: Options, basis: Path, scenario: str | None, trial: int) -> None:
    """Electrons and digital numbers of one exposure: --out FILE.png (16 bit) or FILE.exr (electrons)."""
    from experiments import chain
    from scenes.files.exr import read_basis, write_channels

    chosen = options.scenario(scenario)
    if options.out is None or options.out.suffix.lower() not in (".png", ".exr"):
        raise click.UsageError("expose: give --out FILE.png (digital numbers) or FILE.exr (electrons)")
    transport = read_basis(basis)
    chain.check_geometry(chosen, transport, basis)
    rate = chain.electron_rate(chosen, transport, chosen.illumination)
    seconds = chain.solve_exposure(
        chosen, chain.link_budget_beside(chosen, chosen.illumination, rate), chosen.exposure_s
    )
    frame = chain.expose(chosen, rate, chosen.illumination, seconds, trial)
    if options.out.suffix.lower() == ".png":
        from experiments.reporting.files import write_png

        write_png(frame.dn, options.out)
    else:
        write_channels(
            {"electrons": frame.electrons},
            {**chain.provenance(chosen), "unit": "electron", "exposure_s": seconds},
            options.out,
        )
    saturated = float((frame.electrons >= chain.usable_well_electrons(chosen.sensor)).mean())
    options.say(
        f"{chosen.illumination}, {seconds:.4g} s, brightest {frame.electrons.max():.0f} e-, {saturated:.2%} saturated: "
        f"{options.out}"
    )
    options.emit(
        {
            "out": options.out,
            "illumination": chosen.illumination,
            "exposure_s": seconds,
            "saturated_fraction": saturated,
        }
    )


@click.command()
@click.argument("image", type=click.Path(path_type=Path))
@SCENARIO
@click.option("--off", type=click.Path(path_type=Path), help="A frame without the LEDs, which is subtracted.")
@click.option("--require", type=click.Choice(["detected", "pose"]), help="Exit status 4 where this was not reached.")
@shared_options
def detect(options: Options, image: Path, scenario: str | None, off: Path | None, require: str | None) -> None:
    """Features and pose of one image, from anywhere; the scenario says which camera and which marker."""
    from experiments import chain
    from experiments.reporting import detection
    from experiments.reporting.files import read_image, write_text

    chosen = options.scenario(scenario)
    seen = chain.detect(chain.Belief.of(chosen), read_image(image), None if off is None else read_image(off))
    record = detection.as_record(seen)
    options.emit(record)
    if options.out is not None:
        import json

        write_text(json.dumps(record, indent=2) + "\n", options.out)
    options.say(*detection.describe(seen))
    if (require == "detected" and not record["detected"]) or (require == "pose" and record["pose"] is None):
        raise RequirementNotMet(f"{require}, but {record['reason'] or 'no pose fits the features'}")


VERBS: tuple[click.Command, ...] = (doctor, budget, render, expose, detect)
