"""Fixtures of all tests: a small camera, its rendered transport, and the command line without a new process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

from experiments.scenario import Scenario, load_scenario
from scenes.render.transport import TransportBasis

#: The default scenario seen by the middle of its detector: the optics are the same, the frame renders 15 times faster.
SMALL = """\
range_m = 3.0

[camera]
width_px = 160
height_px = 160

[render]
frame_samples = 1
marker_rays = 300_000
"""

#: Exit status, standard output and standard error of a command.
Outcome = tuple[int, str, str]


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests neither read nor fill the user's cache of rendered transport."""
    before = os.environ.get("MANTIS_CACHE")
    os.environ["MANTIS_CACHE"] = str(tmp_path_factory.mktemp("transport"))
    yield
    if before is None:
        del os.environ["MANTIS_CACHE"]
    else:
        os.environ["MANTIS_CACHE"] = before


@pytest.fixture(scope="session")
def mi() -> ModuleType:
    """Mitsuba with an LLVM variant set; skips where no libLLVM can be had."""
    from scenes.llvm import LLVM_VARIANT, activate_variant

    if activate_variant() != LLVM_VARIANT:
        pytest.skip("needs a libLLVM that Dr.Jit can use (see `mantis doctor`)")
    import mitsuba

    return mitsuba


@pytest.fixture(scope="session")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario file: the middle of the default camera, 3 m from the marker."""
    path = tmp_path_factory.mktemp("scenario") / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def small(small_file: Path) -> Scenario:
    """The scenario of `small_file`."""
    return load_scenario(small_file)


@pytest.fixture(scope="session")
def small_basis(small: Scenario) -> TransportBasis:
    """The rendered transport of `small`; not to be changed."""
    from experiments import chain

    return chain.transport(small)


@pytest.fixture
def mantis(capfd: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Runs a command line in this process; what libraries write to the file descriptors is seen, too."""
    from experiments.cli.main import main

    def run(*arguments: object) -> Outcome:
        capfd.readouterr()
        status = main([str(a) for a in arguments])
        return status, *capfd.readouterr()

    return run
