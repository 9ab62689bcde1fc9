"""Sweeps by several processes and machines: the same bytes as from one, whichever worker dies or disk fills."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.resources import files
from pathlib import Path

import pytest

from experiments.chain.executor import ClusterExecutor, ProcessExecutor
from experiments.studies.sweep import study, work

PLAN = """
trials = 2
[set]
"render.marker_rays" = 10000
"render.frame_samples" = 1
"camera.width_px" = 96
"camera.height_px" = 80
[grid]
range_m = [3.0, 4.0]
illumination = ["eclipse", "sunlit"]
exposure_s = [4e-7, 2e-6, 1e-5, "auto"]
"""
CASES = 16


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("workers")


@pytest.fixture(scope="module")
def sweep(folder: Path) -> study.Sweep:
    path = folder / "sweep.toml"
    path.write_text(PLAN)
    return study.load_sweep(path)


@pytest.fixture(scope="module")
def alone(sweep: study.Sweep, folder: Path) -> bytes:
    """The file that this process writes by itself."""
    study.run_sweep(sweep, folder / "alone.nc")
    return (folder / "alone.nc").read_bytes()


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the workers render, too."""
    monkeypatch.setenv("MANTIS_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def journalled(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Cases in the order in which they are written into the journal."""
    from experiments.studies.sweep.journal import Journal

    indices: list[int] = []
    original = Journal.append

    def append(self, finished):
        indices.extend(index for index, _ in finished)
        original(self, finished)

    monkeypatch.setattr(Journal, "append", append)
    return indices


def _killing(process: Callable[[], int], after: int) -> Callable[[int, int, str], None]:
    """A progress report that kills a process once some cases are done."""
    killed: list[int] = []

    def progress(done: int, total: int, label: str) -> None:
        if done >= after and not killed:
            killed.append(process())
            os.kill(killed[0], signal.SIGKILL)

    return progress


def test_processes_write_the_same_file_though_one_is_killed(
    sweep: study.Sweep, alone: bytes, tmp_path: Path, journalled: list[int]
) -> None:
    executor = ProcessExecutor(2)
    progress = _killing(lambda: next(iter(executor._pool._processes)), after=4)
    outcome = study.run_sweep(sweep, tmp_path / "out.nc", executor=lambda: executor, progress=progress)
    assert (tmp_path / "out.nc").read_bytes() == alone
    assert sorted(journalled) == list(range(CASES))
    assert outcome.failed == 0


class _Worker:
    """A Dask worker in a process of its own."""

    def __init__(self, scheduler_file: Path) -> None:
        arguments = ["worker", "--scheduler-file", scheduler_file, "--no-nanny", "--nthreads", "1", "--no-dashboard"]
        self.process = _dask(*arguments, "--local-directory", scheduler_file.parent)


def _dask(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "dask", *map(str, arguments), "--host", "127.0.0.1"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path: Path, own_cache: None) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler on this machine, and its two workers."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    scheduler = _dask("scheduler", "--scheduler-file", file, "--port", "0", "--no-dashboard")
    started = [scheduler]
    try:
        while not file.exists():
            assert scheduler.poll() is None
            time.sleep(0.05)
        started += [_Worker(file).process for _ in range(2)]
        yield json.loads(file.read_text())["address"], started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_a_cluster_writes_the_same_file_though_it_is_interrupted_and_a_worker_is_killed(
    sweep: study.Sweep,
    alone: bytes,
    tmp_path: Path,
    journalled: list[int],
    cluster: tuple[str, list[subprocess.Popen[bytes]]],
) -> None:
    """Rationale: machines of a cluster come and go, and so do those who watch it.

    Expected: after Ctrl-C the sweep goes on where it stopped; a real scheduler on loopback loses one of two workers after a few
    more cases; every case is journalled once, and the file equals, byte for byte, that of one process.
    """

    def interrupt(done: int, total: int, label: str) -> None:
        raise KeyboardInterrupt

    address, workers = cluster
    executor, out = partial(ClusterExecutor, address), tmp_path / "out.nc"
    with pytest.raises(KeyboardInterrupt):
        study.run_sweep(sweep, out, executor=executor, progress=interrupt)
    done = len(journalled)
    assert 0 < done < CASES / 2
    outcome = study.run_sweep(
        sweep, out, resume=True, executor=executor, progress=_killing(lambda: workers[0].pid, after=done + 4)
    )
    assert workers[0].wait(5) == -signal.SIGKILL
    assert out.read_bytes() == alone
    assert sorted(journalled) == list(range(CASES))
    assert (outcome.failed, outcome.computed) == (0, CASES - done)


def test_an_address_without_a_scheduler_is_named(tmp_path: Path, sweep: study.Sweep) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(OSError, match="--scheduler nothing://here: no Dask scheduler answers"):
        study.run_sweep(sweep, tmp_path / "out.nc", executor=partial(ClusterExecutor, "nothing://here"))


def test_a_worker_with_other_software_is_refused(sweep: study.Sweep) -> None:
    with pytest.raises(work.OtherSoftware, match="install the same version"):
        work.compute_task([(0, sweep.scenarios[0])], "0123456789abcdef")


def test_software_is_told_by_all_that_a_case_runs_through() -> None:
    """Rationale: a journal may be resumed by the same software alone, so nothing that computes may be left out of its hash."""
    names = {name for package in work._PACKAGES for name, _ in work._sources(files(package), package)}
    modules = ("scenario/model", "chain/trials", "chain/link_budget", "studies/sweep/work", "studies/sweep/window")
    assert {f"experiments/{module}.py" for module in modules} <= names
    assert {"scenes/render/tracer.py", "detector/pose/pose.py", "radiometry/link.py"} <= names
    others = ("experiments/cli/", "experiments/thesis/", "experiments/studies/budget/", "experiments/explore/")
    assert not [name for name in names if name.startswith(others)]


def test_workers_end_with_their_parent(tmp_path: Path) -> None:
    """Rationale: a sweep that is killed leaves no processes behind that hold memory for ever."""
    script = """
import os, signal
from experiments.chain.executor import pool
if __name__ == "__main__":
    with pool(os.getpid, 2) as submit:
        print(submit().result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""
    (tmp_path / "parent.py").write_text(script)
    done = subprocess.run([sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True, check=False)
    worker = int(done.stdout)
    for _ in range(200):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("the worker outlived its parent by ten seconds")


def test_a_full_disk_ends_the_sweep_in_one_line_and_resume_goes_on(
    sweep: study.Sweep, alone: bytes, tmp_path: Path, journalled: list[int], own_cache: None
) -> None:
    """Rationale: neither journal nor cache nor result can be written any further when a disk is full.

    Expected: with files limited to 8 kB the first cases are journalled, then one line says what is wrong and where, with exit
    status 2; without the limit the rest is computed, and the file is the same.
    """
    (tmp_path / "sweep.toml").write_text(PLAN)
    script = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (8_000, resource.RLIM_INFINITY))
from experiments.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
    command = [sys.executable, "-c", script, "sweep", tmp_path / "sweep.toml", "--out", tmp_path / "out.nc"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.strip().splitlines()[-1] == f"mantis: {tmp_path / 'out.nc.journal'}: File too large"
    outcome = study.run_sweep(sweep, tmp_path / "out.nc", resume=True)
    assert 0 < outcome.computed < CASES
    assert (tmp_path / "out.nc").read_bytes() == alone


def test_a_result_that_cannot_be_written_costs_no_case(
    sweep: study.Sweep, alone: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(dataset, path):
        raise OSError(28, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(study, "write_dataset", full)
        with pytest.raises(OSError, match="No space left"):
            study.run_sweep(sweep, tmp_path / "out.nc")
    assert study.run_sweep(sweep, tmp_path / "out.nc", resume=True).computed == 0
    assert (tmp_path / "out.nc").read_bytes() == alone


def test_truncated_and_foreign_files_in_the_cache_change_nothing(
    sweep: study.Sweep, alone: bytes, tmp_path: Path, own_cache: None
) -> None:
    assert study.run_sweep(sweep, tmp_path / "a.nc").rendered == 2
    cut, foreign = sorted((tmp_path / "cache").glob("*.exr"))
    cut.write_bytes(cut.read_bytes()[:5000])
    foreign.write_bytes(b"not an image at all")
    assert study.run_sweep(sweep, tmp_path / "b.nc").rendered == 2
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes() == alone
