"""The list of materials: rows, figures, the documentation page, the verb, and materials that a scenario names by path."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from experiments.cli.main import main
from experiments.scenario import ScenarioError, load_scenario
from experiments.studies.materials.page import as_csv, page
from experiments.studies.materials.plan import FULL, Plan
from experiments.studies.materials.study import MaterialRow, MaterialsResult, run
from materials import library
from materials.goniometer import goniometer_scan

ROOT = Path(__file__).parents[3]
OWN = """
title = "my tape"
source = "my bench"
date = "2026-11"
uncertainty = "5 percent"
assumption = false
[diffuse]
albedo = 0.25
"""


@pytest.fixture(scope="module")
def library_result() -> MaterialsResult:
    return run(FULL)


@pytest.fixture(scope="module")
def rows(library_result: MaterialsResult) -> tuple[MaterialRow, ...]:
    return library_result.rows


def test_there_is_a_row_for_every_material_with_its_source(rows: tuple[MaterialRow, ...]) -> None:
    assert [row.name for row in rows] == list(library.available())
    for row in rows:
        assert 0 < row.albedo_0 <= 1
        assert 0 < row.albedo_60 <= 1
        assert row.source
        assert row.life == ("end" if row.name.endswith("_eol") else "beginning")


def test_peaks_are_those_of_the_lobes(rows: tuple[MaterialRow, ...]) -> None:
    peak = {row.name: row.peak_per_sr for row in rows}
    # R_A at 0.1 deg and 4 deg entrance is f cos²β, over the diffuse floor of 0.1; at 5 deg a little less.
    assert peak["tape_type_xi"] == pytest.approx(830 / np.cos(np.radians(4)) ** 2, rel=0.01)
    assert peak["diffuse_reference"] == pytest.approx(0.5 / np.pi)
    mirror = library.load("mli_bare")
    assert peak["mli_bare"] == pytest.approx(float(mirror.gloss(850.0)) / (4 * np.pi * 0.03**2), rel=0.02)


def test_a_mirror_glints_at_twice_the_entrance_angle() -> None:
    angles = np.linspace(0.05, 90, 1800)
    brightest = angles[np.argmax(goniometer_scan(library.load("mli_bare"), 30.0, angles))]
    assert brightest == pytest.approx(60.0, abs=0.2)


def test_files_are_the_same_bytes_for_the_same_materials(tmp_path: Path) -> None:
    names = ("tape_type_xi", "tape_type_xi_eol", "mli_bare", "black_coating_eol")
    for folder in ("a", "b"):
        page(run(Plan(names)), "mantis materials").write(tmp_path / folder)
    written = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert [str(p) for p in written] == [
        "data/materials.csv",
        "figures/materials-lobes.svg",
        "figures/materials-spectra.svg",
        "materials.md",
        "report.html",
    ]
    for path in written:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
    table = list(csv.DictReader((tmp_path / "a" / "data" / "materials.csv").read_text(encoding="utf-8").splitlines()))
    assert [line["name"] for line in table] == list(names)


def test_the_committed_page_is_what_the_command_writes(library_result: MaterialsResult) -> None:
    made, rows = page(library_result, "mantis materials"), library_result.rows
    renew = "run `mantis materials -o docs`"
    assert (ROOT / "docs" / "materials.md").read_text(encoding="utf-8") == made.markdown(), renew
    assert (ROOT / "docs" / "data" / "materials.csv").read_text(encoding="utf-8") == as_csv(rows), renew


def test_the_verb_lists_every_material_within_110_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["materials"]) == 0
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 110
    for name in library.available():
        assert name in shown


def test_the_verb_names_sources_and_gives_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["materials", "acrylic_black"]) == 0
    assert "10706-195" in capsys.readouterr().out
    assert main(["materials", "acrylic_black", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["materials"]
    assert row["name"] == "acrylic_black"
    assert row["assumption"] is False


def test_the_verb_checks_a_users_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.toml").write_text(OWN.replace("0.25", "2.5"), encoding="utf-8")
    assert main(["materials", str(tmp_path / "own.toml")]) == 2
    assert "diffuse.albedo: 2.5, expected" in capsys.readouterr().err


def test_a_scenario_names_a_material_by_a_path_beside_it(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    (tmp_path / "case.toml").write_text('[target]\ntape_material = "own.toml"\n', encoding="utf-8")
    scenario = load_scenario(tmp_path / "case.toml")
    assert library.load(scenario.target.tape_material).title == "my tape"
    before = scenario.digest()
    (tmp_path / "own.toml").write_text(OWN.replace("0.25", "0.26"), encoding="utf-8")
    assert scenario.digest() != before


def test_a_scenario_with_a_wrong_material_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"^target\.tape_material: material 'velvet' is unknown; expected one of"):
        load_scenario(None, ("target.tape_material=velvet",))
    (tmp_path / "own.toml").write_text(OWN.replace("0.25", "2.5"), encoding="utf-8")
    (tmp_path / "case.toml").write_text('[target]\nface_material = "own.toml"\n', encoding="utf-8")
    with pytest.raises(
        ScenarioError, match=r"^target\.face_material: material .*own\.toml: diffuse\.albedo: 2\.5, expected"
    ):
        load_scenario(tmp_path / "case.toml")
