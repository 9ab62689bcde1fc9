"""Work in other processes: spawned, for the renderer must not be forked; or on a Dask cluster's workers.

A worker keeps to its share of the cores, leaves Ctrl-C to its parent and ends when that has gone; nothing is left running.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from types import TracebackType
from typing import Protocol, TypeVar

Result = TypeVar("Result")

GONE = "scheduler or workers have gone; what is done is kept, --resume goes on with it"

#: Read by the BLAS libraries of numpy and scipy when they are loaded.
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def pool(function: Callable[..., Result], workers: int | None = None) -> Iterator[Callable[..., Future[Result]]]:
    """A submitter that runs `function` in worker processes, or here where there is but one.

    Args:
        function: importable by name, with arguments and result that pickle.
        workers: processes; default one a core; up to one runs here.
    """
    count = workers if workers is not None else cores()
    if count <= 1:

        def run_here(*arguments: object) -> Future[Result]:
            future: Future[Result] = Future()
            future.set_result(function(*arguments))
            return future

        yield run_here
        return
    executor = _process_pool(count)
    try:
        yield lambda *arguments: executor.submit(function, *arguments)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


class Executor(Protocol):
    """Runs tasks in workers that may be lost."""

    @property
    def losses(self) -> tuple[type[BaseException], ...]:
        """What a task's future raises when the worker died that ran it."""

    def width(self) -> int:
        """Tasks that run at a time, one at least; that of a cluster changes.

        Raises:
            RuntimeError: when the workers have gone altogether.
        """

    def submit(self, function: Callable[..., Result], *arguments: object) -> Future[Result]:
        """Run a function, importable by name, in one of the workers."""

    def recover(self) -> None:
        """Be ready for tasks again after a loss."""

    def __enter__(self) -> Executor: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let the workers go: at once after an error, else when they are done."""


class ProcessExecutor:
    """Spawned processes on this machine, which share its cores evenly; a new set where one of them dies."""

    losses: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        self._count, self._pool = count, _process_pool(count, renders=True)

    def width(self) -> int:
        """Tasks that run at a time, as `Executor.width`."""
        return self._count

    def submit(self, function: Callable[..., Result], *arguments: object) -> Future[Result]:
        """Run a function, importable by name, in one of the workers."""
        return self._pool.submit(function, *arguments)

    def recover(self) -> None:
        """Start a new set of processes."""
        self._pool.shutdown(wait=False)
        self._pool = _process_pool(self._count, renders=True)

    def __enter__(self) -> ProcessExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            # The pool has no public way to stop a running task before Python 3.14.
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)


class ClusterExecutor:
    """The workers of a Dask scheduler, wherever they run. A lost worker's tasks go to others; Dask sees to that.

    Raises:
        ImportError: when dask.distributed is not installed.
        OSError: when there is no such scheduler.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise ImportError("--scheduler needs dask.distributed: pip install 'mantis-radiometry[cluster]'") from error
        self.losses: tuple[type[BaseException], ...] = (KilledWorker,)
        try:
            self._client = Client(address, set_as_default=False, timeout=10)
        except (OSError, ValueError) as error:  # no such address, or nobody there
            raise OSError(f"--scheduler {address}: no Dask scheduler answers ({error})") from error
        self._pool = self._client.get_executor(pure=False)

    def width(self) -> int:
        """Tasks that run at a time, as `Executor.width`."""
        try:
            return max(1, sum(self._client.nthreads().values()))
        except OSError as error:
            raise RuntimeError(GONE) from error

    def submit(self, function: Callable[..., Result], *arguments: object) -> Future[Result]:
        """Run a function, importable by name, in one of the workers."""
        return self._pool.submit(function, *arguments)

    def recover(self) -> None:
        """Nothing: the scheduler has given the task up, not the workers."""

    def __enter__(self) -> ClusterExecutor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(wait=kind is None)
        self._client.close()


def _process_pool(count: int, renders: bool = False) -> ProcessPoolExecutor:
    for variable in _BLAS_THREADS:  # inherited by the workers; this process has long read them
        os.environ.setdefault(variable, "1")
    threads = max(1, cores() // count)
    return ProcessPoolExecutor(
        count, mp_context=get_context("spawn"), initializer=_prepare, initargs=(threads if renders else 0,)
    )


def _prepare(renderer_threads: int) -> None:
    """A worker's first act; with threads for the renderer it is loaded, too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)
    if renderer_threads:
        from scenes.llvm import activate_variant

        if activate_variant().startswith("llvm"):
            import drjit

            drjit.set_thread_count(renderer_threads)


def _end_with_parent() -> None:
    """A parent that was killed cannot tell its workers, which would wait for tasks for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
