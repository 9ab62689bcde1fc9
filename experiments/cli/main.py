"""The `mantis` command: entry point, options that all verbs share, and how errors are told.

Exit status: 0 done, 2 bad input, 3 the environment cannot run it, 4 a `--require` condition was not met.
Verbs live in `experiments.cli.verbs`; they import what is heavy only when they run.
"""

from __future__ import annotations

import sys

import click

from experiments.cli.options import (
    BAD_INPUT,
    NO_ENVIRONMENT,
    REQUIREMENT_NOT_MET,
    EnvironmentLacking,
    RequirementNotMet,
)

#: Verbs by what they are for, in the order of the help text; those not named here follow under a heading of their own.
_GROUPS = {
    "Begin": ("doctor", "new", "presets", "budget", "explore"),
    "The chain by files": ("render", "expose", "detect", "calibrate", "marker", "materials", "sensor", "schema"),
    "Studies": ("close", "glare", "validate", "features", "virtual", "sweep", "plot", "cache"),
    "The thesis, recomputed": (
        "errata",
        "montecarlo",
        "tradeoff",
        "fov",
        "layout",
        "power",
        "comparison",
        "requirements",
        "physical",
        "risk",
    ),
}


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
    from experiments.cli.verbs import stages, studies, thesis, tools

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
    from experiments.cli.main import main as imported_main  # the verbs raise that module's exceptions, not `__main__`'s

    sys.exit(imported_main())
