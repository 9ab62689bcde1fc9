"""EMVA 1288 photon transfer: a data set of a simulated sensor, and the analysis that finds its parameters again.

Clauses refer to EMVA Standard 1288, release 3.1 (30 December 2016). The data set is what the standard's reference
implementation reads: 16-bit images and a text file that lists, for every exposure time and photon number, the images.
Lines are `n bits width height`, `b exposure_ns photons` (bright), `d exposure_ns` (dark) and `i image`; series of two
images are temporal, longer ones spatial.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import constants

from detector.sensor.sensor import FixedPattern, Sensor, expose, fixed_pattern, moments
from radiometry.geometry import FloatArray

DESCRIPTOR = "descriptor.txt"
#: Last exposure over that at which the temporal variance peaks: far enough that the series saturates (clause 6.5), and
#: no further, because the reference implementation seeks the peak from above and stops at the noise of a plateau.
_OVEREXPOSURE = 50 / 48
#: The temporal variance below which quantisation hides the dark noise [DN²] (clause 6.6).
_LEAST_VARIANCE = 0.24


@dataclass(frozen=True)
class Series:
    """Images taken at one setting.

    Attributes:
        exposure_s: exposure time [s].
        photons: mean number of photons on a pixel during the exposure; 0 is dark.
        images: paths.
    """

    exposure_s: float
    photons: float
    images: tuple[Path, ...]


@dataclass(frozen=True)
class Characterisation:
    """What a photon-transfer data set says of its sensor.

    Attributes:
        gain_electrons_per_dn: 1/K, inverse overall system gain [e-/DN] (clause 6.6).
        quantum_efficiency: η = R/K (clause 6.6).
        dark_noise_dn: σ_y.dark, temporal dark noise with quantisation [DN] (clause 6.6).
        dark_noise_electrons: σ_d, without quantisation [e-] (clause 6.6).
        full_well_electrons: mean of the longest exposure over K [e-]; no figure of the standard.
        saturation_photons: μ_p.sat, where the temporal variance peaks (clause 6.6).
        saturation_electrons: μ_e.sat = η μ_p.sat [e-] (clause 6.6).
        threshold_photons: μ_p.min, absolute sensitivity threshold, SNR 1 (clauses 2.4 and 6.6).
        dynamic_range: μ_p.sat / μ_p.min (clause 2.4).
        snr_max: √μ_e.sat (clause 2.4).
        linearity_error: largest relative deviation from the line between 5 and 95 % of saturation (clause 6.7).
        dark_current_electrons_per_s: slope of the mean dark signal over the exposure time [e-/s] (clause 7.1).
        dsnu_electrons: DSNU_1288, spatial standard deviation of the dark signal [e-] (clauses 4.1 and 8.1).
        prnu: PRNU_1288, relative to the mean response near half saturation (clauses 4.1 and 8.1).
    """

    gain_electrons_per_dn: float
    quantum_efficiency: float
    dark_noise_dn: float
    dark_noise_electrons: float
    full_well_electrons: float
    saturation_photons: float
    saturation_electrons: float
    threshold_photons: float
    dynamic_range: float
    snr_max: float
    linearity_error: float
    dark_current_electrons_per_s: float
    dsnu_electrons: float
    prnu: float


def write_dataset(
    sensor: Sensor,
    directory: Path | str,
    *,
    seed: int,
    wavelength_nm: float = 850.0,
    pixel_area_m2: float = 8.6e-6 * 8.3e-6,
    shape: tuple[int, int] = (256, 256),
    steps: int = 60,
    stack: int = 16,
    longest_exposure_s: float = 0.02,
) -> Path:
    """Write a photon-transfer data set of a sensor and return the path of its descriptor.

    The light is constant and the exposure time varies in equal steps (clause 6.3, method 1) to 4 % beyond the peak of
    the variance; at each step two bright and two dark images, and at half saturation a stack of each for the spatial
    figures. The directory appears whole or not at all.

    Args:
        sensor: that is characterised.
        directory: must not exist, or be empty.
        seed: of the camera's fixed pattern and of every frame.
        wavelength_nm: at which the quantum efficiency is taken and the irradiance is stated [nm].
        pixel_area_m2: for the stated irradiance [m²].
        shape: rows and columns of each image.
        steps: exposure times, at least 50 by clause 6.5.
        stack: images in each spatial series, at least 3.
        longest_exposure_s: last exposure time [s].

    Raises:
        ValueError: when the sensor is blind at the wavelength, its dark charge alone saturates it, or an argument is
            out of range.
        FileExistsError: when the directory exists and is not empty.
    """
    target = Path(directory).absolute()
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise FileExistsError(f"{target}: exists and is not an empty directory")
    if steps < 10 or stack < 3 or min(shape) < 16 or longest_exposure_s <= 0:
        raise ValueError(
            f"steps {steps}, stack {stack}, shape {shape}, longest_exposure_s {longest_exposure_s}: "
            "expected at least 10, 3, (16, 16), and more than 0 s"
        )
    efficiency = float(sensor.qe_spectrum()(wavelength_nm))
    if efficiency <= 0:
        raise ValueError(f"wavelength_nm: {wavelength_nm} nm, but the sensor's quantum efficiency is zero there")
    # One exposure time falls on the peak itself, so that the saturation is read without an error of the grid.
    peak = round(steps / _OVEREXPOSURE)
    rate = peak_electrons(sensor) / (longest_exposure_s * peak / steps) - sensor.dark_rate_electrons_per_s
    if rate <= 0:
        raise ValueError(f"longest_exposure_s: {longest_exposure_s} s, the dark charge alone saturates the sensor")

    pattern_rng, frame_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    camera = _Bench(sensor, fixed_pattern(sensor, shape, pattern_rng), frame_rng)
    irradiance = rate / efficiency * constants.h * constants.c / (wavelength_nm * 1e-9) / pixel_area_m2
    lines = [
        f"# photon transfer at {wavelength_nm:g} nm, {irradiance:.6g} W/m2 on pixels of {pixel_area_m2:.6g} m2",
        "v 3.1",
        f"n {sensor.bits} {shape[1]} {shape[0]}",
    ]
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}-", dir=target.parent) as scratch:
        partial = Path(scratch) / target.name
        (partial / "images").mkdir(parents=True)
        settings = [(f"t{k:03d}", k, 2) for k in range(1, steps + 1)] + [("spatial", round(peak / 2), stack)]
        for name, step, count in settings:
            exposure_s = longest_exposure_s * step / steps
            lines.append(f"b {exposure_s * 1e9!r} {rate * exposure_s / efficiency!r}")
            lines += camera.record(partial, f"{name}-bright", rate, exposure_s, count)
            lines.append(f"d {exposure_s * 1e9!r}")
            lines += camera.record(partial, f"{name}-dark", 0.0, exposure_s, count)
        (partial / DESCRIPTOR).write_text("\n".join(lines) + "\n", encoding="ascii")
        if target.exists():
            target.rmdir()
        partial.rename(target)
    return target / DESCRIPTOR


def peak_electrons(sensor: Sensor) -> float:
    """Mean charge at which the temporal variance, averaged over the pixels' PRNU, peaks [e-].

    This is what the standard calls saturation. It lies a few per cent below the full well, or below the converter's
    end, for the brightest shots and pixels are clipped first.
    """
    room = min(sensor.full_well_electrons, (sensor.max_dn - sensor.offset_dn) * sensor.gain_electrons_per_dn)
    bright = sensor.model_copy(update={"dark_current_electrons_per_s": 0.0})
    levels = room * np.linspace(0.5, 1.1, 241)
    nodes, weights = np.polynomial.hermite_e.hermegauss(9 if sensor.prnu > 0 else 1)
    responses = np.maximum(1 + sensor.prnu * nodes, 0)
    variance = moments(bright, levels[:, None] * responses, 1.0)[1] @ weights
    return float(levels[np.argmax(variance)])


@dataclass(frozen=True)
class _Bench:
    """A sensor under uniform light, with its fixed pattern and its source of noise."""

    sensor: Sensor
    pattern: FixedPattern
    rng: np.random.Generator

    def record(self, directory: Path, name: str, rate: float, exposure_s: float, count: int) -> list[str]:
        """Expose and write a series of frames; return their descriptor lines."""
        uniform = np.full(self.pattern.prnu.shape, rate)
        lines = []
        for index in range(count):
            frame = expose(self.sensor, uniform, exposure_s, self.rng, self.pattern)
            path = f"images/{name}-{index:03d}.png"
            if not cv2.imwrite(str(directory / path), frame.dn, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
                raise OSError(f"{directory / path}: could not be written")
            lines.append(f"i {path}")
        return lines


def read_descriptor(path: Path | str) -> list[Series]:
    """Series listed in a descriptor file, in its order.

    Raises:
        ValueError: naming the line that is malformed.
    """
    path = Path(path)
    heads: list[tuple[float, float]] = []
    images: list[list[Path]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            match words:
                case ["v", _] | ["n", _, _, _]:
                    pass
                case ["b", exposure_ns, photons]:
                    heads.append((_finite(exposure_ns), _finite(photons)))
                    images.append([])
                case ["d", exposure_ns]:
                    heads.append((_finite(exposure_ns), 0.0))
                    images.append([])
                case ["i", name] if images:
                    images[-1].append(path.parent / name.replace("\\", "/"))
                case _:
                    raise ValueError("expected one of 'v', 'n', 'b', 'd', or 'i' after a 'b' or 'd', with its values")
        except ValueError as error:
            raise ValueError(f"{path.name}, line {number}: {line.strip()!r}: {error}") from None
    return [Series(t * 1e-9, photons, tuple(names)) for (t, photons), names in zip(heads, images, strict=True)]


def _finite(word: str) -> float:
    value = float(word.replace(",", "."))
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{word} is not a finite number of at least 0")
    return value


def _stack(series: Series) -> NDArray[np.int64]:
    """Images of a series as one array (count, H, W)."""
    frames: list[NDArray[np.int64]] = []
    for path in series.images:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise ValueError(f"{path}: not a readable image")
        if image.ndim != 2 or (frames and image.shape != frames[0].shape):
            raise ValueError(f"{path}: shape {image.shape}, expected monochrome images of one size")
        frames.append(image.astype(np.int64))
    return np.array(frames)


def characterise(directory: Path | str) -> Characterisation:
    """Photon-transfer analysis of a data set: a directory with `descriptor.txt`, or the path of a descriptor.

    Raises:
        ValueError: when the descriptor or an image cannot be read, or the set lacks what the standard asks for: bright
            and dark pairs at the same exposure times, and one bright and one dark stack.
    """
    path = Path(directory)
    series = read_descriptor(path / DESCRIPTOR if path.is_dir() else path)
    pairs = [s for s in series if len(s.images) == 2]
    exposure, photons, signal, variance, dark, dark_variance = _temporal(pairs)
    peak = int(np.argmax(variance))
    span = np.nonzero(signal <= 0.7 * signal[peak])[0]
    if len(span) < 2:
        raise ValueError(f"{path}: fewer than two exposures below 70 % of saturation")
    fit = slice(0, span[-1] + 1)
    responsivity = _slope(photons[fit], signal[fit])
    gain = _slope(signal[fit], (variance - dark_variance)[fit])
    efficiency = responsivity / gain

    # The dark variance at exposure zero: the dark current's shot noise is not read noise (clause 6.6).
    several = len(np.unique(exposure)) > 2
    floor = np.polyfit(exposure, dark_variance, 1)[1] if several else dark_variance[0]
    dark_slope, dark_level = np.polyfit(exposure, dark, 1) if several else (math.nan, dark[0])
    dark_noise_dn = math.sqrt(max(floor, _LEAST_VARIANCE))
    threshold = (dark_noise_dn / gain + 0.5) / efficiency
    prnu, dsnu_dn = _spatial([s for s in series if len(s.images) > 2])
    return Characterisation(
        gain_electrons_per_dn=1 / gain,
        quantum_efficiency=efficiency,
        dark_noise_dn=dark_noise_dn,
        dark_noise_electrons=math.sqrt(dark_noise_dn**2 - 1 / 12) / gain,
        full_well_electrons=(signal[-1] + dark[-1] - dark_level) / gain,
        saturation_photons=photons[peak],
        saturation_electrons=efficiency * photons[peak],
        threshold_photons=threshold,
        dynamic_range=photons[peak] / threshold,
        snr_max=math.sqrt(efficiency * photons[peak]),
        linearity_error=_linearity_error(photons, signal, peak),
        dark_current_electrons_per_s=dark_slope / gain,
        dsnu_electrons=dsnu_dn / gain,
        prnu=prnu,
    )


def _temporal(pairs: list[Series]) -> tuple[FloatArray, ...]:
    """Exposure [s], photons, mean signal less dark, temporal variance, mean dark, dark variance [DN, DN²], by photons.

    The variance is half the mean square difference of the two images, less the difference of their means (clause 6.6).
    """
    darks: dict[float, tuple[float, float]] = {}
    brights: list[tuple[float, float, float, float]] = []
    for series in pairs:
        first, second = _stack(series)
        mean = (first.mean() + second.mean()) / 2
        variance = float(np.mean((first - second) ** 2) - (first.mean() - second.mean()) ** 2) / 2
        if series.photons == 0:
            darks[series.exposure_s] = mean, variance
        else:
            brights.append((series.photons, series.exposure_s, mean, variance))
    if not brights or any(b[1] not in darks for b in brights):
        raise ValueError("descriptor: every bright pair of images needs a dark pair of the same exposure time")
    rows = [(t, photons, mean - darks[t][0], variance, *darks[t]) for photons, t, mean, variance in sorted(brights)]
    return tuple(np.array(rows).T)


def _slope(x: FloatArray, y: FloatArray) -> float:
    """Least-squares slope of a line through the origin."""
    return float(x @ y / (x @ x))


def _linearity_error(photons: FloatArray, signal: FloatArray, peak: int) -> float:
    """Largest relative deviation from the line of least relative squares, 5 to 95 % of saturation (clause 6.7)."""
    inside = (signal >= 0.05 * signal[peak]) & (signal <= 0.95 * signal[peak])
    slope, offset = np.polyfit(photons[inside], signal[inside], 1, w=1 / signal[inside])
    line = slope * photons[inside] + offset
    return float(np.max(np.abs(signal[inside] - line) / line))


def _spatial(stacks: list[Series]) -> tuple[float, float]:
    """PRNU (relative) and DSNU [DN] from one bright and one dark stack, temporal noise taken out (clause 8.1)."""

    def figures(series: Iterator[Series]) -> tuple[float, float]:
        found = list(series)
        if len(found) != 1:
            raise ValueError(f"descriptor: {len(found)} spatial series of a kind, expected one bright and one dark")
        images = _stack(found[0])
        temporal = images.var(axis=0, ddof=1).mean()
        return float(images.mean()), float(images.mean(axis=0).var(ddof=1) - temporal / len(images))

    bright, bright_variance = figures(s for s in stacks if s.photons > 0)
    dark, dark_variance = figures(s for s in stacks if s.photons == 0)
    # A sensor without fixed pattern leaves a variance that scatters about zero.
    return math.sqrt(max(bright_variance - dark_variance, 0)) / (bright - dark), math.sqrt(max(dark_variance, 0))


def datasheet(result: Characterisation) -> list[tuple[str, str, str, str]]:
    """Rows of a summary data sheet: quantity, symbol, value, unit."""
    decibel = 20 * math.log10(result.dynamic_range)
    snr_decibel = 20 * math.log10(result.snr_max)
    return [
        ("Quantum efficiency", "η", f"{100 * result.quantum_efficiency:.2f}", "%"),
        ("Inverse system gain", "1/K", f"{result.gain_electrons_per_dn:.4g}", "e⁻/DN"),
        ("Temporal dark noise", "σ_d", f"{result.dark_noise_electrons:.2f}", "e⁻"),
        ("Temporal dark noise", "σ_y.dark", f"{result.dark_noise_dn:.2f}", "DN"),
        ("Absolute sensitivity threshold", "μ_p.min", f"{result.threshold_photons:.1f}", "photons"),
        ("Full well (plateau)", "", f"{result.full_well_electrons:.0f}", "e⁻"),
        ("Saturation capacity", "μ_p.sat", f"{result.saturation_photons:.0f}", "photons"),
        ("Saturation capacity", "μ_e.sat", f"{result.saturation_electrons:.0f}", "e⁻"),
        ("Signal-to-noise ratio, maximum", "SNR_max", f"{snr_decibel:.1f}", "dB"),
        ("Dynamic range", "DR", f"{decibel:.1f}", "dB"),
        ("Dark signal non-uniformity", "DSNU_1288", f"{result.dsnu_electrons:.2f}", "e⁻"),
        ("Photo response non-uniformity", "PRNU_1288", f"{100 * result.prnu:.3f}", "%"),
        ("Linearity error", "LE", f"{100 * result.linearity_error:.3f}", "%"),
        ("Dark current", "μ_I.mean", f"{result.dark_current_electrons_per_s:.1f}", "e⁻/s"),
    ]
