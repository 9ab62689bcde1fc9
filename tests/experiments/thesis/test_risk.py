"""Failure modes: rates from tables, levels of the thesis's matrix, and what is told where tables are missing or wrong."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from experiments.scenario import Scenario
from experiments.studies.glare.failures import failure_rows
from experiments.studies.glare.plan import FULL
from experiments.studies.shared import failures, judge
from experiments.thesis.risk import study
from experiments.thesis.risk.page import page
from experiments.thesis.risk.plan import Plan
from experiments.thesis.virtual import summary

Mantis = Callable[..., tuple[int, str, str]]
RESULTS = Path(__file__).parents[3] / "docs" / "data"


def write(folder: Path, name: str, rows: list[dict[str, object]]) -> Path:
    """A table of a study in a folder of its own kind."""
    path = folder / "data" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def row(
    method: str, frames: int, counts: dict[str, object], errors: dict[str, object] | None = None
) -> dict[str, object]:
    """A row of physical-failures.csv in eclipse."""
    table = {failures.MODES[mode]: counts.get(mode, 0) for mode in failures.MODES}
    told = {heading: "–" for heading in failures.HEADINGS[len(table) :]}
    return {
        "illumination": "eclipse",
        "frames": "full",
        "method": method,
        "frames in all": frames,
        **table,
        **told,
        **(errors or {}),
    }


BEFORE, WINDOW, AFTER = "Mantis, thesis's pipeline", "its inner ArUco alone, window-refined", "Mantis, this project"


def physical(folder: Path) -> Path:
    """A folder with a table of rates that are known."""
    major = {failures.ATTITUDE["wrong_corners"]: "0.3", failures.RANGE["wrong_corners"]: "12"}
    minor = {failures.ATTITUDE["no_blob"]: "0.2", failures.RANGE["no_blob"]: "0.1"}
    rows = [
        row(BEFORE, 400, {"loss_of_aruco": 3, "no_blob": 39, "loss_of_elements": 200}, minor),
        row(WINDOW, 400, {"wrong_corners": 9, "no_blob": "–", "loss_of_elements": "–"}, major),
        row(AFTER, 400, {}),
    ]
    return write(folder, "physical-failures.csv", rows)


def test_levels_are_those_of_table_8_3_and_what_is_more_frequent_is_above() -> None:
    assert [study.level(rate) for rate in (0, 0.0099, 0.01, 0.0249, 0.025, 0.0999, 0.1, 1)] == [1, 1, 2, 2, 3, 3, 4, 4]


def test_intervals_are_exact() -> None:
    for failed, frames in ((0, 50), (3, 400), (399, 400), (50, 50)):
        low, high = study.Rate(failed, frames).interval
        # At either end the observed count, or a more extreme one, has a probability of 2.5 %.
        if failed:
            assert stats.binom.sf(failed - 1, frames, low) == pytest.approx(0.025)
        if failed < frames:
            assert stats.binom.cdf(failed, frames, high) == pytest.approx(0.025)
        assert low <= failed / frames <= high


def test_modes_are_those_of_the_studies_that_count_them() -> None:
    assert tuple(failures.MODES) == judge.FAILURES == tuple(mode["name"] for mode in study.catalogue()["mode"])
    assert tuple(failures.MODES.values()) == summary.FAILURE_HEADINGS[-5:]


def test_cells_count_frames_and_take_medians_of_those_with_a_mode() -> None:
    yes = np.array([True, True, False, False])
    failed = dict.fromkeys(failures.MODES, ~yes & yes) | {"wrong_corners": yes, "no_blob": None}
    told = dict(
        zip(
            failures.HEADINGS,
            failures.cells(failed, np.array([3, 5, 1, np.nan]), np.array([-0.1, 0.2, 0, 0])),
            strict=True,
        )
    )
    assert told["4 wrong corners"] == "2"
    assert told["5 no blob"] == "–"
    assert told[failures.ATTITUDE[""]] == "1"
    assert told[failures.ATTITUDE["wrong_corners"]] == "4"
    assert told[failures.RANGE["wrong_corners"]] == "15"
    assert told[failures.ATTITUDE["loss_of_elements"]] == "–"


def test_places_follow_from_the_rows_of_a_table(tmp_path: Path) -> None:
    physical(tmp_path)
    found, missing = study.places([tmp_path])
    assert {source for source, _, _ in found} == {"physical"}
    assert any("mantis virtual makes it" in line for line in missing)
    before = {mode: found["physical", "before", mode] for mode in failures.MODES}
    assert {mode: p.likelihood for mode, p in before.items()} == {
        "loss_of_aruco": 1,
        "false_positive": 1,
        "loss_of_elements": 4,
        "wrong_corners": 2,
        "no_blob": 3,
    }
    # Corners on the ring's outer square keep the attitude and lose the range.
    assert before["wrong_corners"].severity == 2
    assert before["wrong_corners"].range_error == pytest.approx(0.12)
    assert before["no_blob"].severity == 1
    assert before["loss_of_aruco"].severity == 3
    after = found["physical", "after", "no_blob"]
    assert (after.likelihood, after.proven) == (1, 1)
    assert after.rate.interval[1] < 0.01


def test_page_says_where_it_differs_from_the_thesis_and_is_written(tmp_path: Path) -> None:
    physical(tmp_path / "in")
    told = page(study.run(plan=Plan((tmp_path / "in",))), "mantis risk --results in")
    told.write(tmp_path / "out")
    assert told.passed
    table = next(table for table in told.tables() if table.key == "places")
    cells = [dict(zip(table.headings, (cell.text for cell in cells), strict=True)) for cells in table.rows]
    lost = next(c for c in cells if c["failure"].startswith("3") and c["stage"] == "before")
    assert lost["likelihood"] == "above 3"
    assert lost["thesis: likelihood, severity"] == "2, 1"
    assert lost["against the thesis"].startswith("likelier: ")
    for name in (
        "risk.nc",
        "risk.md",
        "report.html",
        "data/risk.csv",
        "data/risk-places.csv",
        "figures/risk-matrix.svg",
    ):
        assert (tmp_path / "out" / name).stat().st_size > 0


def test_committed_tables_of_the_virtual_experiment_are_read(tmp_path: Path) -> None:
    """No row that the study picks is missing from them."""
    found, _ = study.places([RESULTS])
    for mode in failures.MODES:
        for stage in study.STAGES:
            assert found["virtual", stage, mode].rate.frames > 100
    # The same commands, read again, give the same page.
    first, second = (page(study.run(plan=Plan((RESULTS,))), "x").markdown() for _ in range(2))
    assert first == second


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "no column"),
        (None, "none of the tables is there"),
    ],
)
def test_wrong_results_are_told_in_one_line_with_status_2(
    mantis: Mantis, tmp_path: Path, text: str | None, said: str
) -> None:
    if text is not None:
        (tmp_path / "virtual-failures.csv").write_text(text, encoding="utf-8")
    status, _, error = mantis("risk", "--results", tmp_path, "--out", tmp_path / "out")
    assert status == 2
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_counts_that_cannot_be_are_refused(tmp_path: Path) -> None:
    write(tmp_path, "physical-failures.csv", [row(BEFORE, 10, {"no_blob": 11}), row(AFTER, 10, {})])
    with pytest.raises(ValueError, match="11 of 10 frames"):
        study.places([tmp_path])


def test_verb_gives_json_and_takes_no_keys(mantis: Mantis, tmp_path: Path) -> None:
    physical(tmp_path)
    status, text, error = mantis("risk", "--json", "--results", tmp_path, "--out", tmp_path / "out")
    assert status == 0, error
    assert json.loads(text)["passed"] is True
    assert mantis("risk", "--set", "range_m=2")[0] == 2


def test_glare_counts_failures_of_frames_against_what_stands_in_its_opening() -> None:
    scenario, attitudes = Scenario(), FULL.attitudes
    side_px = scenario.marker.aruco_m * max(scenario.camera.focal_px) / 5.0
    blobs = np.zeros((1, 1, 1, 1, 4, 4))
    blobs[..., 1, 1:] = np.nan  # one blob alone
    blobs[..., 2, :] = np.nan  # not found
    dims = ("mode", "range_m", "phase_deg", "azimuth_deg", "frame")
    values = {
        "detected": [1, 1, 0, 1],
        "false_positive": [0, 0, 1, 0],
        "attitude_error_deg": [0.1, 0.5, np.nan, 0.3],
        "range_error": [0.001, 0.002, np.nan, 0.1],
        "corner_error_max_px": [0.1, 0.1, np.nan, 0.06 * side_px],
    }
    data = {name: (dims, np.reshape(v, (1, 1, 1, 1, 4))) for name, v in values.items()}
    dataset = xr.Dataset(
        {**data, "blob_error_px": ((*dims, "element"), blobs)},
        {"mode": ["single"], "range_m": [5.0], "phase_deg": [10.0], "attitude": ("frame", [0, 0, 0, 0])},
    )
    head, told = failure_rows(dataset, scenario, attitudes)
    cells = dict(zip(head, told, strict=True))
    assert [cells[name] for name in failures.MODES.values()] == ["1", "1", "1", "1", "1"]
    assert cells["frames"] == "4"
    assert cells[failures.RANGE["wrong_corners"]] == "10"
