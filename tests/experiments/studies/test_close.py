"""The closure search: its closed form is the chain's, what it proposes closes, and the committed page says what it gives."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments import chain
from experiments.scenario import Scenario, ScenarioError
from experiments.studies.close import confirm as close_confirm
from experiments.studies.close import page as close_page
from experiments.studies.close import study as close
from experiments.studies.close.constraints import UNCERTAIN, Constraints, Problem, at_life, load_problem
from experiments.studies.close.form import FINE_DIFFERENCE, PHASE_DIFFERENCE, Sets, closed_form
from experiments.studies.close.plan import FULL
from experiments.studies.close.search import RADIOMETRIC, Point, margins, operate, pareto, sets_of
from experiments.studies.close.sensitivity import interval, probability, scheduled

DOCS = Path(__file__).parents[3] / "docs"
_NUMBER = re.compile(r"(?<![\w.])\d+(?:[.,]\d+)*(?:×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")


@pytest.fixture(scope="module")
def limits() -> tuple[Constraints, Scenario]:
    problem = load_problem()
    return problem.constraints, problem.base


@pytest.fixture(scope="module")
def study(limits: tuple[Constraints, Scenario]) -> close.ClosureResult:
    return close.run(Problem(*limits), replace(FULL, render=False))


def _chain_scenario(study: close.ClosureResult, sets: Sets, range_m: float, phase_deg: float = 45.0) -> Scenario:
    """The chain's scenario of a single set."""
    base = study.base
    tape = study.form.tapes[int(sets.tape[0])]
    made = base.at(
        range_m=range_m,
        camera={
            **base.camera.model_dump(),
            "focal_length_m": float(sets.focal_length_m[0]),
            "f_number": float(sets.f_number[0]),
            "focus_m": float(study.constraints.ranges_m[-1]),
        },
        marker={**base.marker.model_dump(), "size_m": float(study.form.sizes_m[int(sets.size[0])])},
        leds={**base.leds.model_dump(), "count": int(sets.led_count[0])},
        target={**base.target.model_dump(), "tape_material": tape},
        sun={**base.sun.model_dump(), "phase_deg": phase_deg},
    )
    return at_life(made, study.constraints, True)


def _one(tape: int, size: int, focal_m: float, f_number: float, leds: int) -> Sets:
    return Sets(*(np.array([v]) for v in (tape, size, focal_m, f_number, leds)))  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("sets", "range_m"),
    [
        (_one(2, 0, 0.0200, 8.0, 100), 1.0),
        (_one(2, 8, 0.0425, 5.0, 100), 2.0),
        (_one(2, 8, 0.0425, 5.0, 7), 10.0),
        (_one(2, 8, 0.0425, 5.0, 50), 20.0),
        (_one(0, 0, 0.070, 8.0, 20), 5.0),
        (_one(0, 4, 0.053, 8.0, 20), 18.0),
        (_one(1, 6, 0.030, 2.8, 3), 3.0),
        (_one(1, 6, 0.0475, 6.3, 10), 15.0),
    ],
)
def test_closed_form_is_the_chains(study: close.ClosureResult, sets: Sets, range_m: float) -> None:
    """Closely where a bit has four pixels; below, the chain's marker stands at one of the sub-pixel phases averaged."""
    form, rates = study.form, study.form.rates(sets)
    column, sun = list(form.ranges_m).index(range_m), 1 + list(form.phases_deg).index(45.0)
    scenario = _chain_scenario(study, sets, range_m)
    eclipse, lit = chain.link_budget(scenario, "eclipse"), chain.link_budget(scenario, "sunlit")
    assert form.px_per_bit(sets)[0, column] == pytest.approx(eclipse.px_per_bit, rel=1e-9)
    tolerance = FINE_DIFFERENCE if eclipse.px_per_bit >= 4 else PHASE_DIFFERENCE
    leds = int(sets.led_count[0])
    of_sun = (lit.signal_rate - eclipse.signal_rate, lit.background_rate - eclipse.background_rate)
    pairs = [
        (leds * rates.led_signal[0, 0, column], eclipse.signal_rate, eclipse.signal_rate),
        (leds * rates.led_background[0, 0, column], eclipse.background_rate, eclipse.signal_rate),
        (rates.sun_signal[0, sun, column], of_sun[0], of_sun[0]),
        (rates.sun_background[0, sun, column], of_sun[1], of_sun[0]),
    ]
    for mine, chains, scale in pairs:
        assert abs(mine - chains) < tolerance * scale

    operating = operate(form, sets, study.constraints)
    seconds = float(operating.pulse_s[0, sun, column])
    at = lit.at(seconds)
    assert float(operating.smear_px[0, sun, column]) == pytest.approx(at["smear_px"], rel=1e-9)
    assert float(operating.cnr[0, sun, column]) == pytest.approx(at["cnr"], rel=2 * tolerance)
    assert float(operating.full_well_fraction[0, sun, column]) == pytest.approx(at["full_well_fraction"], rel=tolerance)
    assert float(operating.energy_j[0, sun, column]) == pytest.approx(float(scenario.leds.energy_per_frame_j(seconds)))


def test_phase_average_is_the_mean_of_the_chains_over_phases(study: close.ClosureResult) -> None:
    """Rationale: a detector of an odd number of pixels, or a slightly different range, puts the bits on other phases."""
    sets = _one(2, 8, 0.0425, 5.0, 100)
    ranges = 17.0 + np.arange(6) / 6
    constraints = study.constraints.model_copy(update={"ranges_m": tuple(map(float, ranges))})
    rates = closed_form(study.base, constraints, True, sizes_m=(0.1,)).rates(replace(sets, size=np.array([0])))
    signal, background = [], []
    for i, range_m in enumerate(ranges):
        scenario = _chain_scenario(study, sets, range_m)
        for odd_x, odd_y in ((0, 0), (0, 1), (1, 0), (1, 1)):
            size = {"width_px": 160 + odd_x, "height_px": 160 + odd_y}
            budget = chain.link_budget(scenario.at(camera={**scenario.camera.model_dump(), **size}), "eclipse")
            mine = 100 * float(rates.led_signal[0, 0, i])
            signal.append(budget.signal_rate / mine - 1)
            background.append((budget.background_rate - 100 * float(rates.led_background[0, 0, i])) / mine)
    assert abs(np.mean(signal)) < 0.01
    assert abs(np.mean(background)) < 0.01
    assert max(np.abs(signal).max(), np.abs(background).max()) < PHASE_DIFFERENCE


def test_proposed_sets_meet_every_constraint(study: close.ClosureResult) -> None:
    constraints, face = study.constraints, study.base.target.face_m
    assert len(study.found.closing) > 50
    for p in study.found.closing:
        assert p.margin >= 1
        assert p.size_m <= constraints.marker_over_face_max * face + 1e-9
        assert p.focal_length_m / p.f_number <= constraints.aperture_max_m + 1e-9
        assert p.power_w <= constraints.average_power_w
        assert p.fewest_leds <= p.led_count in constraints.led_counts
        assert p.power_w == pytest.approx(p.energy_j * 5.0)  # 5 deg/s in steps of 1 deg
    assert study.recommended == max(study.proposed, key=lambda p: p.margin)
    assert {p.size_m for p in study.proposed} == {p.size_m for p in study.found.front}


def test_no_closing_set_beats_one_of_the_front(study: close.ClosureResult) -> None:
    def objectives(p: Any) -> np.ndarray:
        return np.array([p.power_w, p.size_m, p.focal_length_m])

    for p in study.found.front:
        others = [objectives(q) for q in study.found.closing if q is not p]
        better = [np.all(o <= objectives(p)) and np.any(o < objectives(p)) for o in others]
        assert not any(better)
    for q in study.found.closing:
        assert any(np.all(objectives(p) <= objectives(q)) for p in study.found.front)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.lists(st.tuples(*[st.integers(1, 4)] * 3), min_size=1, max_size=12))
def test_pareto_front_of_any_cloud(cloud: list[tuple[int, int, int]]) -> None:
    blank = Point(
        tape="t",
        size_m=0.0,
        focal_length_m=0.0,
        f_number=1.0,
        led_count=1,
        fewest_leds=1,
        margins={},
        binding=("", 0.0),
        energy_j=0.0,
        power_w=0.0,
        peak_power_w=0.0,
    )
    sets = tuple(replace(blank, power_w=float(a), size_m=float(b), focal_length_m=float(c)) for a, b, c in cloud)
    front = {(p.power_w, p.size_m, p.focal_length_m) for p in pareto(sets)}
    expected = {p for p in cloud if not any(all(x <= y for x, y in zip(q, p, strict=True)) and q != p for q in cloud)}
    assert front == expected


def test_a_set_beside_the_front_fails_as_its_margins_say(study: close.ClosureResult) -> None:
    """A shorter lens loses sampling, a longer one the frame, a wider pupil the focus, fewer LEDs the Sun or the glint."""
    point = study.recommended
    assert point is not None
    for change, criterion in (
        ({"focal_length_m": point.focal_length_m * 0.97}, "sampling"),
        ({"focal_length_m": point.focal_length_m * 1.03}, "frame"),
        ({"f_number": point.f_number * 0.9}, "focus"),
        ({"led_count": 10}, "sun"),
    ):
        sets = sets_of(study.form, replace(point, **change))
        found = margins(study.form, sets, study.constraints, operate(study.form, sets, study.constraints))
        assert found[criterion].min() < 1


def test_schedule_half_fills_the_well_at_the_shortest_pulse_or_longer(study: close.ClosureResult, limits: Any) -> None:
    constraints, base = limits
    assert len(study.schedule) == 4 * len(constraints.ranges_m)
    assert {r.leds for r in study.schedule} == {study.recommended.led_count if study.recommended else 0}
    slow = base.at(auto_exposure={**base.auto_exposure.model_dump(), "shortest_s": 2e-5})
    assert study.recommended is not None
    form = closed_form(slow, constraints, True, (study.recommended.tape,), (study.recommended.size_m,))
    operating = operate(form, sets_of(form, study.recommended), constraints)
    assert operating.leds.min() < study.recommended.led_count
    assert operating.leds.max() == study.recommended.led_count
    assert np.all(operating.leds == np.floor(operating.leds))
    assert operating.pulse_s.min() >= 2e-5
    assert operating.full_well_fraction == pytest.approx(np.full(operating.pulse_s.shape, 0.5), rel=1e-9)


def test_following_exposure_keeps_saturation_and_a_fixed_one_does_not(study: close.ClosureResult) -> None:
    point, form, constraints = study.recommended, study.form, study.constraints
    assert point is not None
    bright = sets_of(
        form, point, {"retro": np.array([2.0]), "tape_diffuse": np.array([2.0]), "absorber": np.array([2.0])}
    )
    follows, fixed = (
        operate(form, bright, constraints),
        operate(form, bright, constraints, scheduled(form, point, constraints)),
    )
    assert follows.full_well_fraction == pytest.approx(np.full(follows.pulse_s.shape, 0.5))
    # Twice the reflectance, LEDs and Sun alike, twice the charge; 2 % is the Sun's own retro lobe at small phases.
    assert fixed.full_well_fraction == pytest.approx(np.full(follows.pulse_s.shape, 1.0), rel=0.02)


def test_every_uncertainty_that_matters_moves_a_margin(study: close.ClosureResult) -> None:
    assert study.tornado is not None
    assert len(study.tornado.bars) == len(study.constraints.uncertainties) == len(UNCERTAIN)
    bars = {b.name: b for b in study.tornado.bars}
    keys = {u.key: u.name for u in study.constraints.uncertainties}
    assert bars[keys["full_well"]].fixed == pytest.approx((0.7, 3.5), rel=0.01)
    assert bars[keys["foil_lobe"]].following[1] < study.tornado.following
    assert bars[keys["foil_lobe"]].fixed == pytest.approx((study.tornado.fixed,) * 2)
    low, high = bars[keys["retro_life"]].following
    assert low < study.tornado.following < high
    assert study.tornado.fixed == pytest.approx(0.7 / 0.5)


def test_probability_of_closure_is_that_of_the_draws(study: close.ClosureResult, limits: Any) -> None:
    constraints, _ = limits
    point = study.recommended
    assert point is not None
    sure = constraints.model_copy(update={"uncertainties": ()})
    certain = probability(study.form, point, sure, 200, np.random.default_rng(1), "as assumed")
    assert (certain.following, certain.fixed) == (1.0, 1.0)
    # Full well alone, ×0.5 to ×2.5: the exposure set beforehand saturates below 0.5/0.7.
    [well] = [u for u in constraints.uncertainties if u.key == "full_well"]
    only = constraints.model_copy(update={"uncertainties": (well,)})
    drawn = probability(study.form, point, only, 4000, np.random.default_rng(2), "full well alone")
    expected = np.log(well.high / (0.5 / 0.7)) / np.log(well.high / well.low)
    low, high = drawn.fixed_ci95
    assert low - 0.01 < expected < high + 0.01  # the 1 % covers the share of saturation that background adds
    assert drawn.following == 1.0
    for p in study.probabilities:
        assert p.fixed <= p.by_range[1].min() + 1e-12
        assert p.following_ci95 == interval(p.following, p.draws)
        assert sum(p.failing[n][0] for n in RADIOMETRIC) >= 1 - p.following - 0.01


def test_thesis_hardware_ends_where_its_sampling_does(study: close.ClosureResult) -> None:
    as_exposed, following, *changes = study.hardware
    camera, marker = study.base.camera, study.base.marker
    frontal_m = marker.bit_m * camera.focal_length_m / camera.pixel_pitch_x_m / study.base.requirement.px_per_bit_min
    assert following.reach_m == pytest.approx(frontal_m * np.cos(np.radians(study.constraints.tilt_deg)))
    assert following.closing_m[-1] == 9.0
    assert as_exposed.closing_m == ()
    assert as_exposed.failing["saturation"] < 1e-3
    assert study.minimal is not None
    assert study.minimal.point is not None
    assert {c.name: (c.closes, c.allowed) for c in changes} == {
        "lens of 42.0 mm, same F-number": (False, True),
        "lens of 42.0 mm, same pupil": (True, True),
        "marker of 20.8 cm": (True, False),
        "pixels of 4.1 µm, same detector area and lens": (True, True),
    }


def test_confirmation_renders_what_closes_and_what_does_not(study: close.ClosureResult) -> None:
    assert study.recommended is not None
    view = study.constraints.confirm.views[0].model_copy(update={"ranges_m": (20.0,)})
    confirm = study.constraints.confirm.model_copy(update={"views": (view,), "trials": 2})
    constraints = study.constraints.model_copy(update={"confirm": confirm})
    short = replace(study.recommended, focal_length_m=0.02)
    records = close_confirm.confirm(((study.recommended, study.base), (short, study.base)), constraints, workers=1)
    good, bad = close_confirm.summarise(records)
    assert [r["illumination"] for r in records] == ["eclipse", "sunlit"] * 2
    assert good.confirmed
    assert (good.cases, good.found, good.frames) == (2, 4, 4)
    assert good.signal_difference < 0.01
    assert good.found_low == pytest.approx(0.05**0.25)
    assert not bad.confirmed
    assert set(bad.fails) >= {"detection"}
    page = close_page.page(replace(study, records=tuple(records)), "mantis close")
    assert len(page.files["data/closure-confirmation.csv"].splitlines()) == 1 + len(records)


def _value(text: str) -> float:
    plain = text.replace(",", "").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    return float(plain.replace("×10", "e"))


def test_committed_page_says_what_the_closed_form_gives(study: close.ClosureResult) -> None:
    """Words must be the same, and numbers but for a unit of their third digit; the frames are those of the committed table."""
    records = close_confirm.read_records(DOCS / "data" / "closure-confirmation.csv")
    made = close_page.page(replace(study, records=tuple(records)), "mantis close").markdown()
    committed = (DOCS / "closure.md").read_text(encoding="utf-8")
    assert _NUMBER.sub("#", committed).split() == _NUMBER.sub("#", made).split()
    pairs = list(zip(_NUMBER.findall(committed), _NUMBER.findall(made), strict=True))
    assert len(pairs) > 300
    for stated, computed in pairs:
        assert _value(stated) == pytest.approx(_value(computed), rel=0.011), (stated, computed)
    figures = re.findall(r"\]\((figures/\S+\.svg)\)", committed)
    assert len(figures) == 6
    assert all((DOCS / name).is_file() for name in figures)
    assert {r["set"] for r in records} == {p.label for p, _ in study.to_confirm}


def test_verb_writes_report_page_and_tables(
    study: close.ClosureResult, mantis: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(close, "run", lambda *_, **__: study)
    status, output, _ = mantis("close", "--no-render", "--json", "-o", tmp_path)
    assert status == 0
    said = json.loads(output)
    assert said["closing"] == len(study.found.closing)
    assert said["confirmed"] == []
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Pareto" in page
    assert "not confirmed by rendering" in page
    assert (tmp_path / "closure.md").is_file()
    assert len(list((tmp_path / "figures").glob("closure-*.svg"))) == 5
    assert (tmp_path / "data" / "closure-sets.csv").read_text(encoding="utf-8").count("\n") == 1 + len(
        study.found.closing
    )
    status, _, error = mantis("close", "--no-render", "--require", "closes", "-q", "-o", tmp_path)
    assert status == 4
    assert "not confirmed by rendering" in error


def test_a_search_that_finds_nothing_says_so(mantis: Any, tmp_path: Path) -> None:
    narrow = ("--set", "close.focal_lengths_m.last=0.02", "--set", "close.tapes=['tape_type_xi']")
    status, output, _ = mantis("close", "--no-render", *narrow, "-o", tmp_path)
    assert status == 0
    assert "No set of parameters closes 1–20 m" in output
    assert "No set of parameters closes" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("close.led_derating=1.2", "led_derating: 1.2, expected less than or equal to 1"),
        ("close.tapes=['gold']", "tapes: material 'gold' is unknown"),
        ("close.ranges_m=[2, 1]", "ranges_m: must increase"),
        ("close.blur_bit_max=1", "unknown key; did you mean 'blur_bits_max'"),
        ("close.filters=['red']", "filters: 'red'"),
        ("close.sensors=['eye']", "sensors: 'eye'"),
        ("leds.count=0", "leds.count: 0"),
    ],
)
def test_wrong_constraints_are_refused_in_one_line(override: str, message: str) -> None:
    with pytest.raises(ScenarioError) as error:
        load_problem(None, (override,))
    assert message in str(error.value)
    assert "\n" not in str(error.value)
