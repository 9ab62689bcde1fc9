"""Sweep files: what they may say, what each case becomes, and frames that are read out in a window."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import chain
from experiments.chain import trials
from experiments.scenario import ScenarioError, load_scenario
from experiments.studies.sweep.plan import json_schema, load_sweep
from experiments.studies.sweep.window import MIN_WINDOW_PX, windowed
from scenes.render.transport import render_basis


def _load(folder: Path, text: str, *overrides: str):
    path = folder / "sweep.toml"
    path.write_text(text)
    return load_sweep(path, overrides)


def test_keys_may_have_dots_with_or_without_quotation_marks(tmp_path: Path) -> None:
    quoted = _load(tmp_path, '[set]\n"filter.preset" = "bp850_25"\n[grid]\n"leds.count" = [10, 20]\n')
    bare = _load(tmp_path, '[set]\nfilter.preset = "bp850_25"\n[grid]\nleds.count = [10, 20]\n')
    assert quoted == bare
    assert [s.leds.count for s in bare.scenarios] == [10, 20]
    sample = _load(tmp_path, "[sample]\ncount = 2\nranges.sun.phase_deg = [10, 20]\n")
    assert sample.plan.swept == ["sun.phase_deg"]


def test_the_command_line_wins_over_the_file_and_leaves_swept_keys_alone(tmp_path: Path) -> None:
    text = 'trials = 8\n[set]\n"leds.count" = 7\n[grid]\nrange_m = [2, 3]\n'
    sweep = _load(tmp_path, text, "leds.count=9", "budget.trials=4", "seed=5")
    assert {(s.leds.count, s.budget.trials, s.seed) for s in sweep.scenarios} == {(9, 4, 5)}
    with pytest.raises(ScenarioError, match="--set range_m: the sweep file varies it"):
        _load(tmp_path, text, "range_m=4")


def test_the_base_scenario_is_looked_for_beside_the_sweep_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[leds]\ncount = 33\n")
    sweep = _load(tmp_path, 'scenario = "mine.toml"\n[grid]\nrange_m = [2]\n')
    assert sweep.scenarios[0].leds.count == 33


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trials = true\n[grid]\nrange_m = [1]\n", "trials: True"),
        ("[grid]\nrange_m = [true]\n", "case range_m=True: range_m: true or false, expected a number"),
        ("window = 1.0\n[grid]\nrange_m = [1]\n", "window: 1.0"),
        ("[grid]\nrange_m = [1, 1]\n", "grid.range_m: a value occurs twice"),
        ("[set]\nrange_m = 2\n[grid]\nrange_m = [1]\n", "set.range_m: swept as well"),
        (
            "[sample]\ncount = 2\n[sample.ranges]\nrange_m = [5, 2]\n",
            r"ranges.range_m: \[5, 2\], expected \[low, high\]",
        ),
        ('scenario = "no.toml"\n[grid]\nrange_m = [1]\n', "no.toml: no such scenario file"),
        ('window = 3\n[grid]\n"camera.veiling_glare" = [0.01]\n', "window: 3, but camera.veiling_glare is 0.01"),
        ('[grid]\n"leds.count.more" = [1]\n', "case leds.count.more=1: leds.count.more: count holds a value"),
    ],
)
def test_what_a_file_must_not_say_is_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message) as caught:
        _load(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_the_schema_knows_every_scenario_key_wherever_keys_are_named() -> None:
    schema = json_schema()
    json.dumps(schema)
    for place in (
        *(schema["properties"][name] for name in ("set", "grid", "list")),
        schema["$defs"]["Sample"]["properties"]["ranges"],
    ):
        assert {"range_m", "leds.count", "sun.phase_deg", "filter.preset", "earth.albedo"} <= set(place["properties"])
        assert "count" in place["properties"]["leds"]["properties"]
        assert place["additionalProperties"] is False
    assert schema["properties"]["grid"]["properties"]["leds.count"]["items"]["type"] == "integer"


@pytest.mark.parametrize(("range_m", "extents"), [(1.0, 3.0), (2.0, 2.5), (4.0, 3.0), (20.0, 3.0)])
def test_a_window_is_a_cut_out_of_the_frame_about_the_marker(range_m: float, extents: float) -> None:
    """Pixels stay where they are: what the marker's points and the lens's fall-off are in the whole frame, cut out."""
    whole = load_scenario(overrides=(f"range_m={range_m}", "camera.vignetting=0.3", "target.yaw_deg=20"))
    cut = windowed(whole, extents)
    frame, window = whole.camera, cut.camera
    offset = np.array([frame.width_px - window.width_px, frame.height_px - window.height_px])
    assert np.all(offset % 2 == 0)
    corners = whole.marker.corners_m
    inside, outside = (chain.view(s).to_image(corners) for s in (cut, whole))
    assert inside + offset / 2 == pytest.approx(outside)
    (x, y), (w, h) = offset // 2, (window.width_px, window.height_px)
    assert window.relative_illumination() == pytest.approx(frame.relative_illumination()[y : y + h, x : x + w])
    extent = np.ptp(outside, axis=0) * whole.marker.size_m / np.ptp(corners[:, 0])
    wanted = np.minimum(np.maximum(extents * extent, MIN_WINDOW_PX), (frame.width_px, frame.height_px))
    assert np.all((w, h) >= 0.97 * wanted)
    assert np.all((w, h) <= 1.2 * wanted + 3)


def test_a_window_shows_what_the_whole_frame_shows(small) -> None:
    """Electron rates differ by the sampling of the renderer alone; found marker, pose and bits are the same within noise."""
    whole = small.at(camera={**small.camera.model_dump(), "width_px": 192, "height_px": 182})
    cut = windowed(whole, 1.5)
    y, x = ((a - b) // 2 for a, b in zip((182, 192), (cut.camera.height_px, cut.camera.width_px), strict=True))
    assert (x, y) > (0, 0)
    rates = [chain.electron_rate(s, render_basis(chain.view(s), chain.quality(s)), "sunlit") for s in (whole, cut)]
    part = rates[0][y : y + cut.camera.height_px, x : x + cut.camera.width_px]
    assert np.abs(part - rates[1]).max() < 0.02 * rates[0].max()
    seconds = chain.solve_exposure(whole, chain.link_budget(whole, "sunlit"), "auto")
    [a], [b] = (
        trials.draw(chain.Case(s, "sunlit"), rate, [seconds]) for s, rate in zip((whole, cut), rates, strict=True)
    )
    for name in ("snr", "cnr"):
        apart = abs(a.values[f"{name}_rendered"] - b.values[f"{name}_rendered"])
        # Two independent 95 % intervals, widened to 99.9 %.
        assert apart < 3.29 / 1.96 * np.hypot(a.values[f"{name}_rendered_ci95"], b.values[f"{name}_rendered_ci95"])
    assert a.detected.all()
    assert b.detected.all()
