"""The verbs of the studies over many scenarios."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from experiments.cli.options import (
    EnvironmentLacking,
    Options,
    announce_variant,
    shared_options,
    with_progress,
)
from experiments.cli.study_verb import PlanOption, StudyVerb, study_verb
from experiments.cli.verbs.measuring import calibrate, features


@click.command()
@click.argument("plan", metavar="SWEEP.toml", type=click.Path(path_type=Path))
@click.option("--resume", is_flag=True, help="Go on with an interrupted sweep.")
@click.option("--workers", type=click.IntRange(1), help="Processes on this machine; default none beside this one.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work, say tcp://host:8786.")
@shared_options
def sweep(options: Options, plan: Path, resume: bool, workers: int | None, scheduler: str | None) -> None:
    """Run a grid, list or sample over any scenario keys into one labelled dataset (--out FILE.nc or FILE.zarr).

    The dataset is the same to the last bit whoever computes it: this process, --workers processes, or a Dask cluster's.
    """
    from functools import partial

    from experiments.chain.executor import ClusterExecutor, Executor, ProcessExecutor
    from experiments.studies.sweep import study

    if options.out is None:
        raise click.UsageError("sweep: give --out FILE.nc or FILE.zarr")
    if workers is not None and scheduler is not None:
        raise click.UsageError("sweep: give --workers or --scheduler, not both")
    overrides = options.overrides if options.seed is None else (*options.overrides, f"seed={options.seed}")
    cases = study.load_sweep(plan, overrides)
    executor: Callable[[], Executor] | None = None
    if scheduler is not None:
        executor = partial(ClusterExecutor, scheduler)
    else:
        announce_variant(options)
        executor = partial(ProcessExecutor, workers) if workers is not None else None
    try:
        outcome = with_progress(
            options, lambda tell: study.run_sweep(cases, options.out, resume=resume, executor=executor, progress=tell)
        )
    except (ImportError, RuntimeError) as error:
        raise EnvironmentLacking(str(error)) from error
    rendered = (
        f"{outcome.rendered} geometries rendered" if outcome.rendered else "nothing rendered, all transport was cached"
    )
    failed = f"; {outcome.failed} could not be computed, see `reason`" if outcome.failed else ""
    options.say(f"{len(cases.scenarios)} cases, {outcome.computed} computed now, {rendered}{failed}: {options.out}")
    options.emit(
        {
            "out": options.out,
            "cases": len(cases.scenarios),
            "computed": outcome.computed,
            "rendered": outcome.rendered,
            "failed": outcome.failed,
        }
    )


@click.command()
@click.option("--clear", is_flag=True, help="Remove every cached basis.")
@shared_options
def cache(options: Options, clear: bool) -> None:
    """Show, or --clear, the cache of rendered transport."""
    from scenes.files.cache import TransportCache, default_folder

    store = TransportCache(default_folder())
    sizes = [size for _, size in store.entries()]
    if clear:
        options.say(f"{store.clear()} bases removed from {store.folder}")
    else:
        options.say(
            f"{len(sizes)} bases, {sum(sizes) / 2**20:.1f} of at most {store.limit_bytes / 2**20:.0f} MiB: {store.folder}"
        )
    options.emit({"folder": store.folder, "bases": 0 if clear else len(sizes), "bytes": 0 if clear else sum(sizes)})


@click.command()
@click.argument("results", metavar="RESULTS", type=click.Path(path_type=Path))
@click.option("--x", required=True, help="Dimension along the axis, say range_m.")
@click.option("--y", required=True, help="Variable to draw, say cnr: closed form and rendered.")
@click.option("--hue", help="Dimension that separates the lines, say exposure_s.")
@click.option("--select", multiple=True, metavar="DIM=VALUE", help="Fix another dimension; default its first value.")
@shared_options
def plot(options: Options, results: Path, x: str, y: str, hue: str | None, select: tuple[str, ...]) -> None:
    """Draw a slice of a results file into --out FILE (.svg, .png or .pdf)."""
    from experiments.studies.sweep.plot import draw_slice

    if options.out is None:
        raise click.UsageError("plot: give --out FILE.svg")
    fixed = draw_slice(results, x, y, hue, select, options.out)
    where = f" at {', '.join(f'{k} = {v}' for k, v in fixed.items())}" if fixed else ""
    options.say(f"{y} over {x}{where}: {options.out}")
    options.emit({"out": options.out, "fixed": fixed})


validate = study_verb(
    StudyVerb(
        name="validate",
        package="experiments.studies.validate",
        help="Closed form against rendering over range, marker size, tilt, illumination and sensor, with an error budget and "
        "cross-checks.\n\nSCENARIO gives camera, LEDs and materials. Takes some ten minutes in full on two idle cores.",
        quick="16 geometries instead of 180: a first look within a minute.",
        require={"agrees": "every cell and every cross-check agree"},
    )
)


close = study_verb(
    StudyVerb(
        name="close",
        package="experiments.studies.close",
        help="Find the parameter sets that close the whole range, confirm them by rendering, and say what the margin depends on."
        "\n\n--set KEY=VALUE changes the scenario, --set close.KEY=VALUE the constraints.",
        source="CONSTRAINTS.toml",
        load="experiments.studies.close.constraints.load_problem",
        quick="Fewer worlds, and two sets confirmed at three ranges: within a minute.",
        workers=True,
        require={"closes": "a set closes and is confirmed"},
        plan=(PlanOption("--no-render", "render", bool, "The closed form alone, nothing confirmed.", value=False),),
    )
)


glare = study_verb(
    StudyVerb(
        name="glare",
        package="experiments.studies.glare",
        help="Detection and pose over the Sun's direction and range, counter-measure by counter-measure.\n\n"
        "Takes some ten minutes in full on two idle cores.",
        quick="One range, four phase angles: a first look within a minute.",
        workers=True,
        require={"pair": "the on/off pair meets the requirement"},
        plan=(
            PlanOption(
                "--draws",
                "draws",
                click.IntRange(1),
                "Noise draws of each geometry and mode; 8 give ± 2 %, the default.",
            ),
        ),
    )
)


VERBS: tuple[click.Command, ...] = (sweep, cache, plot, validate, close, glare, features, calibrate)
