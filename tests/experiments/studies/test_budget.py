"""The main job on a tiny plan: labelled, repeatable whoever computes it, and judged by its criteria."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments import chain
from experiments.cli.main import main
from experiments.scenario import Scenario, load_scenario
from experiments.studies.budget import study as budget
from experiments.studies.budget.plan import FULL, QUICK
from radiometry.closure import CRITERIA
from scenes.files import exr
from scenes.render.transport import TransportBasis

Mantis = Callable[..., tuple[int, str, str]]

PLAN = """\
title = "tiny"
camera = { width_px = 160, height_px = 160 }
render = { frame_samples = 1, marker_rays = 60_000 }
budget = { ranges_m = [2.5, 4], trials = 2, exposures_s = [1e-5, "auto"] }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("budget")
    (path / "tiny.toml").write_text(PLAN, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tiny(folder: Path) -> Scenario:
    return load_scenario(folder / "tiny.toml")


@pytest.fixture(scope="module")
def told(folder: Path) -> dict[str, Any]:
    """What `mantis budget --json` prints with two worker processes; its files lie in the folder."""
    out = io.StringIO()
    with redirect_stdout(out):
        status = main(["budget", str(folder / "tiny.toml"), "-o", str(folder / "out"), "--workers", "2", "--json"])
    assert status == 0
    return dict(json.loads(out.getvalue()))


@pytest.fixture(scope="module")
def written(told: dict[str, Any], folder: Path) -> xr.Dataset:
    with xr.open_dataset(folder / "out" / "budget.nc") as dataset:
        return dataset.load()


@pytest.fixture(scope="module")
def alone(tiny: Scenario) -> budget.BudgetResult:
    """The same plan in one process, without files."""
    return budget.run(tiny, workers=1)


def test_the_result_does_not_depend_on_the_number_of_processes(
    written: xr.Dataset, alone: budget.BudgetResult, folder: Path
) -> None:
    """Bit by bit, from two spawned workers through NetCDF, and from one process in memory; and so do the shown frames."""
    written.attrs.pop("history", None)
    alone.dataset.attrs.pop("history", None)
    xr.testing.assert_identical(written, alone.dataset)
    for shot in alone.snapshots:
        path = folder / "out" / "frames" / f"range_{shot.range_m:06.2f}m_{shot.illumination}.png"
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), shot.frame)


@pytest.mark.usefixtures("told")
def test_the_budget_leaves_pages_data_transport_and_frames(folder: Path) -> None:
    found = {str(p.relative_to(folder / "out")) for p in (folder / "out").rglob("*") if p.is_file()}
    frames = {
        f"frames/range_{r}m_{illumination}.png" for r in ("002.50", "004.00") for illumination in ("eclipse", "sunlit")
    }
    bases = {f"transport/range_{r}m.exr" for r in ("002.50", "004.00")}
    assert {"report.html", "budget.md", "budget.nc", "data/budget.csv"} | frames | bases <= found
    assert not [name for name in found if Path(name).name.startswith(".")]
    assert (folder / "out" / "report.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")


def test_results_carry_labels_units_and_provenance(written: xr.Dataset, tiny: Scenario) -> None:
    assert written.attrs["Conventions"].startswith("CF-")
    assert written.attrs["title"] == "tiny"
    assert written.attrs["scenario_hash"] == tiny.digest()
    assert load_as_scenario(written.attrs["scenario"]) == tiny
    assert dict(written.sizes) == {
        "range_m": 2,
        "illumination": 2,
        "exposure": 2,
        "trial": 2,
        "criterion": len(CRITERIA),
    }
    for name, variable in {**written.data_vars, **written.coords}.items():
        assert variable.attrs.get("long_name"), name
        if variable.dtype.kind in "fib" and name != "trial":
            assert variable.attrs.get("units"), name
    assert written.exposure.values.tolist() == ["10 µs", "auto"]


def load_as_scenario(text: str) -> Scenario:
    return Scenario.model_validate_json(text)


def test_what_is_printed_is_what_is_written(told: dict[str, Any], written: xr.Dataset) -> None:
    printed = told["results"]["data_vars"]
    assert set(printed) == set(written.data_vars)
    for name in ("cnr_analytic", "signal_rendered", "detected_fraction"):
        values = np.array(printed[name]["data"], float)  # null, of NaN, becomes NaN again
        np.testing.assert_array_equal(values, written[name].values)
    assert told["verdict"]


@pytest.mark.parametrize(("range_m", "illumination"), [(2.5, "sunlit"), (4.0, "eclipse")])
@pytest.mark.usefixtures("told")
def test_expose_repeats_the_frames_of_the_budget(
    mantis: Mantis, folder: Path, tmp_path: Path, range_m: float, illumination: str
) -> None:
    name = f"range_{range_m:06.2f}m"
    basis, settings = (
        folder / "out" / "transport" / f"{name}.exr",
        (f"range_m={range_m}", f"illumination={illumination}"),
    )
    options = [part for setting in settings for part in ("--set", setting)]
    status, _, error = mantis("expose", basis, folder / "tiny.toml", "-o", tmp_path / "frame.png", *options)
    assert (status, error) == (0, "")
    assert (tmp_path / "frame.png").read_bytes() == (
        folder / "out" / "frames" / f"{name}_{illumination}.png"
    ).read_bytes()


def test_rendered_and_analytic_figures_agree_on_the_tiny_plan(written: xr.Dataset) -> None:
    """60 000 rays cut the bits' edges coarsely: 1 % of the signal."""
    for illumination in ("eclipse", "sunlit"):
        case = written.sel(illumination=illumination)
        np.testing.assert_allclose(case.signal_expected, case.signal_analytic, rtol=0.01)
        np.testing.assert_allclose(
            case.background_expected, case.background_analytic, atol=0.01 * float(case.signal_analytic.max())
        )
    clear = written.sel(exposure="auto")
    assert (clear.detected_fraction == 1).all()
    assert clear.snr_rendered.notnull().all()


def test_progress_counts_up_to_all_cases(tiny: Scenario) -> None:
    seen: list[tuple[int, int]] = []
    one = tiny.at(budget={"ranges_m": (4.0,), "illuminations": ("eclipse",), "exposures_s": ("auto",), "trials": 2})
    budget.run(one, FULL, progress=lambda done, total, _: seen.append((done, total)), workers=1)
    assert seen[-1] == (1, 1)
    assert all(done <= total == 1 for done, total in seen)


def test_a_marker_beyond_the_nearest_frame_is_refused_before_rendering(tiny: Scenario, tmp_path: Path) -> None:
    plan = {"ranges_m": (0.05, 4.0), "illuminations": ("eclipse",), "exposures_s": ("auto",), "trials": 2}
    with pytest.raises(ValueError, match=r"none is at 0\.05 m; shorten camera\.focal_length_m"):
        budget.run(tiny.at(budget=plan), workers=1, out=tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_an_interrupt_leaves_whole_files_only(
    mantis: Mantis, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_basis: TransportBasis
) -> None:
    bases = iter([small_basis])

    def once(_: Scenario) -> TransportBasis:
        try:
            return next(bases)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(chain, "transport", once)
    status, out, error = mantis("budget", folder / "tiny.toml", "-o", tmp_path / "out", "--workers", 1)
    assert (status, out) == (130, "")
    assert error.strip() == "mantis: interrupted; nothing half-written was left"
    files = [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
    assert [p.name for p in files] == ["range_002.50m.exr"]
    exr.read_basis(files[0])


@settings(deadline=None, derandomize=True, max_examples=30)
@given(st.integers(1, 60), st.integers(2, 40))
def test_a_quick_plan_is_part_of_the_whole_one(count: int, trials: int) -> None:
    ranges = tuple(float(r) for r in range(1, count + 1))
    whole = load_scenario().at(budget={"ranges_m": ranges, "trials": trials})
    coarse = QUICK.thinned(whole)
    picked = coarse.budget.ranges_m
    assert set(picked) <= set(ranges)
    assert (picked[0], picked[-1]) == (ranges[0], ranges[-1])
    assert len(picked) <= 7
    assert len(picked) == 7 or count < 20
    assert coarse.budget.trials == min(8, trials)
    assert coarse.render.marker_rays == whole.render.marker_rays // 4
    assert coarse.at(budget=whole.budget.model_dump(), render=whole.render.model_dump()) == whole


@pytest.mark.parametrize(
    ("exposure", "label"),
    [
        ("auto", "auto"),
        (1 / 30, "1/30 s"),
        (1.0, "1/1 s"),
        (1e-3, "1 ms"),
        (2.5e-5, "25 µs"),
        (1e-7, "100 ns"),
        (2.5, "2.5 s"),
    ],
)
def test_exposures_are_called_by_what_people_read(exposure: float | str, label: str) -> None:
    assert budget.exposure_label(exposure) == label


def test_close_exposures_have_names_of_their_own() -> None:
    labels = budget.exposure_labels((1e-3, 1.0001e-3, "auto", 1 / 30, 0.5, 0.50000001))
    assert labels == ["0.001 s", "0.0010001 s", "auto", "1/30 s", "0.5 s", "0.50000001 s"]


#: Criterion -> (variable that decides it, a value that meets it, one that does not) under the default requirement.
DECIDES = {
    "saturation": ("full_well_fraction", 0.5, 0.71),
    "cnr": ("cnr_analytic", 30.0, 9.9),
    "sampling": ("px_per_bit", 4.0, 1.9),
    "smear": ("smear_px", 0.1, 0.51),
    "detection": ("detected_fraction", 1.0, 0.98),
    "attitude": ("attitude_error_p95_deg", 1.0, 2.1),
    "range": ("range_error_p95", 0.005, 0.021),
}


@pytest.mark.parametrize("unmet", [None, *DECIDES])
@pytest.mark.parametrize("missing", [False, True], ids=["", "unknown"])
def test_a_case_closes_when_every_criterion_is_met_and_says_which_is_not(
    tiny: Scenario, alone: budget.BudgetResult, unmet: str | None, missing: bool
) -> None:
    assert list(DECIDES) == list(CRITERIA)
    dataset = alone.dataset.drop_vars(["margin", "closes", "criterion"])
    for variable, good, _ in DECIDES.values():
        dataset[variable] = xr.full_like(dataset[variable], good)
    where = {"range_m": 1, "illumination": 0, "exposure": 1}
    if unmet is not None:
        variable, _, bad = DECIDES[unmet]
        dataset[variable][{k: v for k, v in where.items() if k in dataset[variable].dims}] = np.nan if missing else bad
    judged = budget._judged(tiny, dataset)
    if unmet is None:
        assert judged.closes.all()
        assert (judged.margin >= 1).all()
        return
    here = judged.isel(where)
    assert not bool(here.closes)
    assert [str(c) for c in here.criterion.values[here.margin.values < 1]] == [unmet]
    assert not missing or float(here.margin.sel(criterion=unmet)) == 0
    # Sampling is one for all lights and exposures of a range, so it fails all four cases there.
    assert int((~judged.closes).sum()) == (4 if unmet == "sampling" else 1)
