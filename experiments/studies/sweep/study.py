"""Sweeps: any scenario keys over a grid, a list or a quasi-random sample, into one labelled dataset.

Cases that share their transport share one rendering, kept in the cache. Finished cases are journalled, so that an interrupted
sweep goes on where it stopped, and its result is the same to the last bit, whoever computed it: this process, others on this
machine, or a cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import xarray as xr

from experiments.chain.executor import Executor
from experiments.chain.progress import Progress
from experiments.studies.sweep.dataset import make_dataset, write_dataset
from experiments.studies.sweep.dispatch import dispatch
from experiments.studies.sweep.journal import Journal
from experiments.studies.sweep.plan import Sweep, SweepPlan, load_sweep
from experiments.studies.sweep.work import Case, Done, by_illumination, compute, compute_task, software, transport_key

__all__ = ["Outcome", "Sweep", "SweepPlan", "load_sweep", "run_sweep"]

#: Frames of one task: some seconds of work, so that handing it over costs nothing and losing it little.
TASK_FRAMES = 256


@dataclass(frozen=True)
class Outcome:
    """What a sweep gave.

    Attributes:
        dataset: the result, as written.
        rendered: geometries that had to be rendered.
        computed: cases that were computed now.
        failed: cases that could not be computed; `reason` says why.
    """

    dataset: xr.Dataset
    rendered: int
    computed: int
    failed: int


def run_sweep(
    sweep: Sweep,
    out: Path,
    *,
    resume: bool = False,
    executor: Callable[[], Executor] | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Compute every case that the journal beside `out` does not hold yet, and write the dataset to `out`.

    Args:
        sweep: the cases.
        out: NetCDF, or Zarr where it ends in .zarr.
        resume: go on with an interrupted sweep; without it an unfinished journal is refused.
        executor: makes the workers (`experiments.chain.executor`); without one this process computes. The result does not
            depend on them.
        progress: called with the finished cases.

    Raises:
        ValueError: when there is a journal of another sweep, or of this one and `resume` is not set.
        OSError: when journal or dataset cannot be written; what is journalled by then is kept.
        OtherSoftware: when a worker runs another version.
        RuntimeError: when all workers have gone.
    """
    journal = Journal(out.with_name(out.name + ".journal"), f"{sweep.digest()} {software()}")
    records = journal.open(resume)
    try:
        todo = [(i, scenario) for i, scenario in enumerate(sweep.scenarios) if i not in records]
        rendered = 0
        for done in _computed(todo, executor):
            journal.append([(index, record) for index, record, _ in done])
            records.update({index: record for index, record, _ in done})
            rendered += sum(count for *_, count in done)
            if progress:
                progress(len(records), len(sweep.scenarios), "sweeping")
        ordered = [records[i] for i in range(len(records))]
        dataset = make_dataset(sweep, ordered)
        write_dataset(dataset, out)
        journal.remove()
    finally:
        journal.close()
    return Outcome(dataset, rendered, len(todo), sum("values" not in record for record in ordered))


def _computed(cases: list[Case], executor: Callable[[], Executor] | None) -> Iterator[list[Done]]:
    """Results as they come."""
    if executor is None or not cases:
        yield from ([done] for done in compute(cases))
        return
    with executor() as workers:
        groups = _task_groups(cases, workers.width())
        yield from dispatch(groups, partial(compute_task, expected=software()), workers, _given_up)


def _task_groups(cases: list[Case], workers: int) -> list[list[list[Case]]]:
    """Tasks by geometry. The first one of a geometry goes alone, for it renders; the others read what it left.

    Geometries of few cases share a task.
    """
    most = max(1, min(TASK_FRAMES // cases[0][1].budget.trials, len(cases) // (4 * workers)))
    geometries: dict[str, list[Case]] = {}
    for index, scenario in cases:
        geometries.setdefault(transport_key(scenario), []).append((index, scenario))
    groups: list[list[list[Case]]] = []
    small: list[Case] = []
    for members in geometries.values():
        if len(members) > most // 2:
            ordered = [case for alike in by_illumination(members) for case in alike]
            groups.append([ordered[i : i + most] for i in range(0, len(ordered), most)])
            continue
        small += members
        if len(small) > most // 2:
            groups.append([small])
            small = []
    return [*groups, *([[small]] if small else [])]


def _given_up(case: Case) -> list[Done]:
    index, _ = case
    return [
        (index, {"reason": "the worker died each time that it computed this case: killed, crashed or out of memory"}, 0)
    ]
