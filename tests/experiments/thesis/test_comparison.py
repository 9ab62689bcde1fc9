"""Markers side by side over tilt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.thesis.comparison import page, study
from experiments.thesis.comparison.plan import QUICK, Plan
from experiments.thesis.comparison.published import published
from experiments.thesis.virtual.targets import load
from radiometry.encoding import RAYLEIGH_MEDIAN


def test_every_target_is_run_alike() -> None:
    plan = Plan((2.3, 4.6), (0.0, 30.0), 4)
    runs = study.runs(plan)
    assert len(runs) == len(study.TARGETS) * 2
    assert {r.angles_deg for r in runs} == {(-1.5, -0.5, 0.5, 1.5, 28.5, 29.5, 30.5, 31.5)}


def test_published_markers_have_sources_and_models_scale_with_pixels() -> None:
    scenario, tilt = load(), np.array([0.0, 45.0])
    for other in published():
        assert len(other.source) > 40
        near, far = (other.median_deg(tilt, scenario, size) for size in (60.0, 30.0))
        if other.model:
            assert "ssumption" in other.source or "assumption" in other.source
            assert far == pytest.approx(2 * near)
            assert near[1] == pytest.approx(near[0] * np.cos(np.pi / 4))
        else:
            assert near.tolist() == far.tolist() == [other.level_deg] * 2
    lens, slits = published()[:2]
    # The same stripe deviation: a lens's field of 60° against 90° by the slits' depth.
    ratio = lens.median_deg(tilt, scenario, 60.0) / slits.median_deg(tilt, scenario, 60.0)
    assert ratio == pytest.approx(np.tan(np.radians(30)) / np.tan(np.radians(45)))
    length = 60.0 * scenario.marker.element_length_m / scenario.marker.size_m
    assert slits.median_deg(tilt, scenario, 60.0)[0] == pytest.approx(
        np.degrees(RAYLEIGH_MEDIAN * slits.sigma_px / (0.5 * length))
    )


def test_seen_squarely_the_mantis_marker_beats_planar_tags_and_writes_so(tmp_path: Path) -> None:
    told = page.page(study.run(load(), QUICK, workers=1), "mantis comparison --quick")
    told.write(tmp_path)
    assert told.passed
    for name in ("comparison.nc", "report.html", "data/comparison-tilt.csv", "figures/comparison-tilt.svg"):
        assert (tmp_path / name).stat().st_size > 0
    tilts = next(table for table in told.tables() if table.key == "tilt")
    table = {(row[0].text, row[3].text): float(row[4].text) for row in tilts.rows}
    assert table["Mantis", "0"] < 0.2 * table["ArUco, best effort", "0"]
    assert table["protrusion (SVMS)", "0"] < 0.2 * table["ArUco, best effort", "0"]
