"""Verification of the requirements: complete, able to fail, and silent about what it cannot know."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from experiments.scenario import load_scenario
from experiments.thesis.layout.placement import THICKNESS_MAX_M
from experiments.thesis.requirements import checks, study
from experiments.thesis.requirements.catalogue import PRINTED, catalogue
from experiments.thesis.requirements.checks import CHECKS, Finding
from experiments.thesis.requirements.evidence import MAKERS, Evidence, Missing

RESULTS = Path(__file__).parents[3] / "docs" / "data"


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return Evidence(RESULTS, load_scenario())


def test_every_requirement_of_the_thesis_is_there_once() -> None:
    names = [r.identity for r in catalogue()]
    assert names == [f"SYS-REQ-{k}" for k in range(1, 15)] + [f"STA-REQ-{k}" for k in range(1, 10)]
    assert set(CHECKS) == {r.identity for r in catalogue() if not r.children}
    children = {child for r in catalogue() for child in r.children}
    assert children == {f"SYS-REQ-{k}" for k in range(1, 15)}


def test_committed_results_verify_everything_that_can_be() -> None:
    """No table that a check reads is missing from the committed ones."""
    verified = study.verify(Evidence(RESULTS, load_scenario()))
    assert [v.requirement.identity for v in verified if v.finding.missing] == []
    for v in verified:
        assert v.finding.figure
        assert v.agrees or v.remark, f"{v.requirement.identity} differs from the thesis without an explanation"


def test_without_results_nothing_is_claimed_but_geometry(tmp_path: Path) -> None:
    verified = study.verify(Evidence(tmp_path, load_scenario()))
    lacking = {v.requirement.identity: v for v in verified if v.finding.missing}
    assert {"SYS-REQ-1", "SYS-REQ-3", "SYS-REQ-4", "SYS-REQ-5", "SYS-REQ-13"} <= set(lacking)
    for v in lacking.values():
        assert v.finding.verdict == "not verifiable here"
        assert v.agrees
        assert not v.remark
    assert "fov-cone.csv is not in" in lacking["SYS-REQ-1"].finding.figure
    assert "mantis fov makes it" in lacking["SYS-REQ-1"].finding.figure
    assert next(v for v in verified if v.requirement.identity == "SYS-REQ-6").finding.verdict == "met"


def changed(tmp_path: Path, name: str, old: str, new: str) -> Evidence:
    """The committed results with one table changed."""
    for table in MAKERS:
        if (RESULTS / table).is_file():
            shutil.copy(RESULTS / table, tmp_path / table)
    text = (tmp_path / name).read_text(encoding="utf-8")
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new), encoding="utf-8")
    return Evidence(tmp_path, load_scenario())


def test_light_fails_where_one_lit_cell_fails(tmp_path: Path, evidence: Evidence) -> None:
    assert checks.illumination(evidence).verdict == "met"
    rows = [r for r in (RESULTS / "glare.csv").read_text().splitlines() if r.startswith("pair,5,45,")]
    assert len(rows) == 1
    assert (
        checks.illumination(changed(tmp_path, "glare.csv", rows[0], rows[0].replace("True", "False"))).verdict
        == "not met"
    )


def test_accuracy_fails_for_two_reasons(tmp_path: Path, evidence: Evidence) -> None:
    """As designed for want of resolved markers; with larger errors also by its margin."""
    finding = checks.accuracy(evidence)
    assert finding.verdict == "not met"
    assert finding.margin == checks.reach(evidence).margin
    row = next(
        r
        for r in (RESULTS / "montecarlo-accuracy.csv").read_text(encoding="utf-8").splitlines()
        if r.startswith("wide,right,two-start,20,")
    )
    cells = row.split(",")
    cells[4] = "9.9 ± 0.1"
    worse = checks.accuracy(changed(tmp_path, "montecarlo-accuracy.csv", row, ",".join(cells)))
    assert worse.margin < 0.1


def test_sizes_fail_with_other_markers_and_cameras(evidence: Evidence) -> None:
    flat = evidence.scenario.marker.model_copy(update={"element_depth_fraction": 0.01})
    thin = Evidence(evidence.folder, evidence.scenario.at(marker=flat.model_dump()))
    assert checks.flat(thin).verdict == "met"
    assert checks.flat(evidence).verdict == "not met"
    assert checks.flat(evidence).margin == pytest.approx(THICKNESS_MAX_M / (10 * evidence.scenario.marker.thickness_m))
    longer = evidence.scenario.camera.model_copy(update={"focal_length_m": 0.035})
    far = Evidence(evidence.folder, evidence.scenario.at(camera=longer.model_dump()))
    assert checks.reach(evidence).verdict == "not met"
    assert checks.reach(far).margin > 1


def test_pace_times_the_detector(evidence: Evidence) -> None:
    finding = checks.pace(evidence)
    assert finding.verdict == "met"
    assert "ms on this machine" in finding.figure
    assert 0 < evidence.detection_seconds(1) < 5


def test_a_stakeholders_requirement_is_as_good_as_the_worst_of_its_children() -> None:
    parent = next(r for r in catalogue() if len(r.children) == 2)
    first, second = parent.children
    good, bad, open_ = Finding("met", "", ""), Finding("not met", "", ""), Finding("not verifiable here", "", "")
    assert study.follows(parent, {first: good, second: good}).verdict == "met"
    assert study.follows(parent, {first: good, second: open_}).verdict == "not verifiable here"
    assert study.follows(parent, {first: open_, second: bad}).verdict == "not met"


def test_remarks_are_given_where_the_thesis_differs_in_verdict_or_reason() -> None:
    found = {r.identity: r for r in catalogue()}
    assert found["SYS-REQ-14"].remark("not met")
    assert not found["SYS-REQ-14"].remark("met")
    assert found["SYS-REQ-7"].remark("met")  # same verdict, another reason
    assert set(PRINTED.values()) == {"met", "not met", "not verifiable here"}


def test_unknown_tables_are_missing(evidence: Evidence, tmp_path: Path) -> None:
    with pytest.raises(Missing, match=r"glare\.csv is not in .*; mantis glare makes it"):
        Evidence(tmp_path, evidence.scenario).rows("glare.csv")


def test_the_verb_writes_and_requires(tmp_path: Path, mantis: Callable[..., tuple[int, str, str]]) -> None:
    status, out, err = mantis("requirements", "--results", RESULTS, "--out", tmp_path)
    assert (status, err) == (0, "")
    assert "SYS-REQ-14" in out
    for name in (
        "requirements.nc",
        "report.html",
        "data/requirements-requirements.csv",
        "figures/requirements-margins.svg",
    ):
        assert (tmp_path / name).stat().st_size > 0
    assert mantis("requirements", "--results", RESULTS, "--out", tmp_path, "--require", "met")[0] == 4
