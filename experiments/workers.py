"""Work in other processes: spawned, for the renderer must not be forked, with one OpenCV thread each."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

Result = TypeVar("Result")


@contextmanager
def pool(function: Callable[..., Result], workers: int | None = None) -> Iterator[Callable[..., Future[Result]]]:
    """A submitter that runs `function` in worker processes, or here where there is but one.

    Args:
        function: importable by name, with arguments and result that pickle.
        workers: processes; default one a core; up to one runs here.
    """
    count = workers if workers is not None else (os.cpu_count() or 1)
    if count <= 1:

        def run_here(*arguments: object) -> Future[Result]:
            future: Future[Result] = Future()
            future.set_result(function(*arguments))
            return future

        yield run_here
        return
    executor = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_one_thread)
    try:
        yield lambda *arguments: executor.submit(function, *arguments)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)
