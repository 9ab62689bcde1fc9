"""Image sensor: electron rate to charge to digital numbers, drawn (`expose`) and in closed form (`moments`).

The chain is the linear camera model of EMVA 1288 (release 3.1, section 2) with a full well and a bounded converter:
shot noise of signal and dark charge, clipping at the full well, read noise, gain, offset, rounding, clipping.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from scipy.special import gammainc, gammaln, ndtr

from radiometry.geometry import FloatArray
from radiometry.parameters import Fraction
from radiometry.spectrum import Spectrum, constant

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Float32Array = NDArray[np.float32]

#: From this mean on Poisson counts are drawn through the normal quantile expansion (see `_poisson`).
POISSON_SWITCH = 10.0
#: Mean charges beyond this are refused: no scene gives them, and float32 arithmetic would end there.
MAX_MEAN_ELECTRONS = 1e15
#: Pixels worked on at a time, so that the temporaries stay in the second-level cache.
_BLOCK = 32768


class Sensor(BaseModel):
    """One monochrome image sensor. The defaults are the project's VBS reference camera.

    That reference is a mixture, kept for comparison with the budget of the thesis: QE and read noise are the thesis's
    figures for the GT4096 NIR, the pixel grid (see `radiometry.optics.Camera`) is the VBS's. Presets that each describe
    one real sensor are in `detector/data/sensors.toml`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    quantum_efficiency: Fraction | tuple[tuple[float, float], ...] = Field(
        0.35,
        description="electrons per photon: a number or rows of [wavelength_nm, value] (thesis, section 6.2)",
    )
    full_well_electrons: Positive = Field(20_000.0, description="charge at which a pixel saturates [e-]; assumption")
    read_noise_electrons: NonNegative = Field(28.2, description="temporal dark noise, rms [e-] (thesis, table 7.1)")
    dark_current_electrons_per_s: NonNegative = Field(
        0.0, description="dark charge rate at the reference temperature [e-/s]; assumption, the thesis gives none"
    )
    temperature_c: Finite = Field(20.0, ge=-273.15, description="sensor temperature [deg C]")
    reference_temperature_c: Finite = Field(20.0, ge=-273.15, description="temperature of the dark current [deg C]")
    doubling_k: Positive = Field(
        8.0, description="warming that doubles the dark current [K]; assumption, silicon 6-9 K"
    )
    gain_electrons_per_dn: Positive = Field(5.0, description="conversion gain [e-/DN]; assumption")
    offset_dn: NonNegative = Field(64.0, description="black level [DN]; assumption")
    bits: int = Field(12, ge=1, le=16, description="resolution of the converter [bit]; assumption")
    prnu: Fraction = Field(0.0, description="photo response non-uniformity, 1 sigma as a fraction of the response")
    dsnu_electrons: NonNegative = Field(0.0, description="dark signal non-uniformity, 1 sigma [e-]")
    hot_fraction: Fraction = Field(0.0, description="share of pixels that are hot, at places drawn once for the camera")
    hot_electrons: NonNegative = Field(
        20_000.0, description="charge that a hot pixel shows in every frame [e-]; assumption"
    )
    dead_fraction: Fraction = Field(0.0, description="share of pixels that do not respond to light, drawn likewise")
    blooming: Fraction = Field(
        0.0, description="part of the charge above the full well that overflows along its column (false: 0, true: 1)"
    )

    @field_validator("quantum_efficiency")
    @classmethod
    def _check_table(cls, value: float | tuple[tuple[float, float], ...]) -> float | tuple[tuple[float, float], ...]:
        if isinstance(value, tuple):
            Spectrum(*np.array(value, float).reshape(-1, 2).T)
            if not all(0 <= efficiency <= 1 for _, efficiency in value):
                raise ValueError("quantum_efficiency: every value of the table must lie between 0 and 1")
        return value

    @model_validator(mode="after")
    def _check_offset(self) -> Sensor:
        if self.offset_dn >= self.max_dn:
            raise ValueError(f"offset_dn {self.offset_dn:g}: must be below the largest number, {self.max_dn} DN")
        return self

    def qe_spectrum(self) -> Spectrum:
        """Quantum efficiency over wavelength; a single number holds from 300 to 1100 nm, silicon's range."""
        if isinstance(self.quantum_efficiency, tuple):
            return Spectrum(*np.array(self.quantum_efficiency, float).T)
        return constant(self.quantum_efficiency, 300.0, 1100.0)

    @property
    def max_dn(self) -> int:
        """Largest number of the converter, 2^bits − 1 [DN]."""
        return 2**self.bits - 1

    @property
    def saturation_dn(self) -> int:
        """Number at which the response ends [DN]: that of the full well or the largest, whichever is less."""
        return int(min(np.rint(self.offset_dn + self.full_well_electrons / self.gain_electrons_per_dn), self.max_dn))

    @property
    def total_noise_electrons(self) -> float:
        """Noise of a pixel without charge, √(read² + gain²/12) [e-]: read and quantisation noise (EMVA 1288, 2.2)."""
        return math.sqrt(self.read_noise_electrons**2 + self.gain_electrons_per_dn**2 / 12)

    @property
    def dark_rate_electrons_per_s(self) -> float:
        """Dark charge rate at the sensor's temperature [e-/s]; doubles every `doubling_k` (EMVA 1288, section 3.2)."""
        doublings = (self.temperature_c - self.reference_temperature_c) / self.doubling_k
        return self.dark_current_electrons_per_s * 2**doublings

    def dark_electrons(self, exposure_s: float) -> float:
        """Mean dark charge of one exposure [e-]."""
        return self.dark_rate_electrons_per_s * _checked_exposure(exposure_s)


@dataclass(frozen=True)
class Preset:
    """One real sensor of `detector/data/sensors.toml`.

    Attributes:
        description: what it is.
        sensor: its parameters.
        grid: `width_px`, `height_px`, `pixel_pitch_x_m`, `pixel_pitch_y_m`, fields of `radiometry.optics.Camera`.
        provenance: source or assumption of every value, by field; `grid` for the pixel grid.
    """

    description: str
    sensor: Sensor
    grid: dict[str, float]
    provenance: dict[str, str]


def presets() -> dict[str, Preset]:
    """The real sensors that come with the project, by name."""
    tables = tomllib.loads((files("detector") / "data" / "sensors.toml").read_text(encoding="utf-8"))
    return {
        name: Preset(table["description"], Sensor(**table["sensor"]), table["grid"], table["provenance"])
        for name, table in tables.items()
    }


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """The constant deviations of one camera's pixels.

    Attributes:
        prnu: (H, W) relative deviation of the photo response, above −1.
        dsnu_electrons: (H, W) deviation of the dark signal [e-].
    """

    prnu: Float32Array
    dsnu_electrons: Float32Array


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure.

    Attributes:
        electrons: (H, W) float32, charge in each well after clipping and blooming, before read noise [e-].
        dn: (H, W) uint16, digital numbers [DN].
    """

    electrons: Float32Array
    dn: NDArray[np.uint16]


def fixed_pattern(sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> FixedPattern:
    """A camera's maps, drawn once from its own seed: white Gaussian PRNU and DSNU of the sensor's 1-sigma values.

    Hot pixels stand in the map of the dark signal, dead ones in that of the response, at −1.

    Args:
        sensor: gives the strengths.
        rng: the camera's own generator.
        shape: (height, width) of the detector.
    """
    prnu = rng.standard_normal(shape, np.float32) * np.float32(sensor.prnu)
    dsnu = rng.standard_normal(shape, np.float32) * np.float32(sensor.dsnu_electrons)
    # Drawn whatever the shares, so that one more hot pixel changes no other pixel.
    fate = rng.random(shape, np.float32)
    prnu[fate < sensor.dead_fraction] = -1
    dsnu[fate > 1 - sensor.hot_fraction] += np.float32(sensor.hot_electrons)
    return FixedPattern(np.maximum(prnu, np.float32(-1)), dsnu)


def expose(
    sensor: Sensor,
    electrons_per_s: ArrayLike,
    exposure_s: float,
    rng: np.random.Generator,
    fixed_pattern: FixedPattern | None = None,
) -> Frame:
    """Draw one frame.

    The charge is Poisson with mean rate · t · (1 + PRNU) + dark · t, clipped at the full well (the excess blooms, if
    the sensor lets it). The number is rint((charge + DSNU + read noise) / gain + offset), clipped to 0 … 2^bits − 1.
    DSNU is an offset of the dark signal: it carries no shot noise, takes no room in the well and may be negative.

    Args:
        sensor: that is exposed.
        electrons_per_s: (H, W) mean photo-electron rate, quantum efficiency included [e-/s].
        exposure_s: integration time [s].
        rng: the frame's generator; the same state gives the same frame.
        fixed_pattern: the camera's maps of the same shape; none means identical pixels.

    Raises:
        ValueError: when a rate is negative, not finite or beyond `MAX_MEAN_ELECTRONS` in all, the exposure is not
            positive, or a shape differs.
    """
    rate, exposure_s = _checked_rate(electrons_per_s), _checked_exposure(exposure_s)
    if rate.ndim != 2:
        raise ValueError(f"electrons_per_s: shape {rate.shape}, expected (height, width)")
    _checked_mean(rate.max(initial=0.0) * exposure_s + sensor.dark_electrons(exposure_s))
    if fixed_pattern is not None and not (fixed_pattern.prnu.shape == fixed_pattern.dsnu_electrons.shape == rate.shape):
        raise ValueError(f"fixed_pattern: maps {fixed_pattern.prnu.shape}, expected the frame's shape {rate.shape}")
    electrons = _collect(sensor, rate, exposure_s, rng, None if fixed_pattern is None else fixed_pattern.prnu)
    if sensor.blooming > 0:
        _bloom(electrons, sensor.full_well_electrons, sensor.blooming)
    dn = _read_out(sensor, electrons, rng, None if fixed_pattern is None else fixed_pattern.dsnu_electrons)
    return Frame(electrons, dn)


def _checked_exposure(exposure_s: float) -> float:
    if not (exposure_s > 0 and math.isfinite(exposure_s)):
        raise ValueError(f"exposure_s: {exposure_s} s, expected a positive finite time [s]")
    return float(exposure_s)


def _checked_rate(electrons_per_s: ArrayLike) -> NDArray[np.floating]:
    rate = np.asarray(electrons_per_s)
    if rate.dtype != np.float32:
        rate = rate.astype(float, copy=False)
    if rate.size and not (rate.min() >= 0 and rate.max() < np.inf):  # a NaN fails both comparisons
        raise ValueError("electrons_per_s: every rate must be finite and not negative [e-/s]")
    return rate


def _checked_mean(largest_electrons: float) -> None:
    if largest_electrons > MAX_MEAN_ELECTRONS:
        raise ValueError(
            f"electrons_per_s: mean charge {largest_electrons:.3g} e-, expected at most {MAX_MEAN_ELECTRONS:.0e} e-"
        )


def _collect(
    sensor: Sensor,
    rate: NDArray[np.floating],
    exposure_s: float,
    rng: np.random.Generator,
    prnu: Float32Array | None,
) -> Float32Array:
    """Charge of each pixel [e-], clipped at the full well unless it may bloom."""
    electrons = np.empty(rate.shape, np.float32)
    flat, flat_rate = electrons.reshape(-1), rate.reshape(-1)
    flat_prnu = None if prnu is None else prnu.reshape(-1)
    dark = np.float32(sensor.dark_electrons(exposure_s))
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        mean = (flat_rate[part] * exposure_s).astype(np.float32, copy=False)
        if flat_prnu is not None:
            mean = mean + mean * flat_prnu[part]
        flat[part] = _poisson(mean + dark, rng)
        if sensor.blooming == 0:
            np.minimum(flat[part], np.float32(sensor.full_well_electrons), out=flat[part])
    return electrons


def _poisson(mean: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Poisson counts of a vector of means, float32.

    Below `POISSON_SWITCH` by inversion (`_poisson_inverse`). From there the quantile function of the normal expansion of Giles
    (ACM TOMS 42(1), 2016, algorithm 955) applied to a standard normal z and rounded down:
    λ + √λ z + (2 + z²)/6 − (z³ + 2z)/(72 √λ) + (3z⁴ + 7z² − 16)/(810 λ). Its total variation distance from the Poisson
    law is 1.4e-4 at mean 10, 3e-5 at 20 and 5e-7 at 200 and falls on; at the switch the mean is right to 1e-5 e- and
    the variance to 3e-4 of itself. A test computes these figures.
    """
    low = mean < POISSON_SWITCH
    if low.all():
        return _poisson_inverse(mean, rng)
    z = rng.standard_normal(mean.shape, np.float32)
    counts = _poisson_quantile(z, np.maximum(mean, np.float32(POISSON_SWITCH)))
    if low.any():
        counts[low] = _poisson_inverse(mean[low], rng)
    return counts


def _poisson_inverse(mean: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Poisson counts of a vector of means up to `POISSON_SWITCH`: how many of the law's cumulative sums a uniform number exceeds.

    All pixels walk up the counts together, as far as the brightest needs; a tail of 2⁻²⁴, the uniform numbers' own step, is cut
    off. The total variation distance from the Poisson law is below 1e-6: single precision's rounding of the sums.
    """
    uniform = rng.random(mean.shape, np.float32)
    chance = np.exp(-mean)
    below = chance.copy()
    counts, over = np.zeros(mean.shape, np.uint8), np.empty(mean.shape, bool)
    for k in range(1, _LAST_COUNT[math.ceil(mean.max(initial=0.0))] + 1):
        np.greater_equal(uniform, below, out=over)
        counts += over.view(np.uint8)
        chance *= mean
        chance *= np.float32(1 / k)
        below += chance
    return counts.astype(np.float32)


def _last_count(mean: int) -> int:
    """Largest count whose chance of being exceeded is above 2⁻²⁴."""
    count = mean
    while mean and gammainc(count + 1, mean) > 2.0**-24:
        count += 1
    return count


#: Largest counts that `_poisson_inverse` draws, by mean up to the switch.
_LAST_COUNT = [_last_count(mean) for mean in range(math.ceil(POISSON_SWITCH) + 1)]


def _poisson_quantile(z: NDArray[np.floating], mean: NDArray[np.floating]) -> NDArray[np.floating]:
    """Poisson counts at standard normal scores z, for means of `POISSON_SWITCH` and more."""
    root = np.sqrt(mean)
    square = z * z
    inverse = 1 / root
    cubic = z * (square + 2) / 72
    quartic = (square * (3 * square + 7) - 16) / 810
    counts = mean + root * z + (square + 2) / 6 + inverse * (inverse * quartic - cubic)
    np.floor(counts, out=counts)
    return np.maximum(counts, 0, out=counts)


def _bloom(electrons: Float32Array, full_well: float, fraction: float) -> None:
    """Let the charge above the full well run along its column, in place.

    Half of the overflow goes down and half up; each half fills the wells it meets and passes on what is left, downwards
    first. Charge that runs out at either end of a column is lost, as is 1 − fraction of the overflow (drained).
    """
    columns = np.nonzero((electrons > full_well).any(axis=0))[0]
    wells = electrons[:, columns].astype(float)
    half = np.maximum(wells - full_well, 0) * (fraction / 2)
    np.minimum(wells, full_well, out=wells)
    for rows in (range(len(wells)), range(len(wells) - 1, -1, -1)):
        carry = np.zeros(len(columns))
        for row in rows:
            filled = np.minimum(wells[row] + carry, full_well)
            carry = carry - (filled - wells[row]) + half[row]
            wells[row] = filled
    electrons[:, columns] = wells


def _read_out(
    sensor: Sensor, electrons: Float32Array, rng: np.random.Generator, dsnu_electrons: Float32Array | None
) -> NDArray[np.uint16]:
    """Digital numbers of the collected charge."""
    dn = np.empty(electrons.shape, np.uint16)
    flat, flat_electrons = dn.reshape(-1), electrons.reshape(-1)
    flat_dsnu = None if dsnu_electrons is None else dsnu_electrons.reshape(-1)
    read_noise, per_electron = np.float32(sensor.read_noise_electrons), np.float32(1 / sensor.gain_electrons_per_dn)
    offset, largest = np.float32(sensor.offset_dn), np.float32(sensor.max_dn)
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        signal = rng.standard_normal(len(flat[part]), np.float32)
        signal *= read_noise
        signal += flat_electrons[part]
        if flat_dsnu is not None:
            signal += flat_dsnu[part]
        signal *= per_electron
        signal += offset
        np.rint(signal, out=signal)
        np.clip(signal, np.float32(0), largest, out=signal)
        flat[part] = signal
    return dn


def collected_moments(sensor: Sensor, mean_electrons: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Mean [e-] and variance [e-²] of the charge min(N, F): N Poisson of the given mean, F the full well, no blooming.

    With the overflow A = max(N − F, 0): E = λ − E[A], Var = λ + Var A − 2 Cov(N, A). The restricted moments of a
    Poisson variable are its own tail probabilities, E[N; N > f] = λ P(N ≥ f) and E[N(N−1); N > f] = λ² P(N ≥ f − 1),
    each a regularised incomplete gamma function. Above the full well the same is done with the deficit max(F − N, 0).
    """
    mean = np.array(_checked_rate(mean_electrons), float)
    full = sensor.full_well_electrons
    expected, variance = mean.copy(), mean.copy()
    reach = 9 * np.sqrt(mean) + 40  # no charge beyond: the tail there is below 1e-18
    saturated = mean - reach > full
    expected[saturated], variance[saturated] = full, 0.0
    near = ~saturated & (mean + reach > full)
    lam = mean[near]
    last = math.floor(full)

    def tail(first: int) -> FloatArray:  # P(N >= first)
        return gammainc(first, lam) if first > 0 else np.ones_like(lam)

    over, over1, over2 = tail(last + 1), tail(last), tail(last - 1)
    below = lam < full
    # signs and probabilities of the overflow (N > f) or, for mean above the full well, of the deficit (N <= f)
    p0, p1, p2 = (np.where(below, t, 1 - t) for t in (over, over1, over2))
    first = np.where(below, 1, -1) * (lam * p1 - full * p0)
    second = lam**2 * p2 + (1 - 2 * full) * lam * p1 + full**2 * p0
    joint = lam**2 * p2 + lam * (1 - full - lam) * p1 + lam * full * p0
    expected[near] = np.where(below, lam - first, full - first)
    variance[near] = np.maximum(np.where(below, lam + second - first**2 - 2 * joint, second - first**2), 0)
    return expected, variance


def moments(sensor: Sensor, electrons_per_s: ArrayLike, exposure_s: float) -> tuple[FloatArray, FloatArray]:
    """Mean [DN] and variance [DN²] of one pixel's numbers over exposures, in closed form; shapes as the rates.

    Full well, read noise, rounding and both ends of the converter are included; fixed pattern and blooming are not.
    Where the read noise is at least 0.85 DN and no end of the converter is in reach, the terms add: collected moments
    over gain, read noise, 1/12 DN². Elsewhere the conditional moments of the number, given the charge, are summed over
    the Poisson law of the charge, at a cost of about 18 √λ terms per distinct mean λ. Both are valid for every rate and
    setting; what is neglected is below 1e-5 DN in the mean and 1e-5 of the variance.

    Raises:
        ValueError: as `expose`.
    """
    mean = _checked_rate(electrons_per_s) * _checked_exposure(exposure_s) + sensor.dark_electrons(exposure_s)
    mean = np.asarray(mean, float)
    _checked_mean(mean.max(initial=0.0))
    gain, noise_dn = sensor.gain_electrons_per_dn, sensor.read_noise_electrons / sensor.gain_electrons_per_dn
    collected, variance = collected_moments(sensor, mean)
    mean_dn = np.asarray(collected / gain + sensor.offset_dn)
    variance_dn = np.asarray(variance / gain**2 + noise_dn**2 + 1 / 12)

    reach = 9 * np.sqrt(mean) + 40
    lowest = np.clip(mean - reach, 0, sensor.full_well_electrons) / gain + sensor.offset_dn
    highest = np.clip(mean + reach, 0, sensor.full_well_electrons) / gain + sensor.offset_dn
    unclipped = (lowest + 0.5 > 5 * noise_dn) & (sensor.max_dn + 0.5 - highest > 5 * noise_dn)
    summed = ~(unclipped & (noise_dn >= _SMOOTH_DN))
    if summed.any():
        rates, inverse = np.unique(mean[summed], return_inverse=True)
        pairs = np.array([_summed_moments(sensor, lam) for lam in rates])
        mean_dn[summed], variance_dn[summed] = pairs[inverse].T
    return mean_dn, variance_dn


#: Read noise [DN] from which rounding adds 1/12 DN² and nothing else: the first lattice term, exp(−2π²s²), is 6e-7.
_SMOOTH_DN = 0.85


def _summed_moments(sensor: Sensor, mean: float) -> tuple[float, float]:
    """Mean and variance [DN, DN²] at one mean charge: the conditional moments summed over the Poisson law."""
    full = sensor.full_well_electrons
    reach = 9 * math.sqrt(mean) + 40
    counts = np.arange(max(0, math.floor(mean - reach)), min(math.ceil(mean + reach), math.ceil(full) - 1) + 1)
    logs = counts * math.log(mean) - mean - gammaln(counts + 1) if mean > 0 else np.where(counts == 0, 0.0, -np.inf)
    weights = np.append(np.exp(logs), gammainc(math.ceil(full), mean))
    conditional, spread = _conditional_moments(sensor, np.append(counts, full))
    average = float(weights @ conditional / weights.sum())
    return average, float(weights @ (spread + (conditional - average) ** 2) / weights.sum())


def _conditional_moments(sensor: Sensor, electrons: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and variance [DN, DN²] of the number of wells that hold a known charge: a rounded, clipped Gaussian."""
    noise = sensor.read_noise_electrons / sensor.gain_electrons_per_dn
    centre = electrons / sensor.gain_electrons_per_dn + sensor.offset_dn
    if noise == 0:
        return np.clip(
            np.rint(
                np.float32(electrons) * np.float32(1 / sensor.gain_electrons_per_dn) + np.float32(sensor.offset_dn)
            ),
            0,
            sensor.max_dn,
        ), np.zeros(len(electrons))
    if noise < _SMOOTH_DN:
        numbers = np.rint(centre)[:, None] + np.arange(-9, 10)  # ±10 sigma and more
        edges = (numbers[:, :1] - 0.5 + np.arange(20) - centre[:, None]) / noise
        chance = np.diff(ndtr(edges), axis=1)
        clipped = np.clip(numbers, 0, sensor.max_dn)
        mean = (chance * clipped).sum(axis=1)
        return mean, (chance * (clipped - mean[:, None]) ** 2).sum(axis=1)
    # Censored normal moments about the centre, then the Euler-Maclaurin terms that turn the integrals over y of
    # P(Y > y) and 2y P(Y > y) into the sums over whole numbers.
    low, high = -centre / noise, (sensor.max_dn - centre) / noise
    density_low, density_high = (np.exp(-0.5 * x**2) / math.sqrt(2 * math.pi) for x in (low, high))
    below, above = ndtr(low), ndtr(-high)
    inside = 1 - below - above
    first = noise * (density_low - density_high + low * below + high * above)
    second = inside + low * density_low - high * density_high + low**2 * below + high**2 * above
    first += (density_high - density_low) / (24 * noise)
    second = noise**2 * second + (inside + high * density_high - low * density_low) / 12
    return centre + first, np.maximum(second - first**2, 0)


def has_fixed_pattern(sensor: Sensor) -> bool:
    """Whether the sensor's pixels differ from each other."""
    return any((sensor.prnu, sensor.dsnu_electrons, sensor.hot_fraction, sensor.dead_fraction))


def usable_well_electrons(sensor: Sensor) -> float:
    """Charge at which the response ends [electrons]: the full well, or the converter's range where that is smaller."""
    return min(sensor.full_well_electrons, (sensor.max_dn - sensor.offset_dn) * sensor.gain_electrons_per_dn)
