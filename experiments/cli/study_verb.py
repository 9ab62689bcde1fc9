"""The one factory of the verbs that run a study: plan, run, page, files, terminal, `--json`, `--require`.

A study is a package with `plan.Plan` (and `plan.FULL`, `plan.QUICK`), `study.run(scenario, plan, progress)` and
`page.page(result, command)`, which gives an `experiments.reporting.page.Page`. Nothing of it is imported before its verb runs.

A study whose `--require` takes free text has `requirement.parse(text, scenario)`, which is called before anything is computed and
raises a ValueError for what is no condition, and `requirement.unmet(condition, result)`, which says why it is not met, if so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from shutil import rmtree
from typing import Any

import click

from experiments.cli.options import (
    Options,
    RequirementNotMet,
    announce_variant,
    ready_folder,
    shared_options,
    with_progress,
)


@dataclass(frozen=True)
class PlanOption:
    """A command-line option that replaces one field of the study's plan.

    Attributes:
        flag: as typed, say ``--draws``.
        field: of the plan.
        kind: click's type.
        help: one line.
        multiple: whether it may be given many times; the field is then a tuple.
        value: what the field becomes, for an option without a value of its own; `kind` is then not used.
    """

    flag: str
    field: str
    kind: Any
    help: str
    multiple: bool = False
    value: Any = None

    @property
    def option(self) -> Callable[..., Any]:
        """The option as click has it."""
        if self.value is not None:
            return click.option(self.flag, self.field, flag_value=self.value, default=None, help=self.help)
        return click.option(self.flag, self.field, type=self.kind, multiple=self.multiple, help=self.help)

    def typed(self, value: Any) -> list[str]:
        """The option as typed for a value of the field."""
        if self.value is not None:
            return [self.flag]
        values = value if self.multiple else [value]
        return [f"{self.flag} {one:g}" if isinstance(one, float) else f"{self.flag} {one}" for one in values]


@dataclass(frozen=True)
class StudyVerb:
    """What the factory needs to know of a study.

    Attributes:
        name: of the verb.
        package: of the study, say ``experiments.studies.glare``.
        help: of the verb: what it does, how long it takes, what it writes.
        source: the metavar of the argument that names the scenario; empty where the study has a scenario of its own.
        load: dotted path of a function that gives what the study runs on; empty for `Options.scenario`. It is called with
            (source, overrides, seed) where there is a `source`, with (overrides, seed) for a study with a scenario of its own.
        fixed: why `--set` has nothing to change; empty where it has.
        quick: what `--quick` does; empty where there is no such option.
        renders: whether it needs the renderer. Where the plan has a field `render`, that must be true as well.
        workers: whether it can use several processes.
        require: conditions of `--require`, each with what it asks.
        condition: what `--require` takes where it is free text; see above.
        writes: what the run itself writes into the folder as it goes, because memory should not hold all of it; empty for
            nothing. Its `run` takes the folder as `out`.
        resume: what `--resume` does; empty where there is no such option. The study's `run` then takes `kept`, a folder for
            finished parts, which are not run again; it is emptied first without `--resume`, and taken away once all is written.
        plan: options that change the plan.
    """

    name: str
    package: str
    help: str
    source: str = "SCENARIO"
    load: str = ""
    fixed: str = ""
    quick: str = ""
    renders: bool = True
    workers: bool = False
    require: Mapping[str, str] | None = None
    condition: str = ""
    writes: str = ""
    resume: str = ""
    plan: Sequence[PlanOption] = ()


def study_verb(study: StudyVerb) -> click.Command:
    """The click command of a study."""

    @shared_options
    def run(options: Options, source: str | None = None, **given: Any) -> None:
        _run(study, options, source, given)

    more = f", and {study.writes}," if study.writes else ""
    run.__doc__ = (
        f"{study.help}\n\nWrites report.html, the page in Markdown, data and figures{more} into the folder --out (default "
        f"out/{study.name})."
    )
    command: Callable[..., Any] = run
    for option in reversed(_options(study)):
        command = option(command)
    return click.command(study.name)(command)


def _options(study: StudyVerb) -> list[Callable[..., Any]]:
    found: list[Callable[..., Any]] = []
    if study.source:
        found.append(click.argument("source", metavar=f"[{study.source}]", required=False))
    if study.quick:
        found.append(click.option("--quick", is_flag=True, help=study.quick))
    for o in study.plan:
        found.append(o.option)
    if study.workers:
        found.append(
            click.option(
                "--workers", type=click.IntRange(0), help="Processes beside this one; 0 is none, default one a core."
            )
        )
    if study.resume:
        found.append(click.option("--resume", is_flag=True, help=study.resume))
    if study.require:
        asks = "; ".join(f"{name}: {what}" for name, what in study.require.items())
        found.append(
            click.option("--require", type=click.Choice(list(study.require)), help=f"Exit status 4 unless met. {asks}.")
        )
    if study.condition:
        found.append(
            click.option(
                "--require", metavar="CONDITION", help=f"{study.condition}; exit status 4 where it is not met."
            )
        )
    return found


def _run(study: StudyVerb, options: Options, source: str | None, given: dict[str, Any]) -> None:
    quick, workers, require = given.pop("quick", False), given.pop("workers", None), given.pop("require", None)
    resume = given.pop("resume", False)
    changes = {field: value for field, value in given.items() if value not in (None, ())}
    if study.fixed and options.overrides:
        raise click.UsageError(f"{study.name}: {study.fixed}, so --set has nothing to change")
    plans, runs = import_module(f"{study.package}.plan"), import_module(f"{study.package}.study")
    plan = replace(plans.QUICK if quick else plans.FULL, **changes)
    scenario = _scenario(study, options, source)
    requirement = import_module(f"{study.package}.requirement") if study.condition and require else None
    condition = requirement.parse(require, scenario) if requirement else None
    out = options.out or Path("out") / study.name
    with _folder(out):
        if study.renders and getattr(plan, "render", True):
            announce_variant(options)
        how: dict[str, Any] = {"workers": workers} if study.workers else {}
        if study.writes:
            how["out"] = out
        kept = out / "runs"
        if study.resume:
            how["kept"] = kept
            if not resume:
                rmtree(kept, ignore_errors=True)
        result = with_progress(options, lambda tell: runs.run(scenario, plan, tell, **how))
        page = import_module(f"{study.package}.page").page(result, _command(study, options, source, quick, changes))
        page.write(out)
        if study.resume:
            rmtree(kept, ignore_errors=True)
    options.say(*page.terminal(), f"Report and data: {out / 'report.html'}")
    options.emit({**page.record(), "out": out})
    short = requirement.unmet(condition, result) if requirement else page.unmet.get(require or "", "")
    if short:
        raise RequirementNotMet(short)


@contextmanager
def _folder(out: Path) -> Iterator[None]:
    """Make the folder before anything is computed; where the work fails and wrote nothing, take it away again."""
    there = out.exists()
    ready_folder(out)
    try:
        yield
    except BaseException:
        if not there:
            with suppress(OSError):  # it is not empty
                out.rmdir()
        raise


def _scenario(study: StudyVerb, options: Options, source: str | None) -> Any:
    if not study.load:
        return options.scenario(source)
    module, _, function = study.load.rpartition(".")
    sources = (source,) if study.source else ()
    return getattr(import_module(module), function)(*sources, options.overrides, options.seed)


def _command(study: StudyVerb, options: Options, source: str | None, quick: bool, changes: dict[str, Any]) -> str:
    """The command line that makes the page again, without its folder."""
    words = [f"mantis {study.name}", *([source] if source else []), *(["--quick"] if quick else [])]
    for o in study.plan:
        words += o.typed(changes[o.field]) if o.field in changes else []
    words += [f"--set {override}" for override in options.overrides]
    words += [f"--seed {options.seed}"] if options.seed is not None else []
    return " ".join(words)
