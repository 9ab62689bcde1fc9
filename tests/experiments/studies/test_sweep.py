"""Sweeps give the same dataset to the last bit, however they were run or interrupted."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments import chain
from experiments.scenario import ScenarioError
from experiments.studies.sweep import study, work
from experiments.studies.sweep.journal import Journal
from experiments.studies.sweep.plot import draw_slice
from experiments.studies.sweep.work import software
from scenes.files.cache import TransportCache

PLAN = """
trials = 2
[set]
"render.marker_rays" = 10000
"render.frame_samples" = 1
"camera.width_px" = 96
"camera.height_px" = 80
[grid]
range_m = [3.0, 4.0]
illumination = ["eclipse", "sunlit"]
exposure_s = [4e-7, "auto", 1e-3]
"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """One cache for this module's tests, away from the user's."""
    folder = tmp_path_factory.getbasetemp() / "sweep-cache"
    monkeypatch.setenv("MANTIS_CACHE", str(folder))
    return folder


def _write(folder: Path, text: str = PLAN) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text)
    return path


def _run(folder: Path, text: str = PLAN, **options) -> study.Outcome:
    return study.run_sweep(study.load_sweep(_write(folder, text)), folder / "out.nc", **options)


def test_dimensions_are_the_swept_keys_with_units(tmp_path):
    _run(tmp_path)
    dataset = xr.load_dataset(tmp_path / "out.nc", engine="h5netcdf")
    assert dict(dataset.snr_rendered.sizes) == {"range_m": 2, "illumination": 2, "exposure_s": 3}
    assert dataset.detected.dims == ("range_m", "illumination", "exposure_s", "trial")
    assert dataset.range_m.attrs["units"] == "m"
    assert list(dataset.exposure_s.values) == ["4e-07", "auto", "0.001"]
    # 30 000 rays at most on a marker of 27 px are too few for the tenth that the renderer aims at, yet it says so.
    assert np.all(dataset.renderer_variance_fraction > 0)
    assert all("long_name" in v.attrs for v in dataset.data_vars.values())
    assert np.all(dataset.full_well_fraction.sel(exposure_s="auto") == pytest.approx(0.5, abs=0.03))


def test_each_geometry_is_rendered_once_and_a_second_sweep_renders_nothing(tmp_path):
    plan = PLAN.replace("[3.0, 4.0]", "[3.3, 4.4]")
    first = _run(tmp_path, plan)
    assert (first.rendered, first.computed) == (2, 12)
    (tmp_path / "again").mkdir()
    other = plan.replace('[4e-7, "auto", 1e-3]', "[2e-7]")
    second = _run(tmp_path / "again", other)
    assert (second.rendered, second.computed) == (0, 4)


def test_a_sweep_killed_at_twenty_random_moments_ends_with_the_same_bytes(tmp_path):
    """Rationale: kill -9 leaves no chance to tidy up, so whatever is on disk at any instant must be enough to go on.

    Expected: after twenty kills the resumed sweep's file equals the uninterrupted one's, byte for byte, and every case that
    was in the journal was computed once only.
    """
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    plan = PLAN.replace('[4e-7, "auto", 1e-3]', str([1e-7 * k for k in range(1, 26)]))
    _run(whole, plan)
    _write(killed, plan)
    script = """
import os, random, signal, sys, time
from pathlib import Path
from experiments.studies.sweep import journal
from experiments.studies.sweep import study
folder = Path(sys.argv[1])
plan = study.load_sweep(folder / "sweep.toml")
appended = folder / "appended.txt"
original = journal.Journal.append
def counted(self, finished):
    original(self, finished)
    with appended.open("a") as file:
        file.writelines(f"{index}\\n" for index, _ in finished)
journal.Journal.append = counted
list(study.compute([(0, plan.scenarios[0])]))  # imports and tables once, so that the kills fall into the work
def done():
    return len(appended.read_text().split()) if appended.exists() else 0
random.seed(7)
kills = 0
while kills < 20:
    # By cases rather than seconds, so that neither a fast machine ends before the last kill nor a slow one never starts.
    wanted = done() + random.randint(0, 3)
    child = os.fork()
    if child == 0:
        study.run_sweep(plan, folder / "out.nc", resume=True)
        os._exit(0)
    while done() < wanted:
        time.sleep(0.002)
    time.sleep(random.uniform(0, 0.05))
    os.kill(child, signal.SIGKILL)
    if os.waitpid(child, 0)[1] == 0:
        break
    kills += 1
print(kills)
"""
    done = subprocess.run([sys.executable, "-c", script, str(killed)], capture_output=True, text=True, check=True)
    assert int(done.stdout) == 20, "the sweep ended before it could be killed twenty times; make it longer"
    before = [int(line) for line in (killed / "appended.txt").read_text().split()]
    assert 0 < len(set(before)) < 100, "every kill fell before the first case or after the last"
    final = study.run_sweep(study.load_sweep(killed / "sweep.toml"), killed / "out.nc", resume=True)
    assert len(before) == len(set(before)), "a finished case was computed again"
    assert final.computed <= 100 - len(set(before))
    assert (killed / "out.nc").read_bytes() == (whole / "out.nc").read_bytes()
    assert not (killed / "out.nc.journal").exists()


def test_an_unfinished_sweep_is_not_overwritten_unasked(tmp_path):
    sweep = study.load_sweep(_write(tmp_path))
    journal = Journal(tmp_path / "out.nc.journal", f"{sweep.digest()} {software()}")
    journal.open(False)
    journal.append([(0, {"reason": "made up"})])
    with pytest.raises(ValueError, match="this sweep is running"):
        study.run_sweep(sweep, tmp_path / "out.nc", resume=True)
    journal.close()
    with pytest.raises(ValueError, match="add --resume"):
        study.run_sweep(sweep, tmp_path / "out.nc")
    changed = study.load_sweep(_write(tmp_path, PLAN.replace("trials = 2", "trials = 3")))
    with pytest.raises(ValueError, match="belongs to another sweep"):
        study.run_sweep(changed, tmp_path / "out.nc", resume=True)


def test_a_run_that_ends_before_its_first_case_leaves_nothing_to_resume(tmp_path):
    sweep = study.load_sweep(_write(tmp_path))

    def no_workers():
        raise OSError("no scheduler answers")

    with pytest.raises(OSError, match="no scheduler"):
        study.run_sweep(sweep, tmp_path / "out.nc", executor=no_workers)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["sweep.toml"]
    killed = Journal(tmp_path / "out.nc.journal", "another sweep")
    killed.open(False)
    killed._file.close()
    journal = Journal(tmp_path / "out.nc.journal", "d")
    assert journal.open(False) == {}
    journal.close()


def test_a_torn_line_at_the_end_of_the_journal_is_dropped(tmp_path):
    journal = Journal(tmp_path / "j", "d")
    journal.open(False)
    journal.append([(0, {"values": {"a": 0.1}, "reason": ""}), (1, {"values": {"a": 0.2}, "reason": ""})])
    journal.close()
    text = journal.path.read_text()
    journal.path.write_text(text[:-7])
    assert set(journal.open(True)) == {0}
    journal.append([(1, {"values": {"a": 0.3}, "reason": ""})])
    journal.close()
    assert journal.open(True)[1]["values"]["a"] == 0.3
    journal.close()


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.data())
def test_a_journal_cut_anywhere_gives_its_whole_lines(data):
    """Rationale: a power failure may leave any part of what was written last."""
    records = [(k, {"values": {"a": k / 3}, "reason": "–" * k}) for k in range(5)]
    with tempfile.TemporaryDirectory() as folder:
        journal = Journal(Path(folder) / "j", "d")
        journal.open(False)
        journal.append(records)
        journal.close()
        content = journal.path.read_bytes()
        cut = data.draw(st.integers(0, len(content)))
        journal.path.write_bytes(content[:cut])
        found = journal.open(True)
        journal.close()
        assert found == dict(records[: max(0, content[:cut].count(b"\n") - 1)])


def test_a_file_that_is_no_journal_is_left_alone(tmp_path):
    path = tmp_path / "out.nc.journal"
    path.write_text("dear diary\n" * 100)
    with pytest.raises(ValueError, match="not a sweep's journal"):
        Journal(path, "d").open(True)
    assert path.read_text() == "dear diary\n" * 100


def test_a_case_that_cannot_be_computed_is_recorded_and_the_sweep_goes_on(tmp_path, monkeypatch):
    original = TransportCache.bases

    def sometimes(self, cases):
        for view, quality in cases:
            if view.range_m == 4.0:
                raise MemoryError("no room for 4 m")
            yield from original(self, [(view, quality)])

    monkeypatch.setattr(TransportCache, "bases", sometimes)
    outcome = _run(tmp_path)
    dataset = outcome.dataset
    assert outcome.failed == 6
    assert set(dataset.reason.sel(range_m=4.0).values.ravel()) == {"MemoryError: no room for 4 m"}
    assert np.isnan(dataset.snr_analytic.sel(range_m=4.0)).all()
    assert np.isfinite(dataset.snr_analytic.sel(range_m=3.0)).all()


def test_an_exposure_that_fails_leaves_its_neighbours_alone(tmp_path, monkeypatch):
    original = chain.solve_exposure

    def never_auto(scenario, budget, exposure):
        if exposure == "auto":
            raise ValueError("no bit in the frame")
        return original(scenario, budget, exposure)

    monkeypatch.setattr(chain, "solve_exposure", never_auto)
    outcome = _run(tmp_path)
    assert outcome.failed == 4
    assert set(outcome.dataset.reason.sel(exposure_s="auto").values.ravel()) == {"ValueError: no bit in the frame"}
    assert np.isfinite(outcome.dataset.snr_analytic.sel(exposure_s=["4e-07", "0.001"])).all()


def test_a_reason_is_one_short_line():
    told = work.failure(ValueError("first\n  second " + "and so on " * 100))["reason"]
    assert told.startswith("ValueError: first second and so on")
    assert len(told) <= 160


def test_the_sun_at_exactly_a_right_angle_is_computed(tmp_path):
    """Its light grazes a frontal face: no shadow, rather than an endless one."""
    grazing = PLAN.replace("[3.0, 4.0]", "[3.0]").replace('[4e-7, "auto", 1e-3]', "[1e-6]") + '"sun.phase_deg" = [90]\n'
    assert _run(tmp_path, grazing).failed == 0


def test_list_and_sample_run_side_by_side(tmp_path):
    side = PLAN[: PLAN.index("[grid]")] + '[list]\nrange_m = [3.0, 4.0]\n"leds.count" = [10, 20]\n'
    dataset = _run(tmp_path, side).dataset
    assert dict(dataset.snr_rendered.sizes) == {"case": 2}
    assert list(dataset["leds.count"].values) == [10, 20]
    sample = (
        PLAN[: PLAN.index("[grid]")]
        + '[sample]\ncount = 4\n[sample.ranges]\n"sun.phase_deg" = [20, 90]\nrange_m = [2, 5]\n'
    )
    sweep = study.load_sweep(_write(tmp_path, sample))
    drawn = np.array([[s["sun.phase_deg"], s["range_m"]] for s in sweep.settings])
    assert drawn.shape == (4, 2)
    assert np.all((drawn >= [20, 2]) & (drawn <= [90, 5]))
    assert study.load_sweep(tmp_path / "sweep.toml").settings == sweep.settings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trials = 2\n", r"a sweep needs \[grid\], \[list\] or \[sample\]"),
        ("[grid]\nrange_m = []\n", "grid.range_m"),
        ("[grid]\nrange_m = [-1]\n", "case range_m=-1: range_m: -1"),
        ('[grid]\n"leds.cuont" = [1]\n', "leds.cuont: unknown key; did you mean 'leds.count'"),
        ("[list]\nrange_m = [1, 2]\nexposure_s = [1e-6]\n", "as many values"),
        ("[grid]\nrange_m = [1]\n[list]\nrange_m = [2]\n", "range_m: swept twice"),
        ("[gird]\nrange_m = [1]\n", "gird: unknown key; did you mean 'grid'"),
        ("not toml", "not a TOML file"),
    ],
)
def test_a_bad_plan_gets_one_clear_line(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        study.load_sweep(_write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_any_slice_is_drawn_and_bad_choices_are_named(tmp_path):
    _run(tmp_path)
    out = tmp_path / "out.nc"
    fixed = draw_slice(out, "range_m", "cnr_analytic", "exposure_s", ("illumination=sunlit",), tmp_path / "a.svg")
    assert fixed == {"illumination": "sunlit"}
    assert "contrast-to-noise ratio" in (tmp_path / "a.svg").read_text()
    for bad, message in (
        (("range_m", "nothing", None, ()), "no such variable"),
        (("illumination", "cnr_analytic", None, ()), "must both be numbers"),
        (("range_m", "cnr_analytic", "seed", ()), "not a dimension"),
        (("range_m", "cnr_analytic", None, ("illumination=moon",)), "not among eclipse, sunlit"),
    ):
        with pytest.raises(ValueError, match=message):
            draw_slice(out, *bad, tmp_path / "b.svg")
    assert not (tmp_path / "b.svg").exists()
