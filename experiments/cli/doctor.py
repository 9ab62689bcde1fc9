"""Says whether this machine can run the project, and what to install where it cannot.

Whatever may crash (Mitsuba, a libLLVM, a native extension) runs in a subprocess; its death becomes a line of the
diagnosis.
"""

from __future__ import annotations

import json
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from typing import TYPE_CHECKING, Any

from scenes import llvm

if TYPE_CHECKING:
    from rich.console import Console

Report = dict[str, Any]

OK, DEGRADED, FAILED = "ok", "degraded", "failed"

# The run-time dependencies of pyproject.toml, by distribution name.
PACKAGES = (
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "colour-science",
    "opencv-python-headless",
    "OpenEXR",
    "pydantic",
    "xarray",
    "h5netcdf",
    "h5py",
    "click",
    "rich",
    "matplotlib",
    "jinja2",
    "numba",
)
OLDEST_PYTHON = (3, 11)

NATIVE = ("mitsuba", "exr", "netcdf", "opencv")  # the checks of packages with native code
# System libraries that the wheels leave to the machine, and the Debian and Ubuntu packages that have them.
SYSTEM_PACKAGES = {"libatomic.so.1": "libatomic1"}

# Each ends by printing one JSON value.
_SCALAR_RENDER = f"""
import json
import mitsuba as mi
mi.set_variant("{llvm.SCALAR_VARIANT}")
light = {{"type": "constant", "radiance": {{"type": "uniform", "value": 1.0}}}}
film = {{"type": "hdrfilm", "width": 4, "height": 4, "component_format": "float32"}}
sensor = {{"type": "perspective", "film": film}}
scene = {{"type": "scene", "integrator": {{"type": "direct"}}, "light": light, "sensor": sensor}}
mi.render(mi.load_dict(scene), spp=4)
print(json.dumps({{"available": mi.variants()}}))
"""
_THREADS = f"""
import json
import drjit as dr
import mitsuba as mi
mi.set_variant("{llvm.LLVM_VARIANT}")
print(json.dumps(dr.thread_count()))
"""
_EXR = """
import json, pathlib, tempfile
import numpy as np
from scenes.files.exr import read_channels, write_channels
layers = {f"{light}.nm{nm:04d}": np.full((3, 5), nm / 7, np.float32) for light in ("led", "sun") for nm in (838, 862)}
with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder) / "layers.exr"
    write_channels(dict(layers), {"unit_led": "m-2"}, path)
    back, attributes = read_channels(path)
if attributes.get("unit_led") != "m-2" or sorted(back) != sorted(layers):
    raise SystemExit("layers or attributes are lost")
if any(back[name].dtype != np.float32 or not np.array_equal(back[name], layers[name]) for name in layers):
    raise SystemExit("float32 values do not come back as written")
print(json.dumps({"layers": sorted(back)}))
"""
_NETCDF = """
import json, pathlib, tempfile
import numpy as np
import xarray as xr
with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder) / "values.nc"
    xr.Dataset({"value": ("x", np.arange(3.0))}).to_netcdf(path, engine="h5netcdf")
    with xr.open_dataset(path, engine="h5netcdf") as back:
        if back["value"].values.tolist() != [0.0, 1.0, 2.0]:
            raise SystemExit("values do not come back as written")
print(json.dumps({}))
"""
_OPENCV = """
import json
import cv2
cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
print(json.dumps({"version": cv2.__version__}))
"""


def diagnose() -> Report:
    """Every check's finding as plain JSON data; never raises.

    Keys: `status` ("ok", "degraded": runs slower, "failed": cannot run), `advice` (lines saying what to do), `variant`
    (the Mitsuba variant that would be used, or None), and one entry for each check, which holds `ok` and, where that is
    false, `reason`.
    """
    report: Report = {
        "python": _safely(_check_python),
        "platform": _safely(lambda: {"ok": True, "name": platform.platform(), "machine": platform.machine()}),
        "packages": _safely(_check_packages),
        "mitsuba": _safely(lambda: _check_isolated(_SCALAR_RENDER)),
        "llvm": _safely(_check_llvm),
        "exr": _safely(lambda: _check_isolated(_EXR)),
        "netcdf": _safely(lambda: _check_isolated(_NETCDF)),
        "opencv": _safely(lambda: _check_isolated(_OPENCV)),
        "cache": _safely(_check_cache),
    }
    report["cpu"] = _safely(lambda: _check_cpu(report["llvm"].get("chosen")))
    report["variant"] = _variant(report)
    report["advice"] = _advice(report)
    report["status"] = _status(report)
    return report


def print_report(diagnosis: Report, console: Console) -> None:
    """Prints a diagnosis as a table for people, with the advice below it."""
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    for heading in ("check", "", "finding"):
        table.add_column(heading, overflow="fold")  # nothing cut off: paths are there to be copied
    for name, finding in _rows(diagnosis):
        mark = "[green]ok[/]" if finding["ok"] else "[red]no[/]"
        table.add_row(escape(name), mark, escape(finding["text"]))
    console.print(table)
    colour = {OK: "green", DEGRADED: "yellow", FAILED: "red"}[diagnosis["status"]]
    console.print(f"[{colour}]{diagnosis['status']}[/]: variant {diagnosis['variant'] or 'none'}", highlight=False)
    for line in diagnosis["advice"]:
        console.print(f"- {escape(line)}", highlight=False, soft_wrap=True)  # one line each, to be copied


def _safely(check: Callable[[], Report]) -> Report:
    try:
        return check()
    except Exception as error:  # a doctor outlives any symptom
        return {"ok": False, "reason": f"{type(error).__name__}: {error}"}


def _check_python() -> Report:
    finding: Report = {"ok": True, "version": platform.python_version(), "executable": sys.executable}
    if sys.version_info < OLDEST_PYTHON:
        finding |= {"ok": False, "reason": f"older than {'.'.join(map(str, OLDEST_PYTHON))}"}
    return finding


def _check_packages() -> Report:
    versions: dict[str, str | None] = {}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    missing = [name for name, version in versions.items() if version is None]
    finding: Report = {"ok": not missing, "versions": versions}
    if missing:
        finding["reason"] = f"not installed: {', '.join(missing)}"
    return finding


def _check_isolated(code: str) -> Report:
    """Runs code that prints one JSON object last; its keys join the finding."""
    outcome = llvm.run_isolated(code)
    if outcome.failure is not None:
        return {"ok": False, "reason": outcome.failure}
    return {"ok": True} | json.loads(outcome.output.strip().splitlines()[-1])


def _check_llvm() -> Report:
    """Tries every candidate afresh, without the cached verdicts, and keeps the new ones for the next start."""
    candidates = []
    for library in llvm.find_libraries():
        verdict = llvm.verdict_on(library, fresh=True)
        version = verdict.version or library.version
        candidates.append({"path": library.path, "version": version, "ok": verdict.usable, "reason": verdict.reason})
    chosen = next((candidate["path"] for candidate in candidates if candidate["ok"]), None)
    finding: Report = {
        "ok": chosen is not None,
        "chosen": chosen,
        "override": os.environ.get(llvm.OVERRIDE),
        "candidates": candidates,
    }
    if chosen is None:
        finding["reason"] = "no libLLVM on this machine works" if candidates else "no libLLVM on this machine"
    return finding


def _check_cpu(library: str | None) -> Report:
    """Cores of the machine, cores this process may use, and the threads that Mitsuba takes."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    finding: Report = {"ok": True, "cores": os.cpu_count(), "usable_cores": usable, "threads": None}
    if library is not None:
        outcome = llvm.run_isolated(_THREADS, {llvm.OVERRIDE: library})
        if outcome.failure is None:
            finding["threads"] = json.loads(outcome.output.strip().splitlines()[-1])
    return finding


def _check_cache() -> Report:
    directory = llvm.cache_directory()
    finding: Report = {"ok": True, "directory": str(directory)}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        finding |= {"ok": False, "reason": f"cannot be written: {error.strerror or error}"}
    return finding


def _variant(report: Report) -> str | None:
    """Variant that a run would take, as `scenes.llvm.select_variant` chooses it."""
    forced = os.environ.get(llvm.FORCED_VARIANT)
    if forced and forced not in llvm.VARIANTS:
        return None
    if forced != llvm.SCALAR_VARIANT and report["llvm"]["ok"]:
        return llvm.LLVM_VARIANT
    if forced != llvm.LLVM_VARIANT and report["mitsuba"]["ok"]:
        return llvm.SCALAR_VARIANT
    return None


def _advice(report: Report) -> list[str]:
    advice = [*_package_advice(report), *_variant_advice(report)]
    if not report["python"]["ok"]:
        advice.insert(0, "Python 3.11 or newer is needed: install it, then run `make setup` again")
    if not report["cache"]["ok"]:
        advice.append(
            "Every start probes libLLVM anew (about a second): set XDG_CACHE_HOME to a directory that can be written"
        )
    return advice


def _package_advice(report: Report) -> list[str]:
    """What to install for Python packages that are missing, or that fail, maybe for want of a system library."""
    pip = f"in the project's folder: {sys.executable} -m pip install -e '.[dev]'"
    if not report["packages"]["ok"]:
        return [f"Packages are missing; to install them, {pip}"]
    broken = {name: report[name]["reason"] for name in NATIVE if not report[name]["ok"]}
    missing = {
        match[1] for reason in broken.values() if (match := re.search(r"(lib\S+): cannot open shared object", reason))
    }
    if missing:
        packages = " ".join(SYSTEM_PACKAGES.get(name, f"(the package that has {name})") for name in sorted(missing))
        return [f"A system library is missing; to install it: sudo apt-get update && sudo apt-get install {packages}"]
    if broken:
        return [f"What is installed fails ({', '.join(broken)}); to install it afresh, {pip} --force-reinstall"]
    return []


def _variant_advice(report: Report) -> list[str]:
    advice = []
    found = report["llvm"]
    if not found["ok"] and report["mitsuba"]["ok"]:
        advice.append(
            f"Rendering is {llvm.SLOWDOWN}, for want of a libLLVM that works; to install one: {llvm.install_command()}"
        )
    override = found.get("override")
    first = next(iter(found.get("candidates", [])), None)
    if override and first and not first["ok"]:
        advice.append(
            f"{llvm.OVERRIDE}={override} cannot be used ({first['reason']}); to have one chosen: unset {llvm.OVERRIDE}"
        )
    forced = os.environ.get(llvm.FORCED_VARIANT)
    if forced and forced != report["variant"]:
        advice.append(
            f"{llvm.FORCED_VARIANT}={forced} cannot be had here; to have one chosen: unset {llvm.FORCED_VARIANT}"
        )
    elif forced == llvm.SCALAR_VARIANT and found["ok"]:
        advice.append(f"{llvm.FORCED_VARIANT} forces the slow variant; to have one chosen: unset {llvm.FORCED_VARIANT}")
    return advice


def _status(report: Report) -> str:
    needed = ("python", "packages", *NATIVE)
    if report["variant"] is None or not all(report[name]["ok"] for name in needed):
        return FAILED
    return OK if report["variant"] == llvm.LLVM_VARIANT and report["cache"]["ok"] else DEGRADED


def _rows(diagnosis: Report) -> list[tuple[str, Report]]:
    """Name, `ok` and text of each line of the printed table."""
    rows = [
        _row(diagnosis, "python", lambda found: f"{found['version']}, {found['executable']}"),
        _row(diagnosis, "platform", lambda found: f"{found['name']}"),
        _row(
            diagnosis,
            "cpu",
            lambda found: (
                f"{found['cores']} cores, {found['usable_cores']} usable, {found['threads'] or 'unknown'} threads"
            ),
        ),
        _row(
            diagnosis,
            "packages",
            lambda found: ", ".join(f"{name} {version}" for name, version in found["versions"].items()),
        ),
        _row(diagnosis, "mitsuba", lambda found: f"{llvm.SCALAR_VARIANT} renders; {len(found['available'])} variants"),
        _row(diagnosis, "llvm", lambda found: f"{found['chosen']}"),
    ]
    for candidate in diagnosis["llvm"].get("candidates", []):
        text = f"version {candidate['version'] or 'unknown'}: {candidate['reason']}"
        rows.append(("  candidate", {"ok": candidate["ok"], "text": f"{candidate['path']}, {text}"}))
    return [
        *rows,
        _row(diagnosis, "exr", lambda found: f"{len(found['layers'])} float32 layers written and read back"),
        _row(diagnosis, "netcdf", lambda found: "a dataset written and read back"),
        _row(diagnosis, "opencv", lambda found: f"{found['version']}"),
        _row(diagnosis, "cache", lambda found: f"{found['directory']}"),
    ]


def _row(diagnosis: Report, name: str, describe: Callable[[Report], str]) -> tuple[str, Report]:
    found = diagnosis[name]
    return name, {"ok": found["ok"], "text": describe(found) if found["ok"] else found["reason"]}
