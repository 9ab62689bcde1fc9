"""Every item comes back once, whichever workers die."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.studies.sweep.dispatch import AHEAD, dispatch


class Died(Exception):
    pass


class Threads:
    """Two threads that stand for workers, which die of some items, and now and then of chance.

    As in a pool of processes, one that dies takes all others with it until `recover`; or, as in a cluster, it does not.
    """

    losses = (Died,)

    def __init__(self, deadly: set[int], accidents: list[bool], together: bool) -> None:
        self.deadly, self.accidents, self.together = deadly, accidents, together
        self.broken, self.lock, self.running, self.most = False, threading.Lock(), 0, 0
        self.executor = ThreadPoolExecutor(2)

    def width(self) -> int:
        return 2

    def submit(self, function, *arguments) -> Future:
        if self.broken:
            raise Died
        self.running += 1
        self.most = max(self.most, self.running)
        future = self.executor.submit(self._run, function, *arguments)
        future.add_done_callback(self._done)
        return future

    def recover(self) -> None:
        self.broken = False

    def __enter__(self):
        return self

    def __exit__(self, *error: object) -> None:
        self.executor.shutdown()

    def _done(self, future: Future) -> None:
        with self.lock:
            self.running -= 1

    def _run(self, function, task: Sequence[int]):
        with self.lock:
            accident = len(task) > 1 and self.accidents and self.accidents.pop()
            if self.broken or accident or self.deadly & set(task):
                self.broken = self.together
                raise Died
        return function(task)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    sizes=st.lists(st.lists(st.integers(1, 4), min_size=1, max_size=3), max_size=6),
    deadly=st.sets(st.integers(0, 40), max_size=3),
    accidents=st.lists(st.booleans(), max_size=6),
    together=st.booleans(),
)
def test_nothing_is_lost_and_nothing_repeated(
    sizes: list[list[int]], deadly: set[int], accidents: list[bool], together: bool
) -> None:
    """Expected: every item comes back once; those that kill their worker, and no others, are given up."""
    numbers = iter(range(100))
    groups = [[[next(numbers) for _ in range(size)] for size in group] for group in sizes]
    count = next(numbers)
    with Threads(deadly, accidents, together) as executor:
        results = list(
            dispatch(groups, lambda task: [(k, "done") for k in task], executor, lambda k: [(k, "given up")])
        )
    assert sorted(item for result in results for item in result) == [
        (k, "given up" if k in deadly else "done") for k in range(count)
    ]


def test_followers_wait_for_their_leader_and_few_tasks_are_handed_over() -> None:
    order: list[int] = []
    groups = [[[10 * k], [10 * k + 1], [10 * k + 2]] for k in range(8)]

    def work(task: list[int]) -> list[int]:
        order.extend(task)
        return task

    with Threads(set(), [], True) as executor:
        list(dispatch(groups, work, executor, lambda k: []))
        assert executor.most <= AHEAD * 2
    for leader, *followers in ([task[0] for task in group] for group in groups):
        assert all(order.index(leader) < order.index(follower) for follower in followers)


def test_workers_that_have_all_gone_end_the_dispatch() -> None:
    class Gone(Threads):
        def submit(self, function, *arguments) -> Future:
            future: Future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    with Gone(set(), [], True) as executor, pytest.raises(RuntimeError, match="--resume"):
        list(dispatch([[[1]]], lambda task: task, executor, lambda k: []))


def test_an_exception_of_the_function_ends_the_dispatch() -> None:
    def fail(task: list[int]) -> list[int]:
        raise KeyError("not a loss")

    with Threads(set(), [], False) as executor, pytest.raises(KeyError):
        list(dispatch([[[1]]], fail, executor, lambda k: []))
