"""A photon-transfer data set gives back the parameters of the sensor that made it."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from detector.sensor.emva1288 import (
    DESCRIPTOR,
    Characterisation,
    characterise,
    datasheet,
    peak_electrons,
    read_descriptor,
    write_dataset,
)
from detector.sensor.sensor import Sensor

SENSOR = Sensor(prnu=0.01, dsnu_electrons=20.0, dark_current_electrons_per_s=5000.0)
SMALL = {"shape": (16, 16), "steps": 10, "stack": 3}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(SENSOR, tmp_path_factory.mktemp("emva") / "set", seed=1, shape=(192, 192))


@pytest.fixture(scope="module")
def measured(dataset: Path) -> Characterisation:
    return characterise(dataset.parent)


# With 36 864 pixels the standard error of every figure is below 0.4 %, so 2 % is five of them.
@pytest.mark.parametrize(
    ("figure", "true"),
    [
        ("gain_electrons_per_dn", 5.0),
        ("quantum_efficiency", 0.35),
        ("dark_noise_electrons", 28.2),
        ("dark_noise_dn", SENSOR.total_noise_electrons / 5),
        ("full_well_electrons", 20_000.0),
        ("dark_current_electrons_per_s", 5000.0),
        ("dsnu_electrons", 20.0),
        ("prnu", 0.01),
    ],
)
def test_own_analysis_returns_the_sensor(measured: Characterisation, figure: str, true: float) -> None:
    assert getattr(measured, figure) == pytest.approx(true, rel=0.02)


def expected_saturation() -> float:
    """Photo-electrons where the variance peaks: the dark charge of that exposure takes its part of the well."""
    peak, longest_s, steps, at = peak_electrons(SENSOR), 0.02, 60, 58
    return peak - SENSOR.dark_electrons(longest_s * at / steps)


def test_own_analysis_returns_saturation_and_linearity(measured: Characterisation) -> None:
    saturation = expected_saturation()
    threshold = (SENSOR.total_noise_electrons + 0.5) / 0.35
    assert measured.saturation_electrons == pytest.approx(saturation, rel=0.02)
    assert measured.saturation_photons == pytest.approx(saturation / 0.35, rel=0.02)
    assert measured.threshold_photons == pytest.approx(threshold, rel=0.02)
    assert measured.dynamic_range == pytest.approx(saturation / 0.35 / threshold, rel=0.02)
    assert measured.snr_max == pytest.approx(np.sqrt(saturation), rel=0.02)
    assert measured.linearity_error < 0.005


# The reference implementation leaves a file open, and calls a numpy function that numpy 2 has removed.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_reference_implementation_returns_the_sensor(
    dataset: Path, measured: Characterisation, monkeypatch: pytest.MonkeyPatch
) -> None:
    process = pytest.importorskip("emva1288.process")
    monkeypatch.setattr(np, "asfarray", lambda a: np.asarray(a, float), raising=False)
    quiet = {"loglevel": logging.WARNING}
    images = process.ParseEmvaDescriptorFile(str(dataset), **quiet).images
    data = process.Data1288(process.LoadImageData(images, **quiet).data, **quiet).data
    result = process.Results1288(data, **quiet)
    for found, own, true in (
        (1 / result.K, measured.gain_electrons_per_dn, 5.0),
        (result.QE / 100, measured.quantum_efficiency, 0.35),
        (result.sigma_d, measured.dark_noise_electrons, 28.2),
        (result.u_e_sat, measured.saturation_electrons, expected_saturation()),
        (result.DR, measured.dynamic_range, expected_saturation() / (SENSOR.total_noise_electrons + 0.5)),
        (result.u_I_mean, measured.dark_current_electrons_per_s, 5000.0),
        (result.DSNU1288, measured.dsnu_electrons, 20.0),
        (result.PRNU1288 / 100, measured.prnu, 0.01),
    ):
        assert found == pytest.approx(true, rel=0.02)
        assert found == pytest.approx(own, rel=1e-4)
    linearity = max(abs(result.linearity()[key]) for key in ("linearity_error_min", "linearity_error_max"))
    assert linearity / 100 == pytest.approx(measured.linearity_error, rel=1e-3)


def test_datasheet_lists_every_figure(measured: Characterisation) -> None:
    rows = datasheet(measured)
    assert len({(name, unit) for name, _, _, unit in rows}) == len(rows)
    assert ("Quantum efficiency", "η", f"{100 * measured.quantum_efficiency:.2f}", "%") in rows


def test_sensor_without_fixed_pattern_or_dark_current(tmp_path: Path) -> None:
    sensor = Sensor(quantum_efficiency=[[800, 0.2], [900, 0.4]], gain_electrons_per_dn=0.5, bits=16)
    result = characterise(write_dataset(sensor, tmp_path / "set", seed=3, shape=(128, 128), steps=20))
    assert result.quantum_efficiency == pytest.approx(0.3, rel=0.02)
    assert result.gain_electrons_per_dn == pytest.approx(0.5, rel=0.02)
    # Standard error of a spatial variance of σ²/L over n pixels, at five sigma
    assert result.dsnu_electrons < 28.2 / 4 * (5 * np.sqrt(2 / 128**2)) ** 0.5
    assert result.prnu < 100 / 4 / 10_000 * (5 * np.sqrt(2 / 128**2)) ** 0.5


def test_converter_that_ends_before_the_well_sets_the_saturation(tmp_path: Path) -> None:
    sensor = Sensor(full_well_electrons=60_000)
    result = characterise(write_dataset(sensor, tmp_path / "set", seed=3, shape=(128, 128)))
    assert result.full_well_electrons == pytest.approx((4095 - 64) * 5, rel=0.02)
    assert peak_electrons(sensor) < (4095 - 64) * 5


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    first = write_dataset(SENSOR, tmp_path / "a", seed=9, **SMALL).parent
    second = write_dataset(SENSOR, tmp_path / "b", seed=9, **SMALL).parent
    other = write_dataset(SENSOR, tmp_path / "c", seed=10, **SMALL).parent
    names = sorted(p.relative_to(first) for p in first.rglob("*") if p.is_file())
    assert len(names) == 1 + 10 * 4 + 2 * 3
    assert all((first / n).read_bytes() == (second / n).read_bytes() for n in names)
    image = next(n for n in names if n.suffix == ".png")
    assert (first / image).read_bytes() != (other / image).read_bytes()
    assert cv2.imread(str(first / image), cv2.IMREAD_UNCHANGED).dtype == np.uint16


def test_data_set_appears_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imwrite", lambda *_: False)
    with pytest.raises(OSError, match="could not be written"):
        write_dataset(SENSOR, tmp_path / "set", seed=1, **SMALL)
    assert not list(tmp_path.iterdir())


def test_existing_data_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "note").write_text("mine")
    with pytest.raises(FileExistsError):
        write_dataset(SENSOR, tmp_path, seed=1, **SMALL)
    (tmp_path / "empty").mkdir()
    assert write_dataset(SENSOR, tmp_path / "empty", seed=1, **SMALL).name == DESCRIPTOR


@pytest.mark.parametrize(
    ("sensor", "arguments", "message"),
    [
        (SENSOR, {"wavelength_nm": 1150.0}, "wavelength_nm"),
        (Sensor(dark_current_electrons_per_s=1e7), {}, "dark charge"),
        (SENSOR, {"steps": 3}, "steps"),
        (SENSOR, {"stack": 2}, "stack"),
    ],
)
def test_impossible_data_sets_are_refused(
    tmp_path: Path, sensor: Sensor, arguments: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_dataset(sensor, tmp_path / "set", seed=1, **{**SMALL, **arguments})
    assert not list(tmp_path.iterdir())


def test_descriptor_is_read_with_either_separator_and_comma(tmp_path: Path) -> None:
    path = tmp_path / DESCRIPTOR
    path.write_text("# comment\n\nv 3.1\nn 12 4 4\nb 1000,5 20\ni a\\b.png\ni a/c.png\nd 1000,5\ni d.png\n")
    bright, dark = read_descriptor(path)
    assert bright.exposure_s == pytest.approx(1000.5e-9)
    assert bright.photons == 20
    assert bright.images == (tmp_path / "a" / "b.png", tmp_path / "a" / "c.png")
    assert (dark.photons, len(dark.images)) == (0.0, 1)


@pytest.mark.parametrize("line", ["x 1", "i a.png", "b 1", "b one 2", "d -1", "n 12", "d nan"])
def test_malformed_descriptor_names_its_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / DESCRIPTOR
    path.write_text(f"v 3.1\n{line}\n")
    with pytest.raises(ValueError, match="line 2"):
        read_descriptor(path)


@given(st.text(st.sampled_from("vnbdi 0123456789.,#\\/\n-eäx"), max_size=60))
@settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_is_read_or_refused_with_a_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / DESCRIPTOR
    path.write_text(text, encoding="utf-8")
    refusal = ""
    try:
        series = read_descriptor(path)
    except ValueError as error:
        series, refusal = [], str(error)
    assert all(np.isfinite([s.exposure_s, s.photons]).all() for s in series)
    assert not refusal or ", line " in refusal


def test_incomplete_data_sets_are_refused(tmp_path: Path) -> None:
    path = write_dataset(SENSOR, tmp_path / "set", seed=1, **SMALL)
    lines = path.read_text().splitlines()
    spatial = lines.index(next(line for line in lines if "spatial" in line)) - 1
    path.write_text("\n".join(lines[:spatial]))
    with pytest.raises(ValueError, match="spatial series"):
        characterise(path)
    (path.parent / "images" / "t001-dark-000.png").unlink()
    with pytest.raises(ValueError, match="not a readable image"):
        characterise(path)
    path.write_text("b 1000 20\ni a.png\ni b.png\nd 2000\n")
    with pytest.raises(ValueError, match="not a readable image"):
        characterise(path)
    path.write_text("d 2000\n")
    with pytest.raises(ValueError, match="dark pair"):
        characterise(path)
