"""Hands tasks to workers and brings back their results, whichever workers die on the way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from typing import TypeVar

from experiments.chain.executor import GONE, Executor

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Items that one worker computes together.
Task = Sequence[Item]
#: Tasks of which the first leaves on disk what the others need; they follow when it is done.
TaskGroup = Sequence[Sequence[Item]]

#: Tasks handed over for each that runs, so that no worker waits for the next.
AHEAD = 2
#: Workers that an item may kill while it runs alone; one may have died of something else.
DEATHS_ALONE = 2


def dispatch(
    groups: Sequence[TaskGroup[Item]],
    function: Callable[[Task[Item]], Result],
    executor: Executor,
    given_up: Callable[[Item], Result],
) -> Iterator[Result]:
    """Results of every task, as they come.

    A worker that dies loses nothing: the items of its task are quarantined, that is, each runs alone in another worker. An item
    that kills workers while it runs alone is given up.

    Args:
        groups: tasks, by what they share.
        function: of a task; importable by name. An exception that it raises ends the dispatch.
        executor: runs the tasks.
        given_up: result in place of an item that kills its workers.

    Raises:
        RuntimeError: when the workers have gone altogether.
    """
    leaders, ready, quarantined = deque(groups), deque[Task[Item]](), deque[tuple[Item, int]]()
    running: dict[Future[Result], tuple[Task[Item], TaskGroup[Item]]] = {}
    lost = False
    deaths_alone: int | None = None  # of the item that runs alone, where one does

    def start(task: Task[Item], followers: TaskGroup[Item]) -> None:
        nonlocal lost
        try:
            running[executor.submit(function, task)] = (task, followers)
        except executor.losses:
            lost = True
            quarantined.extend((item, 0) for item in task)
            ready.extend(followers)

    while leaders or ready or quarantined or running or lost:
        if not running:
            if lost:
                executor.recover()
            lost, deaths_alone = False, None
            if quarantined:
                item, deaths_alone = quarantined.popleft()
                start([item], ())
        while (
            not (quarantined or deaths_alone is not None)
            and len(running) < AHEAD * executor.width()
            and (ready or leaders)
        ):
            if ready:
                start(ready.popleft(), ())
            else:
                first, *others = leaders.popleft()
                start(first, others)
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            task, followers = running.pop(future)
            ready.extend(followers)
            try:
                yield future.result()
            except executor.losses:
                lost = True
                if deaths_alone is None:
                    quarantined.extend((item, 0) for item in task)
                elif deaths_alone + 1 < DEATHS_ALONE:
                    quarantined.append((task[0], deaths_alone + 1))
                else:
                    yield given_up(task[0])
            except CancelledError:
                raise RuntimeError(GONE) from None
