"""The verbs that show or write what a scenario or a library holds: new, presets, schema, marker, materials, sensor, explore."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from experiments.cli.options import Options, announce_variant, shared_options


@click.command()
@click.option("--from", "source", metavar="SCENARIO", help="Write out what this file or shipped scenario says.")
@shared_options
def new(options: Options, source: str | None) -> None:
    """Write a commented scenario to begin with: every key with its default, unit, bounds and meaning.

    With --out FILE.toml the schema is written beside it, which editors with a TOML language server (Taplo) complete from. A file
    that exists is left alone.
    """
    import json

    from experiments.reporting.files import write_text
    from experiments.scenario import apply_override, json_schema, load_data, validate
    from experiments.scenario.starter import SCHEMA_FILE, starter

    overrides = options.overrides if options.seed is None else (*options.overrides, f"seed={options.seed}")
    # Without --from nothing is written out: keys that stand beside a preset would win over it.
    data = {} if source is None else load_data(source)
    for override in overrides:
        apply_override(data, override)
    validate(data)
    text = starter(data)
    if options.out is None:
        click.echo(text, nl=False)
        return
    if options.out.exists():
        raise click.UsageError(f"new: {options.out} exists; give another name, or remove it first")
    write_text(text, options.out)
    beside = options.out.parent / SCHEMA_FILE
    write_text(json.dumps(json_schema(), indent=2) + "\n", beside)
    options.say(
        f"{options.out}: every key with its default. {beside}: schema for editors.",
        f"Change a line, then: mantis budget {options.out} --quick",
    )
    options.emit({"out": options.out, "schema": beside})


@click.command()
@click.argument("section", metavar="[sensors|lenses|leds|filters|markers|tapes]", required=False)
@shared_options
def presets(options: Options, section: str | None) -> None:
    """List the sensors, lenses, LEDs, filters, markers and tapes that a scenario can name; of one section with sources."""
    from rich.text import Text

    from experiments.reporting.terminal import plain_table
    from experiments.scenario.catalogue import SHOWN, catalogue, row, section_of

    entries = {name: catalogue(name) for name in ((section_of(section),) if section else SHOWN)}
    for name, found in entries.items():
        heading, columns = SHOWN[name]
        title = f"{heading}, say --set {found[0].setting}"
        options.say(plain_table(title, ("name", *columns), *(row(name, entry) for entry in found)))
    if section:
        options.say(*(Text(f"{entry.name}: {entry.source}") for found in entries.values() for entry in found))
    else:
        options.say("With their sources: say mantis presets sensors. All materials: mantis materials")
    options.emit(
        {
            name: [{"name": e.name, "key": e.key, "values": e.values, "source": e.source} for e in found]
            for name, found in entries.items()
        }
    )


@click.command()
@click.argument("what", type=click.Choice(["scenario", "sweep"]), default="scenario")
@shared_options
def schema(options: Options, what: str) -> None:
    """JSON schema of scenario files, or of sweep files, for an editor to complete and check them."""
    import json

    from experiments.reporting.files import write_text
    from experiments.scenario import json_schema

    if what == "sweep":
        from experiments.studies.sweep import plan

        found = plan.json_schema()
    else:
        found = json_schema()
    text = json.dumps(found, indent=2)
    if options.out is not None:
        write_text(text + "\n", options.out)
    else:
        click.echo(text)


@click.group(no_args_is_help=False)
def sensor() -> None:
    """Characterise the sensor by its own images: EMVA 1288 photon-transfer data set and datasheet."""


@sensor.command()
@click.argument("scenario", required=False)
@click.option("--preset", help="Characterise this sensor of the library instead of the scenario's.")
@shared_options
def emva1288(options: Options, scenario: str | None, preset: str | None) -> None:
    """Write an EMVA 1288 photon-transfer data set (--out FOLDER) and print the datasheet that its analysis gives."""
    from detector.sensor import emva1288 as emva
    from detector.sensor.sensor import presets
    from experiments.reporting.terminal import plain_table

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
    from scenes.files.marker_files import write_marker_files

    if options.out is None:
        raise click.UsageError("marker: give --out FOLDER")
    design = options.scenario(scenario).marker
    written = write_marker_files(design, options.out)
    options.say(*map(str, written), *(f"[yellow]note:[/] {line}" for line in design.shortcomings()))
    options.emit({"files": written, "shortcomings": design.shortcomings()})


@click.command()
@click.argument("names", metavar="[NAME|FILE.toml]...", nargs=-1)
@shared_options
def materials(options: Options, names: tuple[str, ...]) -> None:
    """List the materials, or those named with their sources; --out FOLDER writes report.html, the page, figures and a CSV."""
    from experiments.studies.materials import study
    from experiments.studies.materials.page import page
    from experiments.studies.materials.plan import Plan

    found = page(study.run(Plan(names)), " ".join(["mantis materials", *names]), named=bool(names))
    options.say(*found.terminal())
    if options.out is not None:
        found.write(options.out)
        options.say(f"Report: {options.out / 'report.html'}   Page: {options.out / 'materials.md'}")
    options.emit({**found.record(), "out": options.out})


@click.command()
@click.argument("scenario", required=False)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Address to listen on; default this machine alone."
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8850, show_default=True, help="Port; 0 for any that is free."
)
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@shared_options
def explore(options: Options, scenario: str | None, host: str, port: int, no_browser: bool) -> None:
    """A page on this machine to move range, tilt, light, camera and marker and see frame, budget and pose follow.

    Runs until interrupted. What is moved applies to rendered transport; new geometries are rendered aside and kept in the cache.
    """
    if options.out is not None:
        raise click.UsageError("explore: writes no files, so --out has nothing to name; the page saves the scenario")
    chosen = options.scenario(scenario)
    announce_variant(options)
    from experiments.chain.executor import ProcessExecutor
    from experiments.explore.explorer import Explorer
    from experiments.explore.geometries import GeometryStore
    from experiments.explore.server import LOOPBACK, Server

    with GeometryStore(ProcessExecutor(1)) as store, Server(Explorer(chosen, store), host, port) as server:
        options.say(server.url, "Ctrl-C ends it.")
        if host not in LOOPBACK:
            options.say(f"Whoever reaches {host} can see the page and have it render.")
        options.emit({"url": server.url})
        if not no_browser:
            import webbrowser

            webbrowser.open(server.url)
        with suppress(KeyboardInterrupt):
            server.wait()


VERBS: tuple[click.Command, ...] = (new, presets, schema, sensor, marker, materials, explore)
