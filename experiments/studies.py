"""The verbs of the other studies: materials, sensor, and those of the thesis."""

from __future__ import annotations

from pathlib import Path

import click

from experiments.cli import Options, shared_options


@click.group()
def sensor() -> None:
    """Sensor characterisation."""


@sensor.command()
@click.argument("scenario", required=False)
@click.option("--preset", help="Characterise this sensor of the library instead of the scenario's.")
@shared_options
def emva1288(options: Options, scenario: str | None, preset: str | None) -> None:
    """Write an EMVA 1288 photon-transfer data set (--out FOLDER) and print the datasheet that its analysis gives."""
    from rich.table import Table

    from detector import emva1288 as emva
    from detector.sensor import presets

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
    table = Table(title="EMVA 1288 datasheet, from the images")
    for heading in ("Quantity", "Symbol", "Value", "Unit"):
        table.add_column(heading, justify="right" if heading == "Value" else "left")
    for row in rows:
        table.add_row(*map(str, row))
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


VERBS: tuple[click.Command, ...] = (
    marker,
    sensor,
)
