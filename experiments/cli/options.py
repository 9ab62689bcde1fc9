"""What all verbs share: options, exit statuses, progress, and how a result is told."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from experiments.reporting.plain import plain

BAD_INPUT, NO_ENVIRONMENT, REQUIREMENT_NOT_MET = 2, 3, 4


class RequirementNotMet(Exception):
    """A `--require` condition that the result does not fulfil; the message says by how much."""


class EnvironmentLacking(Exception):
    """This machine cannot run the verb; the message says what to install."""


@dataclass(frozen=True)
class Options:
    """The options that every verb takes."""

    out: Path | None
    seed: int | None
    json: bool
    quiet: bool
    overrides: tuple[str, ...]

    def scenario(self, source: str | None) -> Any:
        """The scenario of a command line: file or shipped name, `--set`, then `--seed`."""
        from experiments.scenario import load_scenario

        overrides = self.overrides if self.seed is None else (*self.overrides, f"seed={self.seed}")
        return load_scenario(source, overrides)

    @property
    def interactive(self) -> bool:
        """True where a progress bar may be drawn."""
        return not self.quiet and not self.json and sys.stderr.isatty()

    def say(self, *lines: Any) -> None:
        """Print for people: nothing under --quiet or --json."""
        if not (self.quiet or self.json):
            from rich.console import Console

            # Tables need a hundred columns; where output is not a terminal its width is unknown.
            console = Console(width=None if sys.stdout.isatty() else 110, highlight=False)
            for line in lines:
                console.print(line)

    def emit(self, data: Any) -> None:
        """Print one JSON object under --json; NaN becomes null."""
        if self.json:
            import json

            click.echo(json.dumps(plain(data), indent=2, allow_nan=False))


def shared_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add --out, --seed, --json, --quiet and --set, handed over as one `Options`."""

    @click.option("--out", "-o", type=click.Path(path_type=Path), help="File or folder to write.")
    @click.option("--seed", type=click.IntRange(0), help="Seed of every random number; default the scenario's.")
    @click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
    @click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
    @click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a scenario key, say leds.count=50."
    )
    @functools.wraps(function)
    def with_options(
        *args: Any,
        out: Path | None,
        seed: int | None,
        as_json: bool,
        quiet: bool,
        overrides: tuple[str, ...],
        **kwargs: Any,
    ) -> None:
        function(Options(out, seed, as_json, quiet, overrides), *args, **kwargs)

    return with_options


def announce_variant(options: Options) -> None:
    """Choose the renderer now, so that its warning comes before the work."""
    import warnings

    from scenes.llvm import activate_variant

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            activate_variant()
        except (ImportError, RuntimeError) as error:
            raise EnvironmentLacking(f"{error}; `mantis doctor` says what to install") from error
    for warning in caught:
        if not options.quiet:
            click.echo(f"mantis: {warning.message}", err=True)


def with_progress(options: Options, work: Any) -> Any:
    """Run `work(progress)` under a bar on a terminal; elsewhere with a line on standard error now and then."""
    if options.quiet or options.json:
        return work(None)
    if not options.interactive:
        return work(_lines())
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=None)
        return work(lambda done, total, label: bar.update(task, completed=done, total=total, description=label))


#: Seconds between two lines of progress where there is no terminal.
_LINE_EVERY_S = 15.0


def _lines() -> Callable[[int, int, str], None]:
    """Progress for logs and pipes, which a bar would fill."""
    told = time.monotonic()

    def tell(done: int, total: int, label: str) -> None:
        nonlocal told
        if time.monotonic() - told >= _LINE_EVERY_S:
            told = time.monotonic()
            click.echo(f"mantis: {label}, {done} of {total} done", err=True)

    return tell


def ready_folder(folder: Path) -> None:
    """Make the folder, or say in one line why not, before anything is computed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise click.UsageError(f"--out {folder}: cannot be made a folder ({error.strerror})") from error
