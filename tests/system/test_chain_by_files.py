"""`mantis render`, `expose` and `detect`, chained through files, give exactly what the chain gives in one process."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments import chain
from experiments.reporting import detection
from experiments.reporting.plain import plain
from experiments.scenario import Scenario
from scenes.files import exr
from scenes.render.transport import TransportBasis

Mantis = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def basis_file(small_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The basis of the small scenario as a new process of the command line writes it."""
    path = tmp_path_factory.mktemp("render") / "basis.exr"
    command = [sys.executable, "-m", "experiments.cli", "render", str(small_file), "-o", str(path), "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")
    assert json.loads(run.stdout)["out"] == str(path)
    return path


def in_one_process(scenario: Scenario, basis: TransportBasis, illumination: str) -> tuple[chain.Frame, chain.Detection]:
    """The chain from a basis to a detection, without files."""
    rate = chain.electron_rate(scenario, basis, illumination)
    seconds = chain.solve_exposure(scenario, chain.link_budget(scenario, illumination), scenario.exposure_s)
    frame = chain.expose(scenario, rate, illumination, seconds)
    return frame, chain.detect(chain.Belief.of(scenario), frame.dn)


def test_a_rendered_file_holds_the_basis_bit_by_bit(
    basis_file: Path, small: Scenario, small_basis: TransportBasis
) -> None:
    """Rendered by two processes, so this also says that rendering repeats to the last bit."""
    read = exr.read_basis(basis_file)
    assert read.nodes_nm == small_basis.nodes_nm
    for illumination, images in small_basis.layers.items():
        assert read.layers[illumination].dtype == np.float32
        np.testing.assert_array_equal(read.layers[illumination], images)
    assert read.attributes["scenario_hash"] == small.digest()
    assert read.attributes["seed"] == small.seed
    chain.check_geometry(small, read, basis_file)


@pytest.mark.parametrize("illumination", ["eclipse", "sunlit"])
def test_frames_and_sightings_by_files_equal_those_of_one_process(
    mantis: Mantis,
    basis_file: Path,
    small_file: Path,
    small: Scenario,
    small_basis: TransportBasis,
    illumination: str,
    tmp_path: Path,
) -> None:
    frame, seen = in_one_process(small, small_basis, illumination)
    png, electrons, record = tmp_path / "frame.png", tmp_path / "electrons.exr", tmp_path / "detection.json"
    assert mantis("expose", basis_file, small_file, "-o", png, "--set", f"illumination={illumination}")[0] == 0
    assert mantis("expose", basis_file, small_file, "-o", electrons, "--set", f"illumination={illumination}")[0] == 0
    written = cv2.imread(str(png), cv2.IMREAD_UNCHANGED)
    assert written.dtype == np.uint16
    np.testing.assert_array_equal(written, frame.dn)
    np.testing.assert_array_equal(exr.read_channels(electrons)[0]["electrons"], frame.electrons)

    status, out, error = mantis("detect", png, small_file, "--json", "-o", record, "--require", "pose")
    assert (status, error) == (0, "")
    expected = json.loads(json.dumps(plain(detection.as_record(seen))))
    assert expected["detected"]
    assert expected["pose"] is not None
    assert json.loads(out) == expected
    assert json.loads(record.read_text(encoding="utf-8")) == expected


def test_a_new_process_gives_the_same_bytes_and_another_seed_other_noise(
    mantis: Mantis, basis_file: Path, small_file: Path, small: Scenario, small_basis: TransportBasis, tmp_path: Path
) -> None:
    def run(*arguments: object) -> str:
        command = [sys.executable, "-m", "experiments.cli", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    first, again, other = (tmp_path / f"{name}.png" for name in ("first", "again", "other"))
    assert run("expose", basis_file, small_file, "-o", first, "--quiet") == ""
    assert mantis("expose", basis_file, small_file, "-o", again)[0] == 0
    assert mantis("expose", basis_file, small_file, "-o", other, "--seed", 2)[0] == 0
    assert first.read_bytes() == again.read_bytes()
    one, two = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (first, other))
    assert np.mean(one != two) > 0.8
    seen = in_one_process(small, small_basis, "eclipse")[1]
    assert json.loads(run("detect", first, small_file, "--json")) == json.loads(json.dumps(detection.as_record(seen)))


def test_renders_and_exposures_repeat_byte_by_byte(mantis: Mantis, small_file: Path, tmp_path: Path) -> None:
    coarse = ("--set", "render.marker_rays=20000", "--set", "illumination=sunlit")
    for name in ("a", "b"):
        assert mantis("render", small_file, "-o", tmp_path / f"{name}.exr", *coarse)[0] == 0
        for suffix in ("png", "electrons.exr"):
            out = tmp_path / f"{name}.{suffix}"
            assert mantis("expose", tmp_path / f"{name}.exr", small_file, "-o", out, *coarse)[0] == 0
    for suffix in ("exr", "png", "electrons.exr"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes(), suffix
    other = tmp_path / "c.png"
    assert mantis("expose", tmp_path / "a.exr", small_file, "-o", other, *coarse, "--trial", 1)[0] == 0
    assert other.read_bytes() != (tmp_path / "a.png").read_bytes()


def test_a_basis_and_an_image_from_elsewhere_are_taken(
    mantis: Mantis, small_file: Path, small: Scenario, small_basis: TransportBasis, tmp_path: Path
) -> None:
    """Rationale: any stage can be replaced by someone else's, whose files do not carry this project's attributes."""
    exr.write_basis(TransportBasis(small_basis.nodes_nm, small_basis.layers), tmp_path / "foreign.exr")
    assert mantis("expose", tmp_path / "foreign.exr", small_file, "-o", tmp_path / "foreign.png")[0] == 0
    frame, _ = in_one_process(small, small_basis, "eclipse")
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "foreign.png"), cv2.IMREAD_UNCHANGED), frame.dn)

    eight = np.clip(frame.dn / frame.dn.max() * 255, 0, 255).astype(np.uint8)
    images = {
        "grey.png": eight,
        "colour.png": cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR),
        "grey.tiff": eight,
        "grey.pgm": eight,
    }
    for name, image in images.items():
        cv2.imwrite(str(tmp_path / name), image)
    exr.write_channels({"Y": (frame.dn / 4095).astype(np.float32)}, {}, tmp_path / "linear.exr")
    for name in (*images, "linear.exr"):
        status, out, _ = mantis("detect", tmp_path / name, small_file, "--json", "--require", "pose")
        assert status == 0, name
        assert json.loads(out)["id"] == small.marker.identity
