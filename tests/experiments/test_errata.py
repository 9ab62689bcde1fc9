"""The errata study: three models side by side, and a page that says what they give."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.cli.main import main
from experiments.thesis.errata import page as errata_page
from experiments.thesis.errata import study as errata
from radiometry.thesis import PrintedModel

DOCS = Path(__file__).parents[2] / "docs"
_NUMBER = re.compile(r"(?<![\w.])\d+(?:[.,\N{NO-BREAK SPACE}]\d+)*(?:×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")


@pytest.fixture(scope="module")
def dataset() -> xr.Dataset:
    return errata.compute()


def _value(text: str) -> float:
    plain = text.replace("\N{NO-BREAK SPACE}", "").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    return float(plain.replace("×10", "e"))


def test_numbers_are_read_as_they_are_written() -> None:
    for value in (0.000_5, 0.457, 2.423, 91.53, 795.24, 17_468.0, 3.4738e6, 2.0348e10, 2e-5):
        text = errata_page.digits(value)
        assert _NUMBER.fullmatch(text)
        assert _value(text) == pytest.approx(value, rel=5.1e-3)


def test_committed_page_says_what_the_models_give(dataset: xr.Dataset) -> None:
    """Words must be the same; numbers may differ by a unit of their third digit, for platforms round differently."""
    committed, made = (DOCS / "thesis-errata.md").read_text(encoding="utf-8"), errata_page.page(dataset)
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


def test_waterfall_factors_join_the_three_models(dataset: xr.Dataset) -> None:
    repaired_at = list(dataset.step.values).index("noise added linearly")
    for illumination, exposure in errata.WATERFALL_EXPOSURE.items():
        case = dataset.sel(illumination=illumination, exposure=exposure)
        product = case.signal_factor.cumprod("step")
        for step, model in ((repaired_at, "repaired"), (-1, "full")):
            expected = case.signal.sel(model=model) / case.signal.sel(model="printed")
            assert product.isel(step=step).values == pytest.approx(expected.values, rel=1e-9)


def test_printed_model_fails_where_the_thesis_says(dataset: xr.Dataset) -> None:
    printed = dataset.snr.sel(model="printed", illumination="eclipse")
    assert float(printed.sel(exposure="1/30 s", range_m=9)) < 2 < float(printed.sel(exposure="1/30 s", range_m=8))
    assert printed.sel(exposure="1/50 s, 8°").values == pytest.approx(
        PrintedModel(light_cone_deg=8).snr(dataset.range_m.values, 1 / 50, sun=False)
    )


def test_verdicts_of_the_page_hold(dataset: xr.Dataset) -> None:
    facts = errata_page.facts(dataset)
    full = dataset.sel(model="full")
    thesis_exposures = [e for e in errata.EXPOSURES if e != "auto"]
    assert (full.full_well_fraction.sel(illumination=["eclipse", "sunlit"], exposure=thesis_exposures) > 1).all()
    assert (full.snr.sel(illumination="eclipse") > 10).all()
    assert facts["eclipse"]["repaired_over_printed_8m"] == pytest.approx(3.47e6, rel=0.005)
    assert facts["sun"]["repaired_alone_over_printed_8m"] == pytest.approx(2.25, abs=0.005)
    assert facts["sampling"]["px_per_bit_20m"] == pytest.approx(0.005 * 20.19e-3 / 8.6e-6 / 20)
    assert facts["sampling"]["ends_m"] < 6 < 11 < facts["sampling"]["ends_10mm_m"] < 12
    assert "16.8 times too much" in facts["beam"]["refusal"]


def test_auto_exposure_half_fills_the_well_or_stands_at_its_limit(dataset: xr.Dataset) -> None:
    auto = dataset.sel(exposure="auto")
    limits = errata.thesis_scenario(16.0).auto_exposure
    at_limit = np.isclose(auto.exposure_s, limits.shortest_s) | np.isclose(auto.exposure_s, limits.longest_s)
    assert np.all(at_limit | np.isclose(auto.full_well_fraction, limits.full_well_fraction))


def test_run_writes_page_figures_and_data(dataset: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("h5py")
    monkeypatch.setattr(errata, "compute", lambda: dataset)
    errata.run(tmp_path)
    assert len(list((tmp_path / "figures").glob("errata_*.svg"))) == 5
    with xr.open_dataset(tmp_path / "data" / "errata.nc", engine="h5netcdf") as stored:
        xr.testing.assert_allclose(stored.signal.drop_attrs(), dataset.signal.drop_attrs())
    rows = (tmp_path / "data" / "errata.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + dataset.sizes["step"] * dataset.sizes["illumination"] * 3
    assert (tmp_path / "thesis-errata.md").read_text(encoding="utf-8") == errata_page.page(dataset)


def test_verb_refuses_settings_other_than_the_thesis_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["errata", "--set", "leds.count=1"]) == 2
    assert "errata: its settings are the thesis's" in capsys.readouterr().err
