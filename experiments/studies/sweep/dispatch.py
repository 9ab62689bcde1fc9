"""Hands tasks to workers and brings back what they give, whichever of them die on the way."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from typing import TypeVar

from experiments.chain.executor import GONE, Crew

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Items that one worker computes together.
Task = Sequence[Item]
#: Tasks of which the first leaves on disk what the others need; they follow when it is done.
Strand = Sequence[Sequence[Item]]

#: Tasks handed over for each that runs, so that no worker waits for the next.
AHEAD = 2
#: Workers that an item may kill while it runs alone; one may have died of something else.
DEATHS_ALONE = 2


def dispatch(
    strands: Sequence[Strand[Item]],
    function: Callable[[Task[Item]], Result],
    crew: Crew,
    given_up: Callable[[Item], Result],
) -> Iterator[Result]:
    """Results of every task, as they come.

    A worker that dies loses nothing: what it was at is split into single items, which go to others. An item that kills
    workers while it runs alone is given up.

    Args:
        function: of a task; importable by name. An exception that it raises ends the dispatch.
        given_up: result in place of an item that kills its workers.

    Raises:
        RuntimeError: when the workers have gone altogether.
    """
    leaders, ready, suspects = deque(strands), deque[Task[Item]](), deque[tuple[Item, int]]()
    running: dict[Future[Result], tuple[Task[Item], Strand[Item]]] = {}
    lost = False
    deaths_alone: int | None = None  # of the item that runs alone, where one does

    def start(task: Task[Item], followers: Strand[Item]) -> None:
        nonlocal lost
        try:
            running[crew.submit(function, task)] = (task, followers)
        except crew.losses:
            lost = True
            suspects.extend((item, 0) for item in task)
            ready.extend(followers)

    while leaders or ready or suspects or running or lost:
        if not running:
            if lost:
                crew.recover()
            lost, deaths_alone = False, None
            if suspects:
                item, deaths_alone = suspects.popleft()
                start([item], ())
        while not (suspects or deaths_alone is not None) and len(running) < AHEAD * crew.width() and (ready or leaders):
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
            except crew.losses:
                lost = True
                if deaths_alone is None:
                    suspects.extend((item, 0) for item in task)
                elif deaths_alone + 1 < DEATHS_ALONE:
                    suspects.append((task[0], deaths_alone + 1))
                else:
                    yield given_up(task[0])
            except CancelledError:
                raise RuntimeError(GONE) from None
