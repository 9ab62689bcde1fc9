"""An explorer without a process beside it, for tests."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import xarray as xr

from experiments.explore.explorer import Explorer
from experiments.explore.geometries import GeometryStore
from experiments.scenario import Scenario


class Here:
    """An executor without workers: a task runs where it is submitted, at its own priority."""

    losses: tuple[type[BaseException], ...] = ()

    def width(self) -> int:
        return 1

    def submit(self, aside: Callable[..., Any], *arguments: Any) -> Future[Any]:
        work, scenario = arguments
        future: Future[Any] = Future()
        try:
            future.set_result(work(scenario))
        except Exception as error:
            future.set_exception(error)
        return future

    def recover(self) -> None:
        pass

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *how: object) -> None:
        pass


@contextmanager
def exploring(base: Scenario, reach: int = 0) -> Iterator[Explorer]:
    """An explorer of a scenario that prepares what is asked for."""
    with GeometryStore(Here()) as store:
        yield Explorer(base, store, reach)


def answered(explorer: Explorer, query: str, seconds: float = 60.0) -> dict[str, Any]:
    """The answer to a state, as soon as it is whole."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        answer = explorer.answer(query)
        if not answer["pending"] and answer["curve_complete"]:
            return answer
        time.sleep(0.02)
    raise TimeoutError(f"{query}: {answer['doing']}")


def swept(mantis: Callable[..., Any], scenario: Path, range_m: float) -> dict[str, float]:
    """What the command line gives for a scenario file at a range, by variable."""
    plan, out = scenario.with_name("sweep.toml"), scenario.with_name("results.nc")
    plan.write_text(
        f"scenario = {json.dumps(scenario.name)}\ntrials = 2\n[grid]\nrange_m = [{range_m}]\n", encoding="utf-8"
    )
    status, _, error = mantis("sweep", plan, "--workers", 1, "--quiet", "-o", out)
    assert (status, error) == (0, "")
    with xr.open_dataset(out) as dataset:
        return {
            str(name): float(v.item()) for name, v in dataset.data_vars.items() if v.size == 1 and v.dtype.kind == "f"
        }
