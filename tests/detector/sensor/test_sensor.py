"""The sensor's draws against its closed form, and both against the physics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.special import gammaln, ndtr
from scipy.stats import chi2, norm, poisson

from detector.sensor import sensor as module
from detector.sensor.sensor import Sensor, collected_moments, expose, fixed_pattern, moments, presets
from radiometry.optics import Camera

REFERENCE = Sensor()
# Small wells keep the exact sums short; the physics is that of any well.
CASES = [
    Sensor(
        gain_electrons_per_dn=gain, read_noise_electrons=read, offset_dn=offset, full_well_electrons=2000.5, bits=bits
    )
    for gain, bits in ((0.1, 16), (0.3, 12), (1.0, 12), (5.0, 12), (7.3, 8), (20.0, 12))
    for read, offset in ((0.0, 2), (0.05, 0), (0.4, 64), (2.0, 3), (28.2, 10), (28.2, 0))
]
LEVELS = (0.0, 0.2, 3.0, 9.9, 10.1, 150.0, 1900.0, 1990.0, 2010.0, 2080.0, 1e5)


def sidak(confidence: float, tests: int) -> float:
    """Two-sided standard score whose family of tests passes with the given confidence when nothing is wrong."""
    return float(norm.ppf(0.5 + confidence ** (1 / tests) / 2))


def test_expose_agrees_with_moments_from_dark_to_beyond_saturation() -> None:
    pixels = 40_000
    rng = np.random.default_rng(20260101)
    scores = []
    fixed = 0
    for sensor in [*CASES, REFERENCE]:
        levels = np.array(LEVELS) * (sensor.full_well_electrons / 2000.5 if sensor is REFERENCE else 1)
        for level, mean, variance in zip(levels, *moments(sensor, levels, 1.0), strict=True):
            dn = expose(sensor, np.full((200, pixels // 200), level), 1.0, rng).dn.astype(float)
            if variance * pixels < 0.01:  # not one deviating pixel is expected in a hundred frames
                assert np.all(dn == np.rint(mean)), (sensor, level)
                fixed += 1
                continue
            if variance * pixels < 50:  # steps of one number, too rare for a normal score
                rare, expected = np.sum(dn != np.rint(mean)), variance * pixels
                above = rare > expected
                tail = poisson.sf(rare - 1, expected) if above else poisson.cdf(rare, expected)
                scores.append(((1 if above else -1) * norm.isf(tail), "rare steps", level, sensor))
                continue
            if np.sum(dn != np.rint(mean)) < 200:  # some steps of many numbers: no normal score either
                fixed += 1
                continue
            deviation = dn - mean
            spread = np.mean((deviation**2 - variance) ** 2) + variance / pixels
            scores.append((np.mean(deviation) / np.sqrt(variance / pixels), "mean", level, sensor))
            scores.append((np.mean(deviation**2 - variance) / np.sqrt(spread / pixels), "variance", level, sensor))
    assert len(scores) > 2 * fixed
    limit = sidak(0.999, len(scores))
    worst = max(scores, key=lambda s: abs(s[0]))
    assert abs(worst[0]) < limit, worst


@pytest.mark.parametrize(("mean", "distance"), [(10.0, 1.4e-4), (20.0, 3.3e-5), (30.0, 1.5e-5), (200.0, 5e-7)])
def test_normal_expansion_is_a_poisson_law_from_the_switch_on(mean: float, distance: float) -> None:
    k = np.arange(int(mean + 12 * np.sqrt(mean)))
    low, high = np.full(len(k), -12.0), np.full(len(k), 12.0)
    for _ in range(60):  # the score from which on more than k is drawn
        middle = (low + high) / 2
        more = module._poisson_quantile(middle, np.full(len(k), mean)) > k
        low, high = np.where(more, low, middle), np.where(more, middle, high)
    drawn = np.diff(ndtr(high), prepend=0)
    assert 0.5 * np.sum(np.abs(drawn - poisson.pmf(k, mean))) < distance
    assert np.sum(k * drawn) == pytest.approx(mean, abs=1e-5)
    assert np.sum((k - mean) ** 2 * drawn) == pytest.approx(mean, rel=3e-4)


@pytest.mark.parametrize("mean", [0.0, 0.02, 0.5, 3.0, 10.0])
def test_inversion_is_a_poisson_law_below_the_switch(mean: float) -> None:
    """Total variation distance of the drawn law, from the cumulative sums that uniform numbers are held against."""

    class Ladder:
        """Hands out evenly spaced numbers for uniform ones: the drawn law's probabilities to one over their count."""

        def random(self, shape: tuple[int, ...], dtype: type) -> np.ndarray:
            return ((np.arange(shape[0]) + 0.5) / shape[0]).astype(dtype)

    steps = 2**22
    counts = module._poisson_inverse(np.full(steps, mean, np.float32), Ladder()).astype(int)
    drawn = np.bincount(counts, minlength=64) / steps
    assert 0.5 * np.sum(np.abs(drawn - poisson.pmf(np.arange(64), mean))) < 1e-6 + 32 / 2 / steps


@pytest.mark.parametrize("mean", [0.02, 0.5, 3.0, 9.99, 10.01, 60.0])
def test_counts_on_both_sides_of_the_switch_pass_chi_square(mean: float) -> None:
    counts = module._poisson(np.full(1_000_000, mean, np.float32), np.random.default_rng(7)).astype(int)
    expected = poisson.pmf(np.arange(counts.max() + 1), mean) * len(counts)
    observed = np.bincount(counts)
    usual = expected >= 20
    statistic = np.sum((observed[usual] - expected[usual]) ** 2 / expected[usual])
    rest = len(counts) - expected[usual].sum()
    statistic += (observed[~usual].sum() - rest) ** 2 / rest
    assert statistic < chi2.ppf(0.999, usual.sum())


@pytest.mark.parametrize("full_well", [0.5, 1.0, 50.0, 50.7, 900.0])
def test_collected_moments_equal_the_sum_over_counts(full_well: float) -> None:
    sensor = Sensor(full_well_electrons=full_well)
    means = full_well * np.array([0.0, 0.01, 0.5, 0.9, 0.99, 1.0, 1.01, 1.1, 1.5, 3.0, 1e4])
    counts = np.arange(20_000)
    for mean, *found in zip(means, *collected_moments(sensor, means), strict=True):
        if mean > 1e4:
            assert found == [full_well, 0.0]
            continue
        weights = np.exp(counts * np.log(mean) - mean - gammaln(counts + 1)) if mean > 0 else (counts == 0) * 1.0
        charge = np.minimum(counts, full_well)
        expected = weights @ charge / weights.sum()
        assert found[0] == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert found[1] == pytest.approx(weights @ (charge - expected) ** 2 / weights.sum(), rel=1e-6, abs=1e-7)


def test_sum_and_closed_form_agree_where_both_hold() -> None:
    levels = np.array([0.0, 5.0, 300.0, 19_000.0, 19_900.0, 20_100.0])
    mean, variance = moments(REFERENCE, levels, 1.0)
    summed = np.array([module._summed_moments(REFERENCE, level) for level in levels])
    np.testing.assert_allclose(mean, summed[:, 0], atol=1e-5)
    np.testing.assert_allclose(variance, summed[:, 1], rtol=1e-5)


def test_moments_keep_the_shape_of_the_rates() -> None:
    mean, variance = moments(REFERENCE, np.full((3, 4), 100.0), 2.0)
    assert mean.shape == variance.shape == (3, 4)
    assert float(mean[0, 0]) == pytest.approx(64 + 200 / 5)
    assert float(variance[0, 0]) == pytest.approx((200 + 28.2**2) / 25 + 1 / 12)
    assert moments(REFERENCE, 1.0, 1.0)[0].shape == ()


SENSORS = st.builds(
    Sensor,
    gain_electrons_per_dn=st.floats(0.1, 20),
    read_noise_electrons=st.one_of(st.just(0.0), st.floats(0.01, 50)),
    offset_dn=st.floats(0, 200),
    full_well_electrons=st.floats(1, 5000),
    bits=st.integers(8, 16),
    dark_current_electrons_per_s=st.floats(0, 100),
)


@given(SENSORS, st.lists(st.floats(0, 1e5), min_size=2, max_size=8), st.floats(1e-6, 10))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_mean_rises_with_the_rate_and_stays_in_range(sensor: Sensor, rates: list[float], exposure_s: float) -> None:
    mean, variance = moments(sensor, np.sort(rates), exposure_s)
    assert np.all(np.diff(mean) >= -1e-5)
    assert np.all((mean >= -1e-9) & (mean <= sensor.max_dn + 1e-9))
    assert np.all(variance >= 0)


@given(SENSORS, st.floats(0, 1e12), st.integers(0, 2**32 - 1))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_frames_are_16_bit_in_range_and_reproducible(sensor: Sensor, rate: float, seed: int) -> None:
    rates = np.array([[0.0, rate], [rate / 2, 1.0]])
    frame = expose(sensor, rates, 0.1, np.random.default_rng(seed))
    again = expose(sensor, rates, 0.1, np.random.default_rng(seed))
    assert frame.dn.dtype == np.uint16
    assert frame.dn.shape == frame.electrons.shape == (2, 2)
    assert frame.dn.max() <= sensor.max_dn
    assert frame.electrons.min() >= 0
    assert frame.electrons.max() <= np.float32(sensor.full_well_electrons)
    np.testing.assert_array_equal(frame.dn, again.dn)


def test_rounding_is_to_nearest() -> None:
    sensor = Sensor(gain_electrons_per_dn=4, read_noise_electrons=0, offset_dn=0, full_well_electrons=3)
    assert np.all(expose(sensor, np.full((8, 8), 1e6), 1.0, np.random.default_rng(0)).dn == 1)


@pytest.mark.parametrize(
    ("rates", "exposure_s", "message"),
    [
        ([[-1.0]], 1.0, "electrons_per_s"),
        ([[np.nan]], 1.0, "electrons_per_s"),
        ([[np.inf]], 1.0, "electrons_per_s"),
        ([[1e16]], 1.0, "mean charge"),
        ([1.0, 2.0], 1.0, "height, width"),
        ([[1.0]], 0.0, "exposure_s"),
        ([[1.0]], -1.0, "exposure_s"),
        ([[1.0]], np.nan, "exposure_s"),
    ],
)
def test_impossible_exposures_are_refused(rates: list[float], exposure_s: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        expose(REFERENCE, rates, exposure_s, np.random.default_rng(0))
    if message != "height, width":
        with pytest.raises(ValueError, match=message):
            moments(REFERENCE, rates, exposure_s)


@pytest.mark.parametrize(
    "field",
    [
        {"quantum_efficiency": 1.2},
        {"quantum_efficiency": [[400, 0.1], [300, 0.2]]},
        {"quantum_efficiency": [[400, 0.1], [500, 1.2]]},
        {"quantum_efficiency": []},
        {"full_well_electrons": 0},
        {"bits": 17},
        {"offset_dn": 4095},
        {"read_noise": 3},
    ],
)
def test_impossible_sensors_are_refused(field: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Sensor(**field)


def test_quantum_efficiency_is_a_spectrum() -> None:
    assert REFERENCE.qe_spectrum()(850.0) == 0.35
    assert REFERENCE.qe_spectrum()(1150.0) == 0.0
    table = Sensor(quantum_efficiency=[[800, 0.4], [900, 0.2]])
    assert table.qe_spectrum()(850.0) == pytest.approx(0.3)


def test_derived_numbers() -> None:
    assert REFERENCE.max_dn == 4095
    assert REFERENCE.saturation_dn == 64 + 4000
    assert Sensor(gain_electrons_per_dn=1).saturation_dn == 4095
    assert REFERENCE.total_noise_electrons == pytest.approx(np.hypot(28.2, 5 / np.sqrt(12)))


def test_dark_current_doubles_and_is_collected() -> None:
    sensor = Sensor(dark_current_electrons_per_s=1000, temperature_c=36, reference_temperature_c=20, doubling_k=8)
    assert sensor.dark_electrons(0.5) == pytest.approx(2000)
    frame = expose(sensor, np.zeros((300, 300)), 0.5, np.random.default_rng(3))
    mean, variance = frame.electrons.mean(), frame.electrons.var()
    limit = sidak(0.999, 2)
    assert abs(mean - 2000) < limit * np.sqrt(2000 / 9e4)
    assert abs(variance / 2000 - 1) < limit * np.sqrt(2 / 9e4)


def test_fixed_pattern_is_constant_and_of_the_stated_strength() -> None:
    sensor = Sensor(prnu=0.02, dsnu_electrons=15.0, read_noise_electrons=3.0, dark_current_electrons_per_s=0.0)
    shape = (200, 300)
    pattern = fixed_pattern(sensor, shape, np.random.default_rng(5))
    np.testing.assert_array_equal(pattern.prnu, fixed_pattern(sensor, shape, np.random.default_rng(5)).prnu)
    pixels = shape[0] * shape[1]
    limit = sidak(0.999, 6)
    for found, true in ((pattern.prnu.std(), 0.02), (pattern.dsnu_electrons.std(), 15.0)):
        assert abs(found / true - 1) < limit / np.sqrt(2 * pixels)

    rng = np.random.default_rng(6)
    frames, signal = 16, 10_000.0
    rate = np.full(shape, signal)
    bright = np.mean([expose(sensor, rate, 1.0, rng, pattern).dn for _ in range(frames)], axis=0)
    dark = np.mean([expose(sensor, 0 * rate, 1.0, rng, pattern).dn for _ in range(frames)], axis=0)
    for image, expected, temporal in (
        ((dark - 64) * 5, pattern.dsnu_electrons, 3**2 + 25 / 12),
        ((bright - dark) * 5 - signal, pattern.prnu * signal, signal + 2 * (3**2 + 25 / 12)),
    ):
        slope = np.sum(image * expected) / np.sum(expected**2.0)
        residual = np.var(image - expected) / (temporal / frames)
        assert abs(slope - 1) < limit * np.sqrt(temporal / frames / np.sum(expected**2.0))
        # The rounding error of nearly equal frames is shared, hence the allowance beside the statistics.
        assert abs(residual - 1) < limit * np.sqrt(2 / pixels) + 0.02


def test_fixed_pattern_must_fit_the_frame() -> None:
    pattern = fixed_pattern(REFERENCE, (4, 4), np.random.default_rng(0))
    with pytest.raises(ValueError, match="fixed_pattern"):
        expose(REFERENCE, np.zeros((4, 5)), 1.0, np.random.default_rng(0), pattern)


def test_charge_is_clipped_without_blooming() -> None:
    rates = np.zeros((101, 5))
    rates[50, 2] = 1e6
    frame = expose(REFERENCE, rates, 1.0, np.random.default_rng(1))
    assert frame.electrons[50, 2] == 20_000
    assert frame.electrons.sum() == 20_000


@pytest.mark.parametrize("fraction", [1.0, 0.4])
def test_blooming_conserves_charge_along_the_column(fraction: float) -> None:
    rates = np.full((301, 5), 500.0)
    rates[148:153, 2] = 2e5
    clipped = Sensor(blooming=0, full_well_electrons=1e9)
    sensor = Sensor(blooming=fraction)
    drawn = expose(clipped, rates, 1.0, np.random.default_rng(2)).electrons.astype(float)
    bloomed = expose(sensor, rates, 1.0, np.random.default_rng(2)).electrons.astype(float)
    excess = np.maximum(drawn - 20_000, 0).sum()
    assert bloomed.sum() == pytest.approx(drawn.sum() - (1 - fraction) * excess, rel=1e-7)
    assert bloomed.max() <= 20_000
    np.testing.assert_array_equal(np.delete(bloomed, 2, axis=1), np.delete(drawn, 2, axis=1))
    full = np.nonzero(bloomed[:, 2] == 20_000)[0]
    assert np.all(np.diff(full) == 1)
    assert abs((full[0] + full[-1]) / 2 - 150) <= 1


def test_charge_that_blooms_over_the_edge_is_lost() -> None:
    rates = np.zeros((10, 3))
    rates[5, 1] = 1e9
    frame = expose(Sensor(blooming=True), rates, 1.0, np.random.default_rng(2))
    assert np.all(frame.electrons[:, 1] == 20_000)
    assert np.all(frame.electrons[:, [0, 2]] == 0)


@pytest.mark.parametrize("name", sorted(presets()))
def test_every_preset_value_says_where_it_comes_from(name: str) -> None:
    preset = presets()[name]
    assert set(preset.provenance) == preset.sensor.model_fields_set | {"grid"}
    assert all(text.startswith(("source: ", "assumption: ")) for text in preset.provenance.values())
    Camera(**preset.grid)
    assert preset.sensor.saturation_dn < preset.sensor.max_dn
    assert 0.1 < preset.sensor.qe_spectrum()(850.0) < 0.6
