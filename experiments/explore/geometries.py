"""Rendered geometries kept ready for the page: another process prepares them, and memory keeps what was prepared.

Preparing a geometry takes a second or two. The page asks for one geometry at a time and is told at once whether it is ready.
While the page asks for nothing, the values next to the present one are prepared on every control, nearest first.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

from experiments import chain
from experiments.chain.executor import Executor
from experiments.scenario import Scenario
from radiometry.geometry import FloatArray
from scenes.files.cache import TransportCache, default_folder

LIGHTS = tuple(chain.SOURCES)
#: Bytes of prepared frames kept in memory; the least recently used make room.
LIMIT_BYTES = 2**30


@dataclass(frozen=True)
class Budgets:
    """The closed-form budget of one geometry by illumination."""

    by_illumination: dict[str, chain.LinkBudget]

    def scaled(self, drive: float) -> Budgets:
        """With the LEDs' light times a factor; the Sun's is what is left without them."""
        if drive == 1:
            return self
        dark = self.by_illumination["eclipse"]
        return Budgets(
            {
                illumination: replace(
                    budget,
                    signal_rate=budget.signal_rate + (drive - 1) * dark.signal_rate,
                    background_rate=budget.background_rate + (drive - 1) * dark.background_rate,
                    tape_rate=budget.tape_rate + (drive - 1) * dark.tape_rate,
                )
                for illumination, budget in self.by_illumination.items()
            }
        )


@dataclass(frozen=True)
class Prepared:
    """One rendered geometry: electron rates (H, W) [e⁻/s] and closed-form budgets, by illumination."""

    rates: dict[str, FloatArray]
    budgets: Budgets

    @property
    def size_bytes(self) -> int:
        """Memory that it takes."""
        return sum(rate.nbytes for rate in self.rates.values())

    def rate(self, illumination: str, drive: float) -> FloatArray:
        """Electron rates with the LEDs' light times a factor, (H, W) [e⁻/s]."""
        whole = self.rates[illumination]
        return whole if drive == 1 else whole + (drive - 1) * self.rates["eclipse"]


def prepare(scenario: Scenario) -> Prepared:
    """Transport, from the cache or rendered, as electron rates in both illuminations, and the closed form beside it."""
    basis = next(chain.transports([scenario], TransportCache(default_folder())))
    rates = {illumination: chain.electron_rate(scenario, basis, illumination) for illumination in LIGHTS}
    budgets = {
        illumination: chain.link_budget_beside(scenario, illumination, rates[illumination]) for illumination in LIGHTS
    }
    return Prepared(rates, Budgets(budgets))


def closed_form(scenario: Scenario) -> Budgets:
    """The closed form of one geometry in both illuminations, without rendering."""
    return Budgets({illumination: chain.link_budget(scenario, illumination) for illumination in LIGHTS})


def _aside(function: Callable[[Scenario], Any], scenario: Scenario) -> Any:
    """Run in a worker, after whatever the page itself computes."""
    with suppress(OSError, AttributeError):  # not every system has priorities
        os.setpriority(os.PRIO_PROCESS, 0, 4)
    return function(scenario)


#: Names a geometry within one store.
Key = Hashable


@dataclass(frozen=True)
class Task:
    """Something to prepare.

    Attributes:
        key: of the geometry.
        frame: False for the closed form alone.
        what: for people.
        make: gives the scenario when it is due; may raise ValueError.
    """

    key: Key
    frame: bool
    what: str
    make: Callable[[], Scenario]


class GeometryStore:
    """Prepared geometries, and a thread that has more prepared; a context manager that ends both.

    Args:
        executor: where the work is done; it is ended with the store.
        limit_bytes: of prepared frames in memory.
    """

    def __init__(self, executor: Executor, limit_bytes: int = LIMIT_BYTES) -> None:
        self._executor, self._limit = executor, limit_bytes
        self._frames: OrderedDict[Key, Prepared] = OrderedDict()
        self._budgets: dict[Key, Budgets] = {}
        self._failed: dict[Key, str] = {}
        self._plan: Iterator[Task] = iter(())
        self._present: Key = None
        self._planned_bytes = 0
        self._condition = threading.Condition()
        self._closed, self.doing = False, ""
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> GeometryStore:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._executor.__exit__(KeyboardInterrupt, None, None)  # a running task is of no use any more
        self._thread.join(timeout=30)

    def want(self, present: Key, plan: Callable[[], Iterator[Task]]) -> None:
        """Prepare what a plan says, in its order, instead of what is left of the one before; for the same geometry: go on.

        Frames are prepared until the memory is full of those of this plan.
        """
        with self._condition:
            if present != self._present:
                self._plan, self._present, self._planned_bytes = plan(), present, 0
                self._condition.notify_all()

    def frame(self, key: Key) -> Prepared | None:
        """A prepared geometry; None while it is not.

        Raises:
            ValueError: when it cannot be prepared, with the reason.
        """
        with self._condition:
            if key in self._failed:
                raise ValueError(self._failed[key])
            found = self._frames.get(key)
            if found is not None:
                self._frames.move_to_end(key)
            return found

    def budgets(self, key: Key) -> Budgets | None:
        """The closed form of a geometry, if it has been computed."""
        return self._budgets.get(key)

    def ready(self, key: Key) -> bool:
        """True where a frame is prepared."""
        return key in self._frames

    def _work(self) -> None:
        while (task := self._next()) is not None:
            try:
                work = prepare if task.frame else closed_form
                found = self._executor.submit(_aside, work, task.make()).result()
            except self._executor.losses:
                if self._closed:
                    return
                self._executor.recover()
                self._note(task.key, None, "the process that renders has died; `mantis doctor` may say why")
            except (
                Exception
            ) as error:  # told to whoever asks for it, so that one impossible geometry does not end the page
                self._note(task.key, None, " ".join(str(error).split()) or type(error).__name__)
            else:
                self._note(task.key, found, "")

    def _next(self) -> Task | None:
        """The plan's next task that is not done, as soon as there is one; None when the store is closed."""
        with self._condition:
            while not self._closed:
                task = next(self._plan, None)
                if task is None:
                    self.doing = ""
                    self._condition.wait()
                elif not self._done(task):
                    self.doing = task.what
                    return task
        return None

    def _done(self, task: Task) -> bool:
        """Whether nothing is left to do, or no memory to do it in."""
        if task.key in self._failed:
            return True
        if not task.frame:
            return task.key in self._budgets
        if task.key in self._frames:
            self._frames.move_to_end(task.key)
            self._planned_bytes += self._frames[task.key].size_bytes
            return True
        return self._planned_bytes > self._limit

    def _note(self, key: Key, found: Prepared | Budgets | None, reason: str) -> None:
        with self._condition:
            if found is None:
                self._failed[key] = reason
            elif isinstance(found, Prepared):
                self._frames[key] = found
                self._budgets[key] = found.budgets
                self._planned_bytes += found.size_bytes
                while sum(f.size_bytes for f in self._frames.values()) > self._limit and len(self._frames) > 1:
                    self._frames.popitem(last=False)
            else:
                self._budgets[key] = found
