"""The choice of a libLLVM and of a variant, on good machines and bad ones."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from scenes import llvm
from scenes.llvm import LLVM_VARIANT, OVERRIDE, SCALAR_VARIANT, Library, Verdict

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def fresh_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A machine with no libLLVM, no cached verdict and no user's wishes; yields the one directory that is searched."""
    for name in (OVERRIDE, llvm.FORCED_VARIANT, "LD_LIBRARY_PATH"):
        monkeypatch.setenv(name, "")  # so that what the code under test sets is undone
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    directory = tmp_path / "lib"
    directory.mkdir()
    monkeypatch.setattr(llvm, "SEARCH_DIRECTORIES", (str(directory),))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    llvm._warn_once.cache_clear()
    yield directory
    llvm._warn_once.cache_clear()


def put(directory: Path, *names: str) -> list[str]:
    for name in names:
        (directory / name).write_bytes(b"not a library")
    return [str(directory / name) for name in names]


class Probes:
    """Stands in for the subprocess; counts its runs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *usable_majors: int) -> None:
        self.paths: list[str] = []
        self.usable_majors = usable_majors
        monkeypatch.setattr(llvm, "probe", self)

    def __call__(self, library: Library) -> Verdict:
        self.paths.append(library.path)
        if library.major in self.usable_majors:
            return Verdict(True, "compiles and renders", library.version)
        return Verdict(False, "killed by SIGABRT: LLVM ERROR: Cannot select: fmaximum")


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", "15"),
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", "19.1"),
        ("/usr/lib/llvm-14/lib/libLLVM-14.0.6.so", "14.0.6"),
        ("/usr/lib/llvm-18/lib/libLLVM.so", "18"),
        ("/opt/homebrew/opt/llvm@19/lib/libLLVM.dylib", "19"),
        ("/opt/homebrew/Cellar/llvm/20.1.8/lib/libLLVM.dylib", "20.1.8"),
        ("/usr/lib/llvm/17/lib64/libLLVM-17.so", "17"),
        ("/usr/lib64/libLLVM.so", None),
        ("/usr/lib/x86_64-linux-gnu/libLLVMSPIRVLib.so.14", None),
    ],
)
def test_version_is_read_from_the_name_or_the_directory(path: str, version: str | None) -> None:
    assert llvm.version_from_name(path) == version


def test_well_tried_versions_come_first_and_links_count_once(fresh_machine: Path) -> None:
    put(fresh_machine, "libLLVM-14.so.1", "libLLVM.so.22.1", "libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVM.so.30.1")
    put(fresh_machine, "libLLVMSPIRVLib.so.19", "libLLVMCore.a")
    (fresh_machine / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    assert [library.major for library in llvm.find_libraries()] == [19, 22, 30, 15, 14]


def test_override_comes_first(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = put(fresh_machine, "libLLVM-18.so.1", "libLLVM.so.19.1")
    monkeypatch.setenv(OVERRIDE, paths[0])
    assert [library.path for library in llvm.find_libraries()] == paths


def test_directories_of_the_loader_are_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "module"
    elsewhere.mkdir()
    put(elsewhere, "libLLVM.so.20.1")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{tmp_path / 'absent'}:{elsewhere}")
    assert [library.major for library in llvm.find_libraries()] == [20]


def test_usable_library_is_handed_to_drjit(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(fresh_machine, "libLLVM.so.19.1")[0]
    Probes(monkeypatch, 19)
    assert llvm.select_variant() == LLVM_VARIANT
    assert os.environ[OVERRIDE] == path


def test_library_that_kills_the_probe_is_passed_over(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(fresh_machine, "libLLVM.so.19.1", "libLLVM-18.so.1")
    Probes(monkeypatch, 18)
    assert llvm.select_variant() == LLVM_VARIANT
    assert os.environ[OVERRIDE].endswith("libLLVM-18.so.1")


def test_only_14_and_15_end_in_the_scalar_variant_with_one_line(
    fresh_machine: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put(fresh_machine, "libLLVM-14.so.1", "libLLVM-15.so.1")
    probes = Probes(monkeypatch)
    assert [llvm.select_variant(), llvm.select_variant()] == [SCALAR_VARIANT] * 2
    assert probes.paths == []  # known to be too old: not even tried
    assert len(caplog.messages) == 1
    assert "times slower" in caplog.messages[0]
    assert llvm.install_command() in caplog.messages[0]
    assert not os.environ[OVERRIDE]


@pytest.mark.usefixtures("fresh_machine")
def test_no_library_at_all_ends_in_the_scalar_variant(caplog: pytest.LogCaptureFixture) -> None:
    assert llvm.select_variant() == SCALAR_VARIANT
    assert len(caplog.messages) == 1


def test_failing_override_costs_one_line_and_another_library_serves(
    fresh_machine: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    good, bad = put(fresh_machine, "libLLVM.so.19.1", "libLLVM-15.so.1")
    monkeypatch.setenv(OVERRIDE, bad)
    Probes(monkeypatch, 19)
    assert llvm.select_variant() == LLVM_VARIANT
    assert os.environ[OVERRIDE] == good
    assert len(caplog.messages) == 1
    assert f"{OVERRIDE}={bad} cannot be used" in caplog.messages[0]
    assert f"using {good} instead" in caplog.messages[0]


def test_forced_scalar_asks_nothing_and_warns_of_nothing(
    fresh_machine: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put(fresh_machine, "libLLVM.so.19.1")
    probes = Probes(monkeypatch, 19)
    monkeypatch.setenv(llvm.FORCED_VARIANT, SCALAR_VARIANT)
    assert llvm.select_variant() == SCALAR_VARIANT
    assert (probes.paths, caplog.messages) == ([], [])


def test_argument_outweighs_the_environment(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(fresh_machine, "libLLVM.so.19.1")
    Probes(monkeypatch, 19)
    monkeypatch.setenv(llvm.FORCED_VARIANT, SCALAR_VARIANT)
    assert llvm.select_variant(LLVM_VARIANT) == LLVM_VARIANT


def test_forced_llvm_without_a_library_says_what_to_install() -> None:
    with pytest.raises(RuntimeError, match="to install one"):
        llvm.select_variant(LLVM_VARIANT)


def test_unknown_variant_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(llvm.FORCED_VARIANT, "cuda_ad_rgb")
    with pytest.raises(
        ValueError, match="MANTIS_VARIANT: got 'cuda_ad_rgb', expected llvm_ad_spectral or scalar_spectr"
    ):
        llvm.select_variant()


def test_verdict_is_kept_until_the_library_changes(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(fresh_machine, "libLLVM.so.19.1")[0]
    probes = Probes(monkeypatch, 19)
    llvm.choose_library()
    llvm.choose_library()
    assert probes.paths == [path]
    os.utime(path, ns=(1, 1))
    llvm.choose_library()
    assert probes.paths == [path, path]


def test_crash_is_remembered_too(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put(fresh_machine, "libLLVM-16.so.1")[0]
    probes = Probes(monkeypatch)
    assert [llvm.choose_library(), llvm.choose_library()] == [None, None]
    assert probes.paths == [path]


def test_time_out_is_not_remembered(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(fresh_machine, "libLLVM.so.19.1")
    monkeypatch.setattr(llvm, "probe", lambda library: Verdict(False, "no answer within 120 s", conclusive=False))
    assert llvm.choose_library() is None
    Probes(monkeypatch, 19)
    assert llvm.choose_library() is not None


@pytest.mark.parametrize("damage", ["", "{", "[]", "null", '{"x": 1}', '{"x": {"usable": true}}', "\0\xff"])
def test_damaged_cache_is_replaced(fresh_machine: Path, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    put(fresh_machine, "libLLVM.so.19.1")
    llvm.cache_directory().mkdir(parents=True)
    file = llvm.cache_directory() / "llvm.json"
    file.write_bytes(damage.encode("latin-1"))
    Probes(monkeypatch, 19)
    assert llvm.choose_library() is not None
    assert len(json.loads(file.read_text())) == 1


def test_cache_that_cannot_be_written_is_done_without(
    fresh_machine: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put(fresh_machine, "libLLVM.so.19.1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(put(fresh_machine, "a_file")[0]))
    Probes(monkeypatch, 19)
    caplog.set_level(logging.WARNING)
    assert llvm.choose_library() is not None
    assert caplog.messages == []


def test_probe_of_a_file_that_is_no_library_gives_a_reason(fresh_machine: Path) -> None:
    verdict = llvm.probe(Library(put(fresh_machine, "libLLVM.so.19.1")[0], "19.1"))
    assert not verdict.usable
    assert "libLLVM.so.19.1" in verdict.reason
    assert not verdict.conclusive


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os; os.abort()", "killed by SIGABRT"),
        ("import os, sys; sys.stderr.write('LLVM ERROR: x'); sys.stderr.flush(); os.abort()", "SIGABRT: LLVM ERROR: x"),
        ("raise ValueError('what')", "ValueError: what"),
        ("try:\n  import no_such_module\nexcept ImportError:\n  undefined", "ModuleNotFoundError: No module named"),
        ("raise SystemExit(3)", "exit status 3"),
        ("import time; time.sleep(60)", "no answer within 2 s"),
    ],
)
def test_end_of_an_isolated_process_becomes_one_line(code: str, reason: str) -> None:
    failure = llvm.run_isolated(
        "import resource; resource.setrlimit(resource.RLIMIT_CORE, (0, 0))\n" + code, {}, 2
    ).failure
    assert failure is not None
    assert reason in failure
    assert "\n" not in failure


@pytest.mark.parametrize("forced", ["", SCALAR_VARIANT])
def test_activated_variant_is_mitsubas(tmp_path: Path, forced: str) -> None:
    """On the real machine, in a new process: whatever is installed here, a variant comes out and it computes."""
    code = (
        "from scenes.llvm import activate_variant\n"
        "name = activate_variant()\n"
        "import mitsuba as mi\n"
        "import drjit as dr\n"
        "assert mi.variant() == name, mi.variant()\n"
        "assert float(dr.sum(dr.maximum(mi.Float(2), mi.Float(1)))[0] if 'llvm' in name else dr.maximum(2, 1)) == 2\n"
        "print(name)\n"
    )
    environment = dict(os.environ) | {"XDG_CACHE_HOME": str(tmp_path), llvm.FORCED_VARIANT: forced}
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in ([forced] if forced else llvm.VARIANTS)


def stub(directory: Path, name: str, body: str) -> None:
    path = directory / name
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


def run_setup(tmp_path: Path, user_id: int, sudo: str, packages: str, loads: bool = True) -> tuple[int, list[str], str]:
    """Runs scripts/setup-llvm.sh where no libLLVM works until apt installs one. Status, lines printed, what apt did."""
    directory = tmp_path / "bin"
    directory.mkdir()
    log, installed = tmp_path / "apt.log", tmp_path / "installed"
    log.touch()
    installed.mkdir()
    for name in ("env", "touch", "true", "test"):
        (directory / name).symlink_to(f"/usr/bin/{name}")
    stub(directory, "id", f"echo {user_id}")
    stub(directory, "sudo", sudo)
    stub(directory, "apt-cache", f'case " {packages} " in *" $2 "*) exit 0;; esac; exit 100')
    stub(
        directory,
        "apt-get",
        f'echo "$*" >>{log}\n[ "$1" = update ] && exit 0\nfor p; do :; done; touch {installed}/$p',
    )
    drjit = "exit 0" if loads else f"test -e {installed}/libatomic1"
    stub(
        directory,
        "python",
        f'[ "$1" = -c ] && {{ {drjit}; exit $?; }}\n{drjit.replace("exit 0", "true")} || exit 1\n'
        f"test -e {installed}/libllvm19 || test -e {installed}/libllvm18",
    )
    done = subprocess.run(
        ["/bin/sh", str(ROOT / "scripts/setup-llvm.sh"), "python"],
        env={"PATH": str(directory)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=20,
    )
    return done.returncode, (done.stdout + done.stderr).splitlines(), log.read_text()


PASSWORDLESS, REFUSED = 'shift; exec "$@"', "echo 'sudo: a password is required' >&2; exit 1"


@pytest.mark.parametrize(("user_id", "sudo"), [(0, REFUSED), (1000, PASSWORDLESS)])
def test_setup_installs_the_best_library_where_it_may(tmp_path: Path, user_id: int, sudo: str) -> None:
    status, lines, log = run_setup(tmp_path, user_id, sudo, "libllvm16 libllvm18 libllvm19 libllvm22")
    assert (status, lines) == (0, ["setup: installing libllvm19 for Dr.Jit"])
    assert "install -y -qq --no-install-recommends libllvm19" in log


def test_setup_goes_on_to_the_next_package(tmp_path: Path) -> None:
    status, lines, _ = run_setup(tmp_path, 0, REFUSED, "libllvm18 libllvm17")
    assert (status, lines) == (0, ["setup: installing libllvm18 for Dr.Jit"])


def test_setup_that_may_not_install_says_what_to_type_in_one_line(tmp_path: Path) -> None:
    status, lines, log = run_setup(tmp_path, 1000, REFUSED, "libllvm19")
    assert (status, len(lines), log) == (0, 1, "")
    assert "type: sudo apt-get update && sudo apt-get install libllvm19" in lines[0]


def test_setup_with_nothing_to_install_ends_well(tmp_path: Path) -> None:
    status, lines, _ = run_setup(tmp_path, 0, REFUSED, "libllvm14 libllvm15 libllvm16")
    assert (status, len(lines)) == (0, 1)


def test_setup_installs_libatomic_on_a_bare_machine(tmp_path: Path) -> None:
    status, _, log = run_setup(tmp_path, 0, REFUSED, "libllvm19", loads=False)
    assert status == 0
    assert "libatomic1" in log
    assert "libllvm19" in log


def test_setup_fails_where_nothing_can_render_and_says_what_to_type(tmp_path: Path) -> None:
    status, lines, _ = run_setup(tmp_path, 1000, REFUSED, "libllvm19", loads=False)
    assert (status, len(lines)) == (1, 1)
    assert "sudo apt-get install libatomic1 libllvm19" in lines[0]


@pytest.mark.parametrize("script", ["setup-llvm.sh", "setup-venv.sh"])
def test_scripts_parse_as_posix_shell(script: str) -> None:
    subprocess.run(["/bin/sh", "-n", str(ROOT / "scripts" / script)], check=True)
