"""The verbs that write what a scenario or a library holds: schema, marker, materials, sensor."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli import Options, shared_options


@click.command()
@shared_options
def schema(options: Options) -> None:
    """JSON schema of scenario files, for an editor to complete and check them."""
    import json

    from experiments.files import write_text
    from experiments.scenario import json_schema

    text = json.dumps(json_schema(), indent=2)
    if options.out is not None:
        write_text(text + "\n", options.out)
    else:
        click.echo(text)


@click.group(no_args_is_help=False)
def sensor() -> None:
    """Sensor characterisation."""


@sensor.command()
@click.argument("scenario", required=False)
@click.option("--preset", help="Characterise this sensor of the library instead of the scenario's.")
@shared_options
def emva1288(options: Options, scenario: str | None, preset: str | None) -> None:
    """Write an EMVA 1288 photon-transfer data set (--out FOLDER) and print the datasheet that its analysis gives."""
    from detector import emva1288 as emva
    from detector.sensor import presets
    from experiments.console import plain_table

    chosen = options.scenario(scenario)
    device, camera = chosen.sensor, chosen.camera
    if preset is not None:
        if preset not in presets():
            raise click.UsageError(f"--preset {preset}: unknown; there are {', '.join(presets())}")
        device, camera = presets()[preset].sensor, camera.model_copy(update=presets()[preset].grid)
    if options.out is None:
        raise click.UsageError("sensor emva1288: give --out FOLDER")
    written = emva.write_dataset(device, options.out, seed=chosen.seed, pixel_area_m2=camera.pixel_area_m2)
    rows = emva.datasheet(emva.characterise(written))
    table = plain_table("EMVA 1288 datasheet, from the images", ("Quantity", "Symbol", "Value", "Unit"), *rows)
    options.say(table, f"Data set: {written}")
    options.emit(
        {
            "dataset": Path(written),
            "datasheet": [dict(zip(("quantity", "symbol", "value", "unit"), r, strict=True)) for r in rows],
        }
    )


@click.command()
@click.argument("scenario", required=False)
@shared_options
def marker(options: Options, scenario: str | None) -> None:
    """Write the marker as printable solids, an OBJ, a tape sheet and its feature points into the folder --out."""
    from scenes.marker_files import write_marker_files

    if options.out is None:
        raise click.UsageError("marker: give --out FOLDER")
    written = write_marker_files(options.scenario(scenario).marker, options.out)
    options.say(*map(str, written))
    options.emit({"files": written})


@click.command()
@click.argument("names", metavar="[NAME|FILE.toml]...", nargs=-1)
@shared_options
def materials(options: Options, names: tuple[str, ...]) -> None:
    """List the materials, or those named with their sources; --out FOLDER writes figures of lobe and spectrum, and a CSV."""
    from dataclasses import asdict

    from experiments import materials_page

    rows = materials_page.run(options.out, names)
    options.say(materials_page.as_table(rows), *(materials_page.sources(rows) if names else ()))
    if options.out is not None:
        options.say(f"Page, figures and data: {options.out / 'materials.md'}")
    options.emit({"wavelength_nm": materials_page.WAVELENGTH_NM, "materials": [asdict(row) for row in rows]})


VERBS: tuple[click.Command, ...] = (schema, sensor, marker, materials)
