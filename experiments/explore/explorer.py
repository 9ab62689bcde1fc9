"""Behind the page: answers to a state, the scenario it stands for, and what to prepare next."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from experiments.explore import closed, controls, frame
from experiments.explore.controls import Control, State
from experiments.explore.geometries import GeometryStore, Key, Task
from experiments.scenario import Scenario
from experiments.scenario.toml import toml_text

#: Ranges at which the curve over range is computed, at most.
CURVE_POINTS = 10


class Explorer:
    """A scenario and the geometries around it, asked state by state.

    Args:
        base: the scenario that was opened.
        store: entered; where its geometries are prepared.
        reach: how many values away from the present one, on every control, are prepared unasked.
    """

    def __init__(self, base: Scenario, store: GeometryStore, reach: int = 100) -> None:
        self.base, self.controls = base, controls.controls(base)
        self._store, self._reach, self._lock = store, reach, threading.Lock()
        ranges = [float(v) for v in next(c for c in self.controls if c.key == "range_m").values]
        wanted = np.geomspace(ranges[0], ranges[-1], CURVE_POINTS)
        self._curve_ranges = sorted({min(ranges, key=lambda r: abs(r - w)) for w in wanted})

    def describe(self) -> dict[str, Any]:
        """Title and controls, as the page builds itself from them."""
        return {"title": self.base.title, "controls": [asdict(control) for control in self.controls]}

    def answer(self, query: str, *, with_frame: bool = True) -> dict[str, Any]:
        """Everything the page shows of a state; parts that are not prepared yet are None, and `pending` is true.

        Raises:
            ValueError: one line about what is wrong with the state.
        """
        with self._lock:  # one at a time: the newest move is answered soonest when older ones do not share the cores
            began = time.perf_counter()
            state = controls.read_state(query, self.controls)
            scenario, key = controls.scenario_of(self.base, state), self._key(state)
            self._store.want(key, lambda: self._plan(state))
            prepared, pair, drive = self._store.frame(key), bool(state["pair"]), float(state["drive"])
            budgets = self._store.budgets(key)
            points = list(self._curve(state))
            found = {
                "query": controls.write_state(state, self.controls),
                "state": state,
                "numbers": closed.numbers(scenario, budgets.scaled(drive), pair) if budgets else None,
                "curve": closed.curve(scenario, [(r, b.scaled(drive)) for r, b in points], pair) if points else None,
                "curve_complete": {r for r, _ in points} >= set(self._curve_ranges),
                "frame": frame.rendered(scenario, prepared, drive, pair) if prepared and with_frame else None,
                "pending": prepared is None,
                "doing": self._store.doing,
                "ready": {
                    c.key: [self._store.ready(self._key({**state, c.key: v})) for v in c.values] for c in self._rendered
                },
            }
            return {**found, "milliseconds": 1e3 * (time.perf_counter() - began)}

    def toml(self, query: str) -> str:
        """The scenario of a state as a file; the same numbers come from it on the command line.

        Raises:
            ValueError: as `answer`.
        """
        state = controls.read_state(query, self.controls)
        return toml_text(controls.scenario_of(self.base, state).model_dump(mode="json"))

    @property
    def _rendered(self) -> list[Control]:
        """Controls that change transport."""
        return [control for control in self.controls if not control.live]

    def _key(self, state: State) -> Key:
        return tuple(state[control.key] for control in self._rendered)

    def _curve(self, state: State) -> Iterator[tuple[float, Any]]:
        """Range and closed form of those points of the curve that are known, the present one among them."""
        for range_m in sorted({*self._curve_ranges, float(state["range_m"])}):
            budgets = self._store.budgets(self._key({**state, "range_m": range_m}))
            if budgets is not None:
                yield range_m, budgets

    def _plan(self, state: State) -> Iterator[Task]:
        """The state itself, its curve, then the other values of every control, nearest first, each ring with its curves."""
        yield self._task(state, "this point", with_frame=False)
        yield self._task(state, "this point", with_frame=True)
        yield from self._curve_tasks(state, "the curve over range")
        furthest = max(len(control.values) for control in self._rendered) - 1
        for distance in range(1, 1 + min(self._reach, furthest)):
            ring = list(self._at_distance(state, distance))
            for control, moved, text in ring:
                yield self._task(moved, f"{control.label}, {text}", with_frame=True)
            for control, moved, text in ring:
                if control.key != "range_m":
                    yield from self._curve_tasks(moved, f"the curve over range, {control.label}, {text}")

    def _at_distance(self, state: State, distance: int) -> Iterator[tuple[Control, State, str]]:
        for control in self._rendered:
            here = control.values.index(state[control.key])
            for index in (here - distance, here + distance):
                if 0 <= index < len(control.values):
                    yield control, {**state, control.key: control.values[index]}, control.texts[index]

    def _curve_tasks(self, state: State, what: str) -> Iterator[Task]:
        for range_m in self._curve_ranges:
            yield self._task({**state, "range_m": range_m}, what, with_frame=False)

    def _task(self, state: State, what: str, *, with_frame: bool) -> Task:
        return Task(self._key(state), with_frame, what, lambda: controls.geometry_of(self.base, state))
