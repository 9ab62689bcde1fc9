"""Finds a libLLVM that Dr.Jit can use and picks Mitsuba's variant, before Mitsuba is imported.

Mitsuba's fast variants compile through Dr.Jit, which loads whatever libLLVM it finds first. Some end the process:
measured with Dr.Jit 1.5 on x86-64, versions 15 and 16 abort in code generation ("Cannot select … fmaximum") at the
first `dr.maximum`, which no Python handler can catch, and 14 is refused; 17, 18, 19 and 22 work. So a library is tried
in a subprocess first and the verdict is cached: a normal start costs a directory listing and the reading of one small
file.

Environment: DRJIT_LIBLLVM_PATH names a library to try first; MANTIS_VARIANT forces one of `VARIANTS`.
"""

from __future__ import annotations

import glob
import json
import logging
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from scenes.atomic import atomic_write

LLVM_VARIANT = "llvm_ad_spectral"
SCALAR_VARIANT = "scalar_spectral"
VARIANTS = (LLVM_VARIANT, SCALAR_VARIANT)

OVERRIDE = "DRJIT_LIBLLVM_PATH"
FORCED_VARIANT = "MANTIS_VARIANT"
OLDEST_MAJOR = 16  # 14 is refused by Dr.Jit 1.5 and 15 aborts; 16 does on x86-64 only, so it is left to the probe
PREFERRED_MAJORS = (19, 18, 20, 17, 21, 22, 16)  # the most used with Dr.Jit 1.5 first; others after these, newest first
PROBE_TIMEOUT_S = 120.0  # assumption: a hundred times the probe's usual second covers a loaded machine

SEARCH_DIRECTORIES = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib/llvm/*/lib64",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    "/home/linuxbrew/.linuxbrew/opt/llvm*/lib",
)
# `python -m benchmarks variants` prints this ratio for a transport basis.
SLOWDOWN = "about a hundred times slower"

_LIBRARY_NAME = re.compile(r"libLLVM(?:-(\d+(?:\.\d+)*))?(?:\.so(?:\.(\d+(?:\.\d+)*))?|\.dylib)")
_VERSIONED_DIRECTORY = re.compile(r"/llvm(?:[-@/]|/[^/]*/)?(\d+(?:\.\d+)*)[^/]*/lib")

# Compiles the instruction that old versions cannot select, then a whole render: ray tracing, virtual calls and a film.
_PROBE = f"""
import resource
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import drjit as dr
import mitsuba as mi
mi.set_variant("{LLVM_VARIANT}")
if list(dr.maximum(mi.Float([1, 2, 3]), 2)) != [2, 2, 3] or list(dr.minimum(mi.Float([1, 2, 3]), 2)) != [1, 2, 2]:
    raise SystemExit("dr.maximum or dr.minimum gives wrong values")
white = {{"type": "uniform", "value": 1.0}}
scene = mi.load_dict({{
    "type": "scene",
    "integrator": {{"type": "direct"}},
    "plate": {{"type": "rectangle", "bsdf": {{"type": "diffuse", "reflectance": white}}}},
    "light": {{"type": "constant", "radiance": white}},
    "sensor": {{
        "type": "perspective",
        "fov": 10,
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 2], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {{"type": "hdrfilm", "width": 4, "height": 4, "component_format": "float32"}},
    }},
}})
mean = float(dr.mean(mi.render(scene, spp=256).array)[0])
if not 0.8 < mean < 1.2:
    raise SystemExit(f"a white plate under unit radiance renders as {{mean:.3g}}")
print(".".join(str(part) for part in dr.detail.llvm_version()))
"""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Library:
    """One libLLVM file.

    Attributes:
        path: of the file.
        version: what the file's name says, for example "19.1"; None when it says nothing.
    """

    path: str
    version: str | None

    @property
    def major(self) -> int | None:
        """First number of the version, or None."""
        return int(self.version.split(".")[0]) if self.version else None


@dataclass(frozen=True)
class Verdict:
    """Whether a library compiles and renders.

    Attributes:
        usable: whether it does.
        reason: why, or why not, in one line.
        version: what the library itself reports.
        conclusive: False when another try may end differently (time-out, a missing file, killed from outside).
    """

    usable: bool
    reason: str
    version: str | None = None
    conclusive: bool = True  # False when a retry may end otherwise (time-out, a missing file, killed from outside)


@dataclass(frozen=True)
class Outcome:
    """How a subprocess ended.

    Attributes:
        failure: None, or one line that says why it failed.
        output: its standard output.
        conclusive: False when another try may end differently.
    """

    failure: str | None
    output: str
    conclusive: bool = True


def run_isolated(
    code: str, environment: Mapping[str, str] | None = None, timeout_s: float = PROBE_TIMEOUT_S
) -> Outcome:
    """Run Python code in a subprocess of the same interpreter, so that a crash there is only a line of text here.

    It never raises for anything that the code does.

    Args:
        code: the Python code.
        environment: variables to add to those of this process.
        timeout_s: time after which the subprocess is stopped [s].
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=dict(os.environ) | dict(environment or {}),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired:
        return Outcome(f"no answer within {timeout_s:g} s", "", conclusive=False)
    except OSError as error:
        return Outcome(f"could not start a subprocess: {error}", "", conclusive=False)
    if done.returncode == 0:
        return Outcome(None, done.stdout)
    # A native message comes before the traceback it causes and says more; so does the first of chained exceptions.
    told = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith((" ", "Traceback"))]
    detail = told[0][:300] if told else ""
    if done.returncode > 0:
        return Outcome(detail or f"exit status {done.returncode}", done.stdout, conclusive=False)
    number = -done.returncode
    name = next((known.name for known in signal.Signals if known == number), f"signal {number}")
    killed_from_outside = number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
    return Outcome(f"killed by {name}" + (f": {detail}" if detail else ""), done.stdout, not killed_from_outside)


def find_libraries() -> list[Library]:
    """All libLLVM files on this machine, in the order in which they should be tried; the override comes first."""
    found: dict[str, Library] = {}
    directories = [
        *os.environ.get("LD_LIBRARY_PATH", "").split(":"),
        str(Path(sys.prefix) / "lib"),
        *SEARCH_DIRECTORIES,
    ]
    for directory in filter(None, directories):
        for name in glob.glob(f"{directory}/libLLVM*"):
            if _LIBRARY_NAME.fullmatch(os.path.basename(name)) and os.path.isfile(name):
                path = os.path.realpath(name)
                found.setdefault(path, Library(path, version_from_name(name) or version_from_name(path)))
    libraries = sorted(found.values(), key=_preference)
    override = os.environ.get(OVERRIDE)
    if not override:
        return libraries
    path = os.path.realpath(override) if os.path.exists(override) else override
    return [Library(path, version_from_name(path)), *(library for library in libraries if library.path != path)]


def version_from_name(path: str) -> str | None:
    """Version in a libLLVM's file name or in its folder's ("…/libLLVM.so.19.1", "…/llvm@19/lib/…"), or None.

    Args:
        path: of the file.
    """
    name = _LIBRARY_NAME.fullmatch(os.path.basename(path))
    if name is None:
        return None
    directory = _VERSIONED_DIRECTORY.search(path)
    return name[1] or name[2] or (directory[1] if directory else None)


def probe(library: Library) -> Verdict:
    """Compile a kernel and render a plate with a library, in a subprocess. This takes about a second.

    Args:
        library: to try.
    """
    with tempfile.TemporaryDirectory(prefix="mantis-") as kernels:  # an empty kernel cache, so that it must compile
        outcome = run_isolated(_PROBE, {OVERRIDE: library.path, "DRJIT_CACHE_DIR": kernels})
    if outcome.failure is not None:
        return Verdict(False, outcome.failure, conclusive=outcome.conclusive)
    return Verdict(True, "compiles and renders", outcome.output.strip().splitlines()[-1])


def verdict_on(library: Library, fresh: bool = False) -> Verdict:
    """Verdict on a library: from its version where that is enough, else from the cache, else by a probe.

    Args:
        library: to judge.
        fresh: whether to probe it even where the cache knows it.
    """
    if library.major is not None and library.major < OLDEST_MAJOR:
        return Verdict(False, f"too old: Dr.Jit needs version {OLDEST_MAJOR} or newer", library.version)
    key = _cache_key(library)
    known = _read_cache()
    if key is not None and key in known and not fresh:
        return known[key]
    verdict = probe(library)
    if key is not None and verdict.conclusive:
        _write_cache(_read_cache() | {key: verdict})
    return verdict


def choose_library() -> Library | None:
    """First usable library in the order of `find_libraries`, or None.

    Where DRJIT_LIBLLVM_PATH names a library that cannot be used, a line in the log says so and the next one is tried.
    """
    override = os.environ.get(OVERRIDE)
    refused = ""
    chosen = None
    for position, library in enumerate(find_libraries()):
        verdict = verdict_on(library)
        if verdict.usable:
            chosen = library
            break
        if position == 0 and override:
            refused = f"{OVERRIDE}={override} cannot be used ({verdict.reason})"
    if refused:
        _warn_once(f"{refused}; " + (f"using {chosen.path} instead" if chosen else "and no other libLLVM can either"))
    return chosen


def select_variant(requested: str | None = None) -> str:
    """Name of the Mitsuba variant to use. It points Dr.Jit to the chosen libLLVM, so call it before Mitsuba is imported.

    Args:
        requested: forces a variant, and so does MANTIS_VARIANT where this is None. Left free, the variant is
            `llvm_ad_spectral` where a libLLVM passes the probe, and otherwise `scalar_spectral` with a warning in the log.

    Raises:
        ValueError: when the variant is not in `VARIANTS`.
        RuntimeError: when the LLVM variant is forced and no library can be used.
    """
    forced = requested or os.environ.get(FORCED_VARIANT) or None
    if forced is not None and forced not in VARIANTS:
        raise ValueError(f"{FORCED_VARIANT}: got {forced!r}, expected {' or '.join(VARIANTS)}")
    if forced == SCALAR_VARIANT:
        return SCALAR_VARIANT
    library = choose_library()
    if library is not None:
        os.environ[OVERRIDE] = library.path
        return LLVM_VARIANT
    if forced == LLVM_VARIANT:
        raise RuntimeError(f"{LLVM_VARIANT} needs a libLLVM that works; to install one: {install_command()}")
    _warn_once(f"no usable libLLVM: rendering with {SCALAR_VARIANT}, {SLOWDOWN}; to install one: {install_command()}")
    return SCALAR_VARIANT


def activate_variant(requested: str | None = None) -> str:
    """Select the variant as `select_variant` does, make it Mitsuba's current one, and return its name.

    Args:
        requested: as for `select_variant`.

    Raises:
        ValueError: when the variant is not in `VARIANTS`.
        RuntimeError: when the LLVM variant is forced and no library can be used, or when Mitsuba itself cannot be loaded.
    """
    variant = select_variant(requested)
    try:
        import mitsuba as mi

        mi.set_variant(variant)
    except (ImportError, NameError) as error:  # Dr.Jit's own handler of a missing system library ends in a NameError
        cause = error.__context__ or error
        raise RuntimeError(f"Mitsuba cannot be loaded ({cause}); to see what to install: mantis doctor") from error
    return variant


def install_command() -> str:
    """The command that installs a suitable libLLVM on this machine."""
    if shutil.which("apt-get"):
        return "sudo apt-get update && sudo apt-get install libllvm19"
    if shutil.which("brew"):
        return "brew install llvm@19"
    return f"install LLVM 19 with the system's package manager, then set {OVERRIDE} to its libLLVM"


def cache_directory() -> Path:
    """Where verdicts are kept: $XDG_CACHE_HOME/mantis, or ~/.cache/mantis."""
    root = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(root) / "mantis"


def _preference(library: Library) -> tuple[int, int]:
    major = library.major
    if major in PREFERRED_MAJORS:
        return 0, PREFERRED_MAJORS.index(major)
    return (2, 0) if major is None else (1, -major)


def _cache_key(library: Library) -> str | None:
    """Identity of library, software and machine; None for a bare name that the loader resolves, which may change."""
    try:
        status = os.stat(library.path)
        software = [f"{name} {metadata.version(name)}" for name in ("drjit", "mitsuba")]
    except (OSError, metadata.PackageNotFoundError):
        return None
    file = [library.path, str(status.st_mtime_ns), str(status.st_size)]
    machine = [platform.machine(), platform.node()]  # machines may share a home directory
    return " | ".join([*file, *software, *machine])


def _cache_file() -> Path:
    return cache_directory() / "llvm.json"


def _read_cache() -> dict[str, Verdict]:
    try:
        return {key: Verdict(**entry) for key, entry in json.loads(_cache_file().read_text("utf-8")).items()}
    except (OSError, ValueError, TypeError, AttributeError):  # absent, unreadable or damaged: probe again
        return {}


def _write_cache(verdicts: Mapping[str, Verdict]) -> None:
    try:
        text = json.dumps({key: asdict(verdict) for key, verdict in verdicts.items()}, indent=1)
        with atomic_write(_cache_file()) as temporary:
            temporary.write_text(text, "utf-8")
    except OSError as error:  # works without, a second slower at each start; `mantis doctor` says so too
        _log.debug("cannot keep the verdict on libLLVM: %s", error)


@cache
def _warn_once(message: str) -> None:
    _log.warning(message)


if __name__ == "__main__":  # for scripts/setup-llvm.sh: names the library that will be used, or fails without a word
    usable = choose_library()
    if usable is None:
        sys.exit(1)
    print(f"setup: rendering uses {usable.path}")
