"""What a worker does: records of some cases, transport rendered or read once for each geometry among them."""

from __future__ import annotations

import hashlib
import textwrap
import threading
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from experiments import chain
from experiments.chain import trials
from experiments.scenario import Scenario
from scenes.files.cache import TransportCache, default_folder
from scenes.render.transport import TransportBasis

#: Index of a case and its scenario.
Case = tuple[int, Scenario]
#: What is known of a case, as plain data that JSON keeps to the last bit.
Record = dict[str, Any]
#: Index of a case, its record, and how many bases were rendered for it.
Done = tuple[int, Record, int]

_PACKAGES = ("radiometry", "materials", "scenes", "detector", "experiments")
#: Folders of the last of them that cases of a sweep run through.
_ROOMS = ("experiments/scenario", "experiments/chain", "experiments/studies/sweep")
_LIBRARIES = ("mitsuba", "drjit", "numpy", "scipy", "opencv-python-headless", "colour-science", "numba")
#: Threads of one process would share the renderer's state.
_ONE_AT_A_TIME = threading.Lock()


class OtherSoftware(RuntimeError):
    """A worker runs another version, so its results would not be those that this process gives."""


@cache
def software() -> str:
    """Hash of this project's source and data and of the versions that it computes with, 16 hexadecimal digits."""
    digest = hashlib.sha256(" ".join(f"{name} {version(name)}" for name in _LIBRARIES).encode())
    for package in _PACKAGES:
        for name, entry in sorted(_sources(files(package), package)):
            digest.update(name.encode() + entry.read_bytes())
    return digest.hexdigest()[:16]


def _sources(folder: Traversable, name: str) -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        inner = f"{name}/{entry.name}"
        if entry.is_dir() and entry.name != "__pycache__" and _runs_through(inner):
            yield from _sources(entry, inner)
        elif entry.is_file() and entry.name.endswith((".py", ".toml", ".csv", ".json")):
            yield inner, entry


def _runs_through(folder: str) -> bool:
    """Whether cases of a sweep run through a folder or one inside it: not through other studies and the command line."""
    inside = any(folder == room or folder.startswith(f"{room}/") or room.startswith(f"{folder}/") for room in _ROOMS)
    return inside or not folder.startswith("experiments/")


def compute_task(cases: Sequence[Case], expected: str) -> list[Done]:
    """Records of a task's cases, in a worker.

    Raises:
        OtherSoftware: when this process runs another version than `expected`, a `software` hash.
    """
    if software() != expected:
        import socket

        raise OtherSoftware(
            f"the worker on {socket.gethostname()} runs other software ({software()}, here {expected}); install the same "
            "version of mantis-radiometry and of what it needs on all machines"
        )
    with _ONE_AT_A_TIME:
        return list(compute(cases))


def compute(cases: Sequence[Case]) -> Iterator[Done]:
    """Records of cases, one geometry and one illumination after the other; for a case that cannot be computed, the reason."""
    store = TransportCache(default_folder())
    geometries: dict[str, list[Case]] = {}
    for index, scenario in cases:
        geometries.setdefault(transport_key(scenario), []).append((index, scenario))
    counted = 0
    bases = _bases(store, [members[0][1] for members in geometries.values()])
    for members, basis in zip(geometries.values(), bases, strict=True):
        rendered, counted = store.rendered - counted, store.rendered
        if isinstance(basis, Exception):
            yield from ((index, failure(basis), 0) for index, _ in members)
            continue
        for alike in by_illumination(members):
            for index, record in _of_one_illumination(alike, basis):
                yield index, record, rendered
                rendered = 0


def transport_key(scenario: Scenario) -> str:
    """Cases with the same key share one rendering."""
    return f"{chain.geometry_digest(scenario)} {chain.quality(scenario)}"


def failure(error: Exception) -> Record:
    """The record of a case that could not be computed; some libraries' messages run over pages."""
    return {"reason": textwrap.shorten(f"{type(error).__name__}: {error}", 160, placeholder=" …")}


def _bases(store: TransportCache, scenarios: Sequence[Scenario]) -> Iterator[TransportBasis | Exception]:
    """Transport of every scenario, in order, rendered together; where it cannot be had, what was raised."""
    done = 0
    try:
        for basis in store.bases((chain.view(s), chain.quality(s)) for s in scenarios):
            yield basis
            done += 1
    except Exception:  # whose, and whether it harms the others, is found out one by one
        for scenario in scenarios[done:]:
            try:
                yield store.basis(chain.view(scenario), chain.quality(scenario))
            except Exception as error:  # recorded, so that one impossible geometry does not end ten thousand
                yield error


def by_illumination(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases that differ in their exposure alone, together."""
    groups: dict[Scenario, list[Case]] = {}
    for index, scenario in cases:
        groups.setdefault(scenario.model_copy(update={"exposure_s": "auto"}), []).append((index, scenario))
    return list(groups.values())


def _of_one_illumination(cases: Sequence[Case], basis: TransportBasis) -> Iterator[tuple[int, Record]]:
    """Records of cases that differ in their exposure alone."""
    scenario, left = cases[0][1], list(cases)
    illumination = scenario.illumination
    try:
        rate = chain.electron_rate(scenario, basis, illumination)
        prepared = chain.Case(scenario, illumination)
        budget = prepared.link_budget_beside(rate)
    except Exception as error:
        yield from ((index, failure(error)) for index, _ in cases)
        return
    together = len(left)  # until one of them fails; whose fault it is, is then found out one by one
    while left:
        try:
            seconds = [chain.solve_exposure(scenario, budget, case.exposure_s) for _, case in left[:together]]
            known = trials.known_values(prepared, budget, rate, seconds)
            for k, drawn in enumerate(trials.draws(prepared, rate, seconds)):
                values = {name: column[k] for name, column in known.items()}
                variance = chain.renderer_variance_fraction(scenario, basis, illumination, seconds[k], rate)
                beside = {"px_per_bit": budget.px_per_bit, "renderer_variance_fraction": variance}
                yield left.pop(0)[0], _record({**values, **drawn.values, **beside}, drawn)
        except Exception as error:
            if together == 1:
                yield left.pop(0)[0], failure(error)
            together = 1


def _record(values: dict[str, float], drawn: trials.Trials) -> Record:
    return {
        "values": {name: float(value) for name, value in values.items()},
        "detected": drawn.detected.astype(int).tolist(),
        "attitude_error_deg": drawn.attitude_error_deg.tolist(),
        "range_error": drawn.range_error.tolist(),
        "pose_covariance": drawn.pose_covariance.tolist(),
        "reason": drawn.reason,
    }
