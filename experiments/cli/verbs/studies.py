"""The verbs of the studies over many scenarios."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from experiments.cli.options import (
    EnvironmentLacking,
    Options,
    RequirementNotMet,
    announce_variant,
    shared_options,
    with_progress,
)
from experiments.cli.study_verb import StudyVerb, study_verb
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


@click.command()
@click.argument("constraints", metavar="[CONSTRAINTS.toml]", required=False, type=click.Path(path_type=Path))
@click.option("--quick", is_flag=True, help="Fewer worlds, and two sets confirmed at three ranges: within a minute.")
@click.option("--no-render", is_flag=True, help="The closed form alone, nothing confirmed.")
@click.option("--require", type=click.Choice(["closes"]), help="Exit status 4 where no set closes and is confirmed.")
@click.option("--workers", type=click.IntRange(1), help="Processes for the noise draws; default one a core.")
@shared_options
def close(
    options: Options, constraints: Path | None, quick: bool, no_render: bool, require: str | None, workers: int | None
) -> None:
    """Find the parameter sets that close the whole range, confirm them by rendering, and say what the margin hangs on.

    Writes report.html, closure.md, figures and tables into the folder --out (default out/close). --set KEY=VALUE changes the
    scenario, --set close.KEY=VALUE the constraints.
    """
    from experiments.reporting.terminal import plain_table
    from experiments.studies.close import confirm as close_confirm
    from experiments.studies.close import page as close_page
    from experiments.studies.close import report as close_report
    from experiments.studies.close import study
    from experiments.studies.close.constraints import load_constraints

    limits, base = load_constraints(constraints, options.overrides, options.seed)
    out, limits = options.out or Path("out/close"), study.quick(limits) if quick else limits
    found = study.study(limits, base, study.QUICK_DRAWS if quick else study.DRAWS)
    every = found.to_confirm
    chosen = (every[:1] + every[-1:] if len(every) > 1 else every) if quick else every
    records = []
    if chosen and not no_render:
        announce_variant(options)
        records = with_progress(options, lambda tell: close_confirm.confirm(chosen, limits, tell, workers))
    command = " ".join(["mantis close", *([str(constraints)] if constraints else []), *(["--quick"] if quick else [])])
    close_report.write(found, records, out, command + "".join(f" --set {o}" for o in options.overrides))
    confirmed = close_confirm.summarise(records)
    options.say(close_page.headline(found, confirmed))
    if found.lead is not None:
        for title, rows in (
            ("Sets that close", close_page.proposed_rows(found, confirmed)),
            ("The thesis's hardware", close_page.hardware_rows(found)),
        ):
            options.say(plain_table(title, *rows))
        said = close_page.words(found, confirmed)
        options.say(*(f"→ {close_page.plain(said[key])}" for key in ("binds", "sensitivity", "chance", "hardware")))
    options.say(f"Report: {out / 'report.html'}   Page: {out / 'closure.md'}")
    options.emit(close_page.as_json(found, confirmed))
    if require and not any(c.confirmed for c in confirmed):
        raise RequirementNotMet(close_page.headline(found, confirmed))


@click.command()
@click.argument("scenario", required=False)
@click.option("--quick", is_flag=True, help="One range, four phase angles: a first look within a minute.")
@click.option(
    "--draws", type=click.IntRange(1), help="Noise draws of each geometry and mode; 8 give ± 2 %, the default."
)
@click.option(
    "--workers", type=click.IntRange(0), help="Processes beside the renderer's; 0 is none, default one a core."
)
@click.option(
    "--require", type=click.Choice(["pair"]), help="Exit status 4 where the on/off pair misses the requirement."
)
@shared_options
def glare(
    options: Options, scenario: str | None, quick: bool, draws: int | None, workers: int | None, require: str | None
) -> None:
    """Detection and pose over the Sun's direction and range, counter-measure by counter-measure.

    Takes some ten minutes in full on two idle cores. Writes report.html, glare.md, figures and data into the folder --out
    (default out/glare).
    """
    from experiments.reporting.terminal import plain_table
    from experiments.studies.glare import report as study
    from experiments.studies.glare.tables import HEADINGS, TERMINAL, mode_rows, verdicts

    chosen, out = options.scenario(scenario), options.out or Path("out/glare")
    announce_variant(options)
    result = with_progress(options, lambda tell: study.study(chosen, quick, draws, tell, workers))
    words = ["mantis glare", scenario, "--quick" if quick else None, f"--draws {draws}" if draws else None]
    words += [f"--set {override}" for override in options.overrides]
    study.write(result, out, " ".join(word for word in words if word))
    rows = mode_rows(result.summary)
    short = [[line[k] for k in TERMINAL] for line in (HEADINGS, *rows)]
    options.say(*study.findings(result), plain_table("Worst phase of each group", *short), f"Report and data: {out}")
    met = verdicts(result.summary, study.TARGET_MODE)[0]
    rows_out = [dict(zip(HEADINGS, row, strict=True)) for row in rows]
    options.emit({"headline": study.headline(result), "meets": met, "modes": rows_out, "out": out})
    if require and not met:
        raise RequirementNotMet(study.headline(result))


VERBS: tuple[click.Command, ...] = (sweep, cache, plot, validate, close, glare, features, calibrate)
