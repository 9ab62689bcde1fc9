"""What is said about a budget, and that the advice given is enough."""

from __future__ import annotations

import io
import re
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from experiments.reporting.formatting import factor, number, ranges_text, seconds_text
from experiments.scenario import load_scenario
from experiments.studies.budget.advice import exposure_windows
from experiments.studies.budget.criteria import MEASURES
from experiments.studies.budget.page import is_default
from experiments.studies.budget.page import page as budget_page
from experiments.studies.budget.terminal import budget_table, verdict_panel
from experiments.studies.budget.verdict import summarise
from radiometry import link
from radiometry.closure import CRITERIA


@pytest.mark.parametrize("case", [{}, {"found": 0.0}, {"attitude_deg": 5.0}])
def test_shortfalls_are_those_of_the_datasets_margins(make_budget, case):
    result = make_budget(**case)
    assert list(MEASURES) == list(CRITERIA) == list(result.dataset.criterion.values)
    for verdict in summarise(result.dataset, result.scenario).cases:
        margin = result.dataset.margin.sel(illumination=verdict.illumination, exposure=verdict.exposure)
        expected = {
            (float(m.range_m), str(m.criterion.values), float(m))
            for m in margin.stack(x=("range_m", "criterion"))
            if m < 1
        }
        assert {(s.range_m, s.criterion, s.margin) for s in verdict.shortfalls} == expected
        assert verdict.closes == bool((margin >= 1).all())


def test_the_page_speaks_of_the_thesis_for_the_shipped_system_alone(make_budget):
    """Rationale: a user's own budget is about his own system; the thesis's own budget stands in `mantis errata`."""
    own = budget_page(make_budget())
    assert "thesis" not in " ".join([*own.about, *own.findings, own.headline, *own.limits])
    assert not [name for name in make_budget().dataset.variables if "thesis" in name]
    default = load_scenario(None, ("budget.ranges_m=[3, 5]", "seed=7"))
    assert is_default(default)
    assert not is_default(default.changed("leds.count=99"))


def test_headline_names_ranges_lights_and_what_fails(make_budget):
    result = make_budget()
    summary = summarise(result.dataset, result.scenario)
    assert not summary.closes
    assert summary.headline == (
        "The budget does not close over 1–4 m. With auto exposure it closes at 1–2\u00a0m in eclipse and sunlight; "
        "what fails: sampling."
    )
    shown, fixed = summary.cases[:2]
    assert shown.shown
    assert shown.failures == ("Sampling fails at 4\u00a0m: 1.75 px/bit, 2 needed, short by ×1.1",)
    assert not fixed.shown
    assert fixed.closing_m == ()
    assert "bright bits 500 × full well, 0.7 allowed, over by ×710" in fixed.failures[0]
    assert asdict(summary)["cases"][0]["shortfalls"][0]["criterion"] == "sampling"


def test_budget_that_closes_says_so_and_asks_for_no_change(make_budget):
    result = make_budget(budget={"ranges_m": (1.0, 2.0), "exposures_s": ("auto",)})
    summary = summarise(result.dataset, result.scenario)
    assert summary.closes
    assert summary.headline == "The budget closes over 1–2 m in eclipse and sunlight, with auto exposure."
    assert [a.split(":")[0] for a in summary.advice] == ["Evidence"]


def test_frames_that_prove_too_little_are_counted(make_budget):
    # 0.05^(1/8) = 0.688: the one-sided 95 % bound of eight of eight; 299 frames are the least with 0.99^n <= 0.05.
    result = make_budget()
    advice = summarise(result.dataset, result.scenario).advice[-1]
    assert "8 of 8" in advice
    assert "68.8" in advice
    assert advice.endswith("budget.trials to 299.")
    assert 0.99**299 <= 0.05 < 0.99**298


def test_advised_focal_length_and_marker_sample_just_enough(make_budget):
    result = make_budget()
    advice = next(a for a in summarise(result.dataset, result.scenario).advice if a.startswith("Sampling"))
    focal_mm = float(re.search(r"→ ([\d.]+) mm", advice)[1])
    side_cm = float(re.search(r"→ ([\d.]+) cm", advice)[1])
    for change in ({"camera": {"focal_length_m": focal_mm / 1e3}}, {"marker": {"size_m": side_cm / 1e2}}):
        changed = make_budget(**change)
        assert 2.0 <= float(changed.dataset.px_per_bit[-1]) < 2.02
        assert summarise(changed.dataset, changed.scenario).closes
    assert "SYS-REQ-6 does not allow (at most 10 cm on a 1 m face)" in advice
    wide = make_budget(target={"face_m": 10.0})
    assert any("SYS-REQ-6 allows" in a for a in summarise(wide.dataset, wide.scenario).advice)


@settings(deadline=None, derandomize=True, max_examples=20)
@given(noise=st.floats(0, 200), dark=st.floats(0, 1e7), limit=st.floats(1, 60))
def test_exposure_windows_just_meet_each_limit(make_budget, noise, dark, limit):
    sensor = {"read_noise_electrons": noise, "dark_current_electrons_per_s": dark}
    result = make_budget(sensor=sensor, requirement={"cnr_min": limit})
    windows = exposure_windows(result.dataset, result.scenario)
    for name, illumination in ((n, v) for n in ("cnr", "saturation", "smear") for v in ("eclipse", "sunlit")):
        here = result.dataset.isel(exposure=0).sel(illumination=illumination)
        ratio = windows[name].sel(illumination=illumination) / here.exposure_s
        if name == "cnr":
            dark_e = (
                result.scenario.sensor.dark_rate_electrons_per_s * windows.cnr.sel(illumination=illumination)
            ).values
            signal, background = here.signal_analytic * ratio, here.background_analytic * ratio
            value = link.cnr(signal, background, dark_e, result.scenario.sensor.total_noise_electrons)
        else:
            value = (here[MEASURES[name].variable] * ratio).values
        np.testing.assert_allclose(value, getattr(result.scenario.requirement, CRITERIA[name][0]), rtol=1e-9)


def test_exposure_advice_tells_one_for_all_from_one_for_each(make_budget):
    near = make_budget(budget={"ranges_m": (1.0, 2.0)})
    advice = next(a for a in summarise(near.dataset, near.scenario).advice if a.startswith("Exposure"))
    assert "any single one from" in advice
    apart = make_budget(budget={"ranges_m": (1.0, 20.0)})
    advice = next(a for a in summarise(apart.dataset, apart.scenario).advice if a.startswith("Exposure"))
    assert "no single one serves all ranges. 1 m in sunlight allows at most 1.4\u00a0µs (saturation)" in advice


@pytest.mark.parametrize(
    ("exposure_s", "said"),
    [
        (5e-6, "at most 27 of the 100 LEDs may shine"),
        (1e-3, "fewer LEDs do not help"),
        (1e-2, "sunlight alone saturates"),
    ],
)
def test_led_advice_follows_what_sunlight_leaves(make_budget, exposure_s, said):
    # At 5 µs the LEDs fill 2.5 wells at 1 m, the Sun 0.0025: (0.7 − 0.0025) / 2.5 of the LEDs may shine.
    result = make_budget(budget={"exposures_s": (exposure_s, "auto")})
    assert any(said in a for a in summarise(result.dataset, result.scenario).advice if a.startswith("LEDs"))


def test_advised_led_intensity_lifts_contrast_to_the_limit(make_budget):
    result = make_budget(budget={"ranges_m": (1.0, 2.0), "exposures_s": (1e-7,)}, requirement={"cnr_min": 20.0})
    advice = [a for a in summarise(result.dataset, result.scenario).advice if a.startswith("CNR")]
    noise = result.scenario.sensor.total_noise_electrons
    for statement, sun in zip(advice, (0.0, 1.0), strict=True):
        more = float(re.search(r"×([\d.]+) the LEDs", statement)[1])
        reached = float(link.cnr(250 * more + sun, 2.5 * more + sun, 0.0, noise))
        assert reached == pytest.approx(20.0, rel=0.05)  # the factor is told with two digits


def test_marker_never_found_leaves_nothing_to_say_of_the_pose(make_budget):
    result = make_budget(found=0.0)
    summary = summarise(result.dataset, result.scenario)
    assert summary.cases[0].failing_at(1.0) == ["detection"]
    assert "Attitude fails at 1–4\u00a0m: no pose to measure" in summary.cases[0].failures
    assert "in no frame at 1–4\u00a0m" in next(a for a in summary.advice if a.startswith("Detection"))
    assert not any(a.startswith(("Attitude", "Range", "Evidence")) for a in summary.advice)


def test_poses_that_are_off_are_counted(make_budget):
    result = make_budget(attitude_deg=5.0)
    advice = next(a for a in summarise(result.dataset, result.scenario).advice if a.startswith("Attitude"))
    assert "at 1 m 8 of 8 poses are off by more than 2° (up to 5°)" in advice


@pytest.mark.parametrize(
    "plan",
    [
        {"illuminations": ("sunlit",)},
        {"ranges_m": (3.0,)},
        {"exposures_s": (1e-3,)},
        {"exposures_s": (1e-3, 1.0001e-3)},
    ],
)
def test_any_plan_gets_a_verdict_and_a_table(make_budget, plan):
    result = make_budget(budget=plan)
    summary = summarise(result.dataset, result.scenario)
    assert len(summary.shown) == len(result.scenario.budget.illuminations)
    assert _printed(budget_table(result)).count("\n") > 3


def test_terminal_output_fits_a_hundred_columns_and_takes_no_markup_from_titles(make_budget):
    result = make_budget(title="a [/red] title [bold]", found=0.5)
    text = _printed(budget_table(result)) + _printed(verdict_panel(summarise(result.dataset, result.scenario)))
    assert "a [/red] title [bold]" in text
    assert max(map(len, text.splitlines())) <= 100
    row = next(line for line in text.splitlines() if line.split()[:1] == ["4"])
    assert row.rstrip().endswith("✗ sampling, detection")


def _printed(renderable: object) -> str:
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(renderable)
    return console.export_text()


@pytest.mark.parametrize(
    ("chosen", "said"),
    [((), "no range"), ((1, 2, 3, 5), "1–3 and 5\u00a0m"), ((2,), "2\u00a0m"), ((1, 3, 5), "1, 3 and 5\u00a0m")],
)
def test_ranges_join_neighbours(chosen, said):
    assert ranges_text((1, 2, 3, 4, 5), chosen) == said


@settings(deadline=None, derandomize=True)
@given(st.floats(1.0001, 1e9))
def test_factors_say_more_than_one_and_keep_two_digits(value):
    text = factor(value)
    assert text != "×1"
    assert _parsed(text[1:]) == pytest.approx(value, rel=0.051)


@settings(deadline=None, derandomize=True)
@given(st.floats(1e-12, 1e12))
def test_numbers_keep_their_size(value):
    assert _parsed(number(value)) == pytest.approx(value, rel=0.051)


def test_times_have_their_own_unit():
    assert [seconds_text(s) for s in (1.5e-9, 7.25e-6, 1e-3, 2.0)] == [
        "1.5\u00a0ns",
        "7.25\u00a0µs",
        "1\u00a0ms",
        "2\u00a0s",
    ]


def _parsed(text: str) -> float:
    mantissa, _, exponent = text.replace(",", "").partition("×10")
    return float(mantissa) * 10.0 ** int(exponent.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)
