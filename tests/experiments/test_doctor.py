"""The diagnosis of good machines and bad ones."""

from __future__ import annotations

import io
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from experiments.cli import doctor
from experiments.cli.doctor import DEGRADED, FAILED, OK, diagnose
from scenes import llvm
from scenes.llvm import LLVM_VARIANT, SCALAR_VARIANT, Library, Outcome, Verdict

ROOT = Path(__file__).parents[2]


class Machine:
    """A pretended machine: its libraries by usability, and the checks that fail with a reason."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        self.libraries = {"/lib/libLLVM.so.19.1": True}
        self.failing: dict[str, str] = {}
        self.monkeypatch = monkeypatch
        for name in (llvm.OVERRIDE, llvm.FORCED_VARIANT):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        monkeypatch.setattr(doctor.metadata, "version", lambda name: "1.0")
        monkeypatch.setattr(llvm, "find_libraries", lambda: [Library(path, None) for path in self.libraries])
        monkeypatch.setattr(llvm, "verdict_on", self.verdict_on)
        monkeypatch.setattr(llvm, "run_isolated", self.run_isolated)

    def verdict_on(self, library: Library, fresh: bool = False) -> Verdict:
        assert fresh
        if self.libraries[library.path]:
            return Verdict(True, "compiles and renders", "19.1.7")
        return Verdict(False, "killed by SIGABRT: LLVM ERROR: Cannot select")

    def run_isolated(self, code: str, environment: Any = None) -> Outcome:
        outputs = {
            doctor._SCALAR_RENDER: '{"available": ["scalar_spectral"]}',
            doctor._EXR: '{"layers": ["led.nm0838"]}',
            doctor._OPENCV: '{"version": "5.0.0"}',
            doctor._NETCDF: "{}",
            doctor._THREADS: "2",
        }
        for name, failure in self.failing.items():
            if code == getattr(doctor, f"_{name}"):
                return Outcome(failure, "")
        return Outcome(None, f"some library's chatter\n{outputs[code]}\n")


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    return Machine(monkeypatch, tmp_path)


def printed(diagnosis: dict[str, Any], width: int = 200) -> str:
    stream = io.StringIO()
    doctor.print_report(diagnosis, Console(file=stream, width=width))
    return stream.getvalue()


@pytest.mark.usefixtures("machine")
def test_good_machine_is_ok_and_needs_no_advice() -> None:
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["variant"], diagnosis["advice"]) == (OK, LLVM_VARIANT, [])
    assert json.loads(json.dumps(diagnosis)) == diagnosis


def test_only_bad_libraries_degrade_and_say_what_to_type(machine: Machine) -> None:
    machine.libraries = {"/lib/libLLVM-15.so.1": False, "/lib/libLLVM-14.so.1": False}
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["variant"]) == (DEGRADED, SCALAR_VARIANT)
    assert [candidate["ok"] for candidate in diagnosis["llvm"]["candidates"]] == [False, False]
    assert "killed by SIGABRT" in printed(diagnosis)
    assert len(diagnosis["advice"]) == 1
    assert llvm.install_command() in diagnosis["advice"][0]


def test_no_library_degrades(machine: Machine) -> None:
    machine.libraries = {}
    assert diagnose()["status"] == DEGRADED


def test_failing_override_is_named(machine: Machine) -> None:
    machine.libraries = {"/bad/libLLVM.so": False, "/lib/libLLVM.so.19.1": True}
    machine.monkeypatch.setenv(llvm.OVERRIDE, "/bad/libLLVM.so")
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["llvm"]["chosen"]) == (OK, "/lib/libLLVM.so.19.1")
    assert f"unset {llvm.OVERRIDE}" in diagnosis["advice"][0]


def test_missing_system_library_fails_and_names_its_package(machine: Machine) -> None:
    machine.libraries = {"/lib/libLLVM.so.19.1": False}
    machine.failing["SCALAR_RENDER"] = "ImportError: libatomic.so.1: cannot open shared object file: No such file"
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["variant"]) == (FAILED, None)
    assert len(diagnosis["advice"]) == 1
    assert diagnosis["advice"][0].endswith("sudo apt-get install libatomic1")


@pytest.mark.parametrize("check", ["EXR", "NETCDF", "OPENCV"])
def test_broken_package_fails(machine: Machine, check: str) -> None:
    machine.failing[check] = "killed by SIGSEGV"
    diagnosis = diagnose()
    assert diagnosis["status"] == FAILED
    assert diagnosis[check.lower()] == {"ok": False, "reason": "killed by SIGSEGV"}
    assert "--force-reinstall" in diagnosis["advice"][0]


def test_missing_package_fails_and_is_named(machine: Machine) -> None:
    def version(name: str) -> str:
        if name == "click":
            raise doctor.metadata.PackageNotFoundError(name)
        return "1.0"

    machine.monkeypatch.setattr(doctor.metadata, "version", version)
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["packages"]["reason"]) == (FAILED, "not installed: click")
    assert "pip install" in diagnosis["advice"][0]


@pytest.mark.parametrize(
    ("forced", "libraries", "status", "variant"),
    [
        (SCALAR_VARIANT, {"/lib/libLLVM.so.19.1": True}, DEGRADED, SCALAR_VARIANT),
        (LLVM_VARIANT, {"/lib/libLLVM.so.19.1": True}, OK, LLVM_VARIANT),
        (LLVM_VARIANT, {}, FAILED, None),
        ("cuda_ad_rgb", {"/lib/libLLVM.so.19.1": True}, FAILED, None),
    ],
)
def test_forced_variant_is_heeded(
    machine: Machine, forced: str, libraries: dict[str, bool], status: str, variant: str | None
) -> None:
    machine.libraries = libraries
    machine.monkeypatch.setenv(llvm.FORCED_VARIANT, forced)
    diagnosis = diagnose()
    assert (diagnosis["status"], diagnosis["variant"]) == (status, variant)
    assert any(llvm.FORCED_VARIANT in line for line in diagnosis["advice"]) == (
        forced != variant or variant == SCALAR_VARIANT
    )


def test_cache_that_cannot_be_written_degrades(machine: Machine, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    machine.monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    diagnosis = diagnose()
    assert diagnosis["status"] == DEGRADED
    assert "XDG_CACHE_HOME" in diagnosis["advice"][0]


CHECKS = ("_check_python", "_check_packages", "_check_isolated", "_check_llvm", "_check_cpu", "_check_cache")


@pytest.mark.parametrize("check", CHECKS)
def test_check_that_raises_is_a_finding(machine: Machine, check: str) -> None:
    def broken(*_: object) -> None:
        raise OSError("disk on fire")

    machine.monkeypatch.setattr(doctor, check, broken)
    diagnosis = diagnose()
    assert "disk on fire" in printed(diagnosis)
    json.dumps(diagnosis)


def test_report_cuts_nothing_off_on_a_narrow_terminal(machine: Machine) -> None:
    path = "/a/rather/long/directory/name/with/libLLVM.so.19.1"
    machine.libraries = {path: True}
    letters = "".join(re.findall(r"[\w/.]", printed(diagnose(), width=40)))
    assert path in letters


def test_real_machine_is_diagnosed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The checks themselves, as they run here: the code in each subprocess is right."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    diagnosis = diagnose()
    failed = {name: diagnosis[name].get("reason") for name in doctor.NATIVE if not diagnosis[name]["ok"]}
    assert failed == {}
    assert SCALAR_VARIANT in diagnosis["mitsuba"]["available"]
    assert diagnosis["cpu"]["threads"] is None or diagnosis["cpu"]["threads"] >= 1
    assert printed(diagnosis)


def test_packages_are_those_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {re.split(r"[\[<>=]", requirement)[0] for requirement in project["dependencies"]}
    assert names == set(doctor.PACKAGES)


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    reasons = (ROOT / "docs/dependencies.md").read_text()
    extras = [name for names in project["optional-dependencies"].values() for name in names]
    for requirement in [*project["dependencies"], *extras]:
        name = re.split(r"[\[<>=]", requirement)[0]
        if name == project["name"]:  # an extra within another
            continue
        assert reasons.count(f"| {name} |") == 1, name
