"""The errata study: three models side by side, and a page that says what they give."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.cli.main import main
from experiments.thesis.errata.facts import facts
from experiments.thesis.errata.page import page
from experiments.thesis.errata.study import ErrataResult, load, run
from experiments.thesis.errata.tables import digits
from radiometry.thesis import PrintedModel

DOCS = Path(__file__).parents[3] / "docs"
_NUMBER = re.compile(r"(?<![\w.])\d+(?:[.,\N{NO-BREAK SPACE}]\d+)*(?:×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")


@pytest.fixture(scope="module")
def result() -> ErrataResult:
    return run(load())


@pytest.fixture(scope="module")
def dataset(result: ErrataResult) -> xr.Dataset:
    return result.dataset


def _value(text: str) -> float:
    plain = text.replace("\N{NO-BREAK SPACE}", "").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    return float(plain.replace("×10", "e"))


def test_numbers_are_read_as_they_are_written() -> None:
    for value in (0.000_5, 0.457, 2.423, 91.53, 795.24, 17_468.0, 3.4738e6, 2.0348e10, 2e-5):
        text = digits(value)
        assert _NUMBER.fullmatch(text)
        assert _value(text) == pytest.approx(value, rel=5.1e-3)


def test_committed_page_says_what_the_models_give(result: ErrataResult) -> None:
    """Words must be the same; numbers may differ by a unit of their third digit, for platforms round differently."""
    committed, made = (DOCS / "thesis-errata.md").read_text(encoding="utf-8"), page(result, "mantis errata").markdown()
    assert _NUMBER.sub("#", committed).split() == _NUMBER.sub("#", made).split()
    pairs = list(zip(_NUMBER.findall(committed), _NUMBER.findall(made), strict=True))
    assert len(pairs) > 400
    for stated, computed in pairs:
        assert _value(stated) == pytest.approx(_value(computed), rel=0.011), (stated, computed)


def test_figures_of_the_page_are_committed() -> None:
    linked = re.findall(r"\]\((figures/\S+\.svg)\)", (DOCS / "thesis-errata.md").read_text(encoding="utf-8"))
    assert len(linked) == 5
    assert all((DOCS / name).is_file() for name in linked)


def test_last_step_and_full_model_are_the_same_physics(dataset: xr.Dataset) -> None:
    # Two codes: on the axis at 850 nm, and over the marker and the spectra. At 1 m the corners lie 2° off the axis, which the
    # beam's pattern feels; the Sun's photons are a little bluer than 850 nm.
    last = dataset.isel(step=-1)
    assert float(np.abs(last.signal_factor - 1).max()) < 0.005
    assert float(np.abs(last.signal_factor.sel(illumination="eclipse", range_m=slice(3, 20)) - 1).max()) < 5e-4
    assert float(np.abs(last.snr_factor - 1).max()) < 0.01


def test_factors_of_the_steps_join_the_three_models(result: ErrataResult, dataset: xr.Dataset) -> None:
    corrected_at = list(dataset.step.values).index("noise added linearly")
    for illumination, exposure in result.plan.step_exposure.items():
        case = dataset.sel(illumination=illumination, exposure=exposure)
        product = case.signal_factor.cumprod("step")
        for step, model in ((corrected_at, "corrected"), (-1, "full")):
            expected = case.signal.sel(model=model) / case.signal.sel(model="printed")
            assert product.isel(step=step).values == pytest.approx(expected.values, rel=1e-9)


def test_printed_model_fails_where_the_thesis_says(dataset: xr.Dataset) -> None:
    printed = dataset.snr.sel(model="printed", illumination="eclipse")
    assert float(printed.sel(exposure="1/30 s", range_m=9)) < 2 < float(printed.sel(exposure="1/30 s", range_m=8))
    assert printed.sel(exposure="1/50 s, 8°").values == pytest.approx(
        PrintedModel(light_cone_deg=8).snr(dataset.range_m.values, 1 / 50, sun=False)
    )


def test_verdicts_of_the_page_hold(result: ErrataResult, dataset: xr.Dataset) -> None:
    found = facts(result)
    full = dataset.sel(model="full")
    thesis_exposures = [e for e in result.plan.exposures if e != "auto"]
    assert (full.full_well_fraction.sel(illumination=["eclipse", "sunlit"], exposure=thesis_exposures) > 1).all()
    assert (full.snr.sel(illumination="eclipse") > 10).all()
    assert found.eclipse.corrected_over_printed_8m == pytest.approx(3.47e6, rel=0.005)
    assert found.sun.corrected_alone_over_printed_8m == pytest.approx(2.25, abs=0.005)
    assert found.sampling.px_per_bit_20m == pytest.approx(0.005 * 20.19e-3 / 8.6e-6 / 20)
    assert found.sampling.ends_m < 6 < 11 < found.sampling.ends_10mm_m < 12
    assert "16.8 times too much" in found.beam.refusal


def test_auto_exposure_half_fills_the_well_or_stands_at_its_limit(result: ErrataResult, dataset: xr.Dataset) -> None:
    auto = dataset.sel(exposure="auto")
    limits = result.scenario.auto_exposure
    at_limit = np.isclose(auto.exposure_s, limits.shortest_s) | np.isclose(auto.exposure_s, limits.longest_s)
    assert np.all(at_limit | np.isclose(auto.full_well_fraction, limits.full_well_fraction))


def test_page_writes_its_figures_and_data(result: ErrataResult, dataset: xr.Dataset, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    page(result, "mantis errata").write(tmp_path)
    assert len(list((tmp_path / "figures").glob("thesis-errata-*.svg"))) == 5
    with xr.open_dataset(tmp_path / "thesis-errata.nc", engine="h5netcdf") as stored:
        xr.testing.assert_allclose(stored.signal.drop_attrs(), dataset.signal.drop_attrs())
    rows = (tmp_path / "data" / "thesis-errata.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + dataset.sizes["step"] * dataset.sizes["illumination"] * 3
    assert (tmp_path / "thesis-errata.md").read_text(encoding="utf-8") == page(result, "mantis errata").markdown()


def test_page_cites_the_thesis(result: ErrataResult) -> None:
    text = page(result, "mantis errata").html()
    for word in ("Rijlaarsdam", "Designing a Novel Fiducial Marker System", "Delft University of Technology", "2021"):
        assert word in text


def test_json_has_every_number_by_topic(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["errata", "--json", "--out", str(tmp_path / "out")]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["sampling"]["px_per_bit_20m"] == pytest.approx(0.587, abs=5e-4)
    assert record["eclipse"]["printed_snr_8m"] == pytest.approx(2.42, abs=5e-3)


def test_verb_refuses_settings_other_than_the_thesis_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["errata", "--set", "leds.count=1"]) == 2
    assert "errata: its settings are the thesis's" in capsys.readouterr().err
