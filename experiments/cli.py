"""The `mantis` command: entry point, options that all verbs share, and how errors are told.

Exit status: 0 done, 2 bad input, 3 the environment cannot run it, 4 a `--require` condition was not met.
Verbs live in `experiments.verbs`; they import what is heavy only when they run.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

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


def plain(value: Any) -> Any:
    """Numbers, lists and strings of JSON for numpy arrays, paths and NaN."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return str(value) if isinstance(value, Path) else value


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


#: Verbs by what they are for, in the order of the help text; those not named here follow under a heading of their own.
_GROUPS = {
    "Begin": ("doctor", "new", "presets", "budget", "explore"),
    "The chain by files": ("render", "expose", "detect", "calibrate", "marker", "materials", "sensor", "schema"),
    "Studies": ("close", "glare", "validate", "features", "virtual", "sweep", "plot", "cache"),
    "The thesis, recomputed": ("errata", "montecarlo", "tradeoff", "fov", "layout", "power", "comparison", "requirements",
                             "physical", "risk"),
}  # fmt: skip


class Verbs(click.Group):
    """Lists the verbs by what they are for, each with its first sentence in full."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the headings and the verbs below them."""
        named = {name for names in _GROUPS.values() for name in names}
        groups = {**_GROUPS, "More": tuple(name for name in sorted(self.commands) if name not in named)}
        for heading, names in groups.items():
            rows = [(name, self.commands[name].get_short_help_str(200)) for name in names if name in self.commands]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)


@click.group(
    cls=Verbs, no_args_is_help=False, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(package_name="mantis-radiometry", prog_name="mantis")
def mantis() -> None:
    """Does the optical navigation budget close, and if not, what must change?

    Renders a Mantis Marker on a debris face in the light of an LED ring and the Sun, exposes a camera to it, finds the marker
    and its pose, and holds the result against the closed-form budget.
    """


def with_verbs() -> click.Group:
    """The command with all its verbs."""
    from experiments.verbs import stages, studies, thesis, tools

    for verb in (*stages.VERBS, *studies.VERBS, *thesis.VERBS, *tools.VERBS):
        mantis.add_command(verb)
    return mantis


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return the exit status; errors are one line on standard error."""
    with_verbs()
    try:
        # Without a word it says what there is, rather than that a verb is missing.
        mantis.main((sys.argv[1:] if arguments is None else arguments) or ["--help"], "mantis", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        return _complain(error.format_message(), BAD_INPUT)
    except RequirementNotMet as error:
        return _complain(f"required: {error}", REQUIREMENT_NOT_MET)
    except EnvironmentLacking as error:
        return _complain(str(error), NO_ENVIRONMENT)
    except (ValueError, OSError) as error:
        return _complain(_one_line(error), BAD_INPUT)
    except (KeyboardInterrupt, click.Abort):
        return _complain("interrupted; nothing half-written was left", 130)
    return 0


def _one_line(error: Exception) -> str:
    text = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())


def _complain(message: str, status: int) -> int:
    click.echo(f"mantis: {message}", err=True)
    return status


if __name__ == "__main__":
    from experiments.cli import main as imported_main  # the verbs raise that module's exceptions, not `__main__`'s

    sys.exit(imported_main())
