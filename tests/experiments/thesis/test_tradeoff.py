"""The hierarchy process against closed forms, brute force, and the thesis's printed tables."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.thesis.tradeoff import ahp
from experiments.thesis.tradeoff.cells import PrintedCell, thesis_cells
from experiments.thesis.tradeoff.page import cells_table, page, scores_table
from experiments.thesis.tradeoff.problem import THESIS_PROBLEM, load
from experiments.thesis.tradeoff.study import run

ratio = st.floats(1 / 9, 9)
positive = st.floats(0.05, 1.0)


@given(st.lists(ratio, min_size=3, max_size=3))
@settings(deadline=None, derandomize=True)
def test_consistent_matrix_returns_its_own_ratios(values: list[float]) -> None:
    scale = np.array(values)
    vector, eigenvalue = ahp.priorities(scale[:, None] / scale)
    assert vector == pytest.approx(scale / scale.sum(), rel=1e-9)
    assert ahp.consistency(eigenvalue, 3)[1] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("order", [3, 6])
def test_random_index_is_the_mean_consistency_index_of_random_judgements(order: int) -> None:
    rng = np.random.default_rng(1)
    scale = np.concatenate([1 / np.arange(9, 1, -1), np.arange(1, 10)])
    matrices = np.ones((4000, order, order))
    upper, lower = np.triu_indices(order, 1)
    matrices[:, upper, lower] = rng.choice(scale, (4000, len(upper)))
    matrices[:, lower, upper] = 1 / matrices[:, upper, lower]
    index = (np.linalg.eigvals(matrices).real.max(axis=1) - order) / (order - 1)
    standard_error = index.std() / np.sqrt(len(index))
    # The table has two decimals: half a unit of the last, and three standard errors of this draw.
    assert abs(index.mean() - ahp.RANDOM_INDEX[order - 1]) < 0.005 + 3 * standard_error


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_reductions_bring_the_two_alternatives_to_a_tie(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(4))
    distributive = rng.uniform(0.05, 1, (3, 4))
    distributive /= distributive.sum(axis=0)
    ideal = distributive / distributive.max(axis=0)
    for measures, largest in ((distributive, False), (ideal, True)):
        by_weight = ahp.weight_reduction(weights, measures)
        by_measure = (ahp.measure_reduction_ideal if largest else ahp.measure_reduction_distributive)(weights, measures)
        for i, k, j in zip(*np.nonzero(~np.isnan(by_weight)), strict=True):
            changed = weights.copy()
            changed[j] *= 1 - by_weight[i, k, j]
            scores = measures @ (changed / changed.sum())
            assert scores[i] == pytest.approx(scores[k], rel=1e-6, abs=1e-9)
        for i, k, j in zip(*np.nonzero(~np.isnan(by_measure)), strict=True):
            moved = measures.copy()
            moved[i, j] *= 1 - by_measure[i, k, j]
            moved[:, j] /= moved[:, j].max() if largest else moved[:, j].sum()
            assert (moved @ weights)[i] == pytest.approx((moved @ weights)[k], rel=1e-6, abs=1e-9)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, derandomize=True, max_examples=40)
def test_where_no_ideal_measure_reduction_is_given_none_exists(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weights, measures = rng.dirichlet(np.ones(3)), rng.uniform(0.05, 1, (3, 3))
    measures /= measures.max(axis=0)
    reductions = ahp.measure_reduction_ideal(weights, measures)
    for i, k, j in zip(*np.nonzero(np.isnan(reductions)), strict=True):
        if i == k:
            continue
        leads = []
        for value in (0.0, 1e9):  # the lead grows with the measure: its two ends decide
            moved = measures.copy()
            moved[i, j] = value
            moved[:, j] /= moved[:, j].max()
            leads.append((moved[i] - moved[k]) @ weights)
        assert leads[0] > -1e-12 or leads[1] < 1e-8


@pytest.fixture(scope="module")
def cells() -> tuple[PrintedCell, ...]:
    return thesis_cells()


def test_every_printed_cell_is_accounted_for(cells: tuple[PrintedCell, ...]) -> None:
    # 4.2: 6 weights + 3; 4.3: 6 × (2 × 3 + 3); 4.4: 6 weights + 3 × 8; 4.5: 3 × 6; 4.6: 6 × 6.
    assert len(cells) == 9 + 54 + 30 + 18 + 36


def test_recipe_gives_every_printed_digit_but_the_misprints(cells: tuple[PrintedCell, ...]) -> None:
    off = {(c.table, c.row, c.column): c.verdict for c in cells if not c.agrees(c.reproduced)}
    assert {key for key, verdict in off.items() if verdict == "misprint"} == {
        ("4.3", "lifetime", "CI"),
        ("4.4", "retroreflector", "complexity"),
        ("4.6", "1-2", "lifetime"),
    }
    assert {key for key, verdict in off.items() if verdict == "sign"} == {
        ("4.5", "2-3", c) for c in ("accuracy", "precision")
    }
    assert len(off) == 5


def test_winner_stands_in_both_modes_and_second_place_does_not() -> None:
    result = ahp.decide(ahp.load_problem(THESIS_PROBLEM))
    ranking = {
        mode: list(result.alternative.values[result["rank"].sel(mode=mode).values.argsort()]) for mode in ahp.MODES
    }
    assert ranking["ideal"] == ["encoding", "retroreflector", "optical"]
    assert ranking["distributive"] == ["encoding", "optical", "retroreflector"]
    assert float(result.consistency_ratio.max()) < 0.1


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[2, 3, 1]]", "[2, 4, 1]]", "reciprocal"),
        ('["1/2", 1, "1/3"], [2, 3, 1]', '["1/2", 1, "third"], [2, 3, 1]', "'third'"),
        ("comparison = [[1, 4, 5],", "comparison = [[1, 4],", "every row needs 3"),
        ('"optical", "encoding"]', '"optical"]', "order 3 for 2 alternatives"),
        ('name = "lifetime"', 'name = "precision"', "names must differ"),
        ("[weights] #", "[weights #", "not valid TOML"),
        ('name = "lifetime"', 'name = "lifetime"\ncolour = 1', "colour"),
    ],
)
def test_bad_problem_is_refused_with_its_reason(tmp_path: Path, old: str, new: str, named: str) -> None:
    text = THESIS_PROBLEM.read_text(encoding="utf-8").partition("# What the thesis prints")[0]
    assert old in text
    path = tmp_path / "problem.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=named):
        ahp.load_problem(path)


def test_run_writes_dataset_figures_and_table_for_another_problem_too(tmp_path: Path) -> None:
    problem = tmp_path / "two.toml"
    problem.write_text(
        """
        name = "Lamp"
        alternatives = ["LED", "laser"]
        weights.comparison = [[1, 3], ["1/3", 1]]
        criteria = [
            { name = "safety", comparison = [[1, 5], [0.2, 1]] },
            { name = "contrast", comparison = [[1, "1/4"], [4, 1]] },
        ]
        """
    )
    result = run(load(str(problem)))
    assert result.dataset.score.sel(mode="distributive").values == pytest.approx(
        [0.75 * 5 / 6 + 0.25 / 5, 0.75 / 6 + 0.25 * 4 / 5]
    )
    assert [row[0].text for row in scores_table(result.dataset).rows] == ["LED", "laser"]
    page(result, "mantis tradeoff two.toml").write(tmp_path / "two")
    assert not (tmp_path / "two" / "data" / "tradeoff-cells.csv").exists()

    page(run(load()), "mantis tradeoff").write(tmp_path / "thesis")
    assert len((tmp_path / "thesis" / "data" / "tradeoff-cells.csv").read_text().splitlines()) == 148
    with xr.open_dataset(tmp_path / "thesis" / "tradeoff.nc", engine="h5netcdf") as stored:
        assert stored.sizes["criterion"] == 6
    first = (tmp_path / "thesis" / "figures" / "tradeoff-weights.svg").read_bytes()
    page(run(load()), "mantis tradeoff").write(tmp_path / "thesis")
    assert (tmp_path / "thesis" / "figures" / "tradeoff-weights.svg").read_bytes() == first


def test_committed_table_is_what_the_code_gives() -> None:
    committed = Path(__file__).parents[3] / "docs" / "data" / "tradeoff-cells.csv"
    assert committed.read_text(encoding="utf-8") == cells_table(thesis_cells()).csv()


def test_verb_takes_a_problem_of_the_user_and_no_keys(
    mantis: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    problem = tmp_path / "own.toml"
    problem.write_text(THESIS_PROBLEM.read_text(encoding="utf-8").replace("Fiducial concept", "Own"), encoding="utf-8")
    status, out, error = mantis("tradeoff", problem, "--out", tmp_path / "own")
    assert (status, error) == (0, "")
    assert "Encoding wins in both modes." in out
    assert f"mantis tradeoff {problem}" in (tmp_path / "own" / "tradeoff.md").read_text(encoding="utf-8")
    status, _, error = mantis("tradeoff", tmp_path / "none.toml", "--out", tmp_path / "none")
    assert status == 2
    assert "none.toml: No such file" in error
    assert not (tmp_path / "none").exists()
    status, _, error = mantis("tradeoff", "--set", "leds.count=1")
    assert status == 2
    assert "so --set has nothing to change" in error
