"""Speed of the sensor model on one core: `python -m benchmarks.sensor`.

Prints megapixels a second of `detector.sensor.expose` for frames of the VBS grid at several charges, beside the same
chain written plainly in numpy (double precision, exact Poisson), and beside prysm and GalSim where they are installed.
"""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from detector.sensor import Sensor, expose, fixed_pattern, moments  # noqa: E402

SHAPE = (580, 752)
Chain = Callable[[NDArray[np.float64]], object]


def megapixels_per_second(chain: Chain, electrons: NDArray[np.float64], seconds: float = 0.6) -> float:
    """Best of the frames exposed in the given time, after one to warm up."""
    chain(electrons)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        chain(electrons)
        best = min(best, time.perf_counter() - start)
    return electrons.size / best / 1e6


def plain_numpy(sensor: Sensor, rng: np.random.Generator) -> Chain:
    """The chain as one would write it down: exact Poisson, double precision, whole frames."""

    def chain(electrons: NDArray[np.float64]) -> NDArray[np.uint16]:
        charge = np.minimum(rng.poisson(electrons), sensor.full_well_electrons)
        signal = charge + rng.normal(0, sensor.read_noise_electrons, electrons.shape)
        dn = np.rint(signal / sensor.gain_electrons_per_dn + sensor.offset_dn)
        return np.clip(dn, 0, sensor.max_dn).astype(np.uint16)

    return chain


def prysm_chain(sensor: Sensor) -> Chain:
    """prysm's detector model; it draws every count as a Gaussian and truncates instead of rounding."""
    from prysm.detector import Detector

    detector = Detector(
        dark_current=0,
        read_noise=sensor.read_noise_electrons,
        bias=sensor.offset_dn * sensor.gain_electrons_per_dn,
        fwc=sensor.full_well_electrons,
        conversion_gain=sensor.gain_electrons_per_dn,
        bits=sensor.bits,
        exposure_time=1,
    )
    return detector.expose


def galsim_chain(sensor: Sensor) -> Chain:
    """GalSim's CCD noise on an image, then its quantisation; no full well."""
    import galsim

    noise = galsim.CCDNoise(
        galsim.BaseDeviate(1), gain=sensor.gain_electrons_per_dn, read_noise=sensor.read_noise_electrons
    )

    def chain(electrons: NDArray[np.float64]) -> object:
        image = galsim.Image(electrons / sensor.gain_electrons_per_dn, dtype=np.float32)
        image.addNoise(noise)
        image += sensor.offset_dn
        image.quantize()
        return image

    return chain


def main() -> None:
    sensor = Sensor(prnu=0.01, dsnu_electrons=5.0)
    rng = np.random.default_rng(1)
    pattern = fixed_pattern(sensor, SHAPE, rng)
    chains: dict[str, Chain] = {
        "expose": lambda electrons: expose(sensor, electrons, 1.0, rng),
        "expose, fixed pattern": lambda electrons: expose(sensor, electrons, 1.0, rng, pattern),
        "plain numpy": plain_numpy(sensor, rng),
    }
    for name, factory in (("prysm", prysm_chain), ("galsim", galsim_chain)):
        if importlib.util.find_spec(name):
            chains[name] = factory(sensor)
    scene = np.full(SHAPE, 3.0)
    scene[100:400, 200:500] = 6500.0
    frames = {f"{level:g} e-": np.full(SHAPE, level) for level in (0.0, 0.5, 3.0, 9.0, 100.0, 10_000.0, 1e6)}
    frames["marker on dark"] = scene
    print("Mpx/s".ljust(24) + "".join(name.rjust(16) for name in frames))
    for name, chain in chains.items():
        print(name.ljust(24) + "".join(f"{megapixels_per_second(chain, f):16.1f}" for f in frames.values()))
    print("moments".ljust(24) + "".join(f"{megapixels_per_second(_moments(sensor), f):16.1f}" for f in frames.values()))


def _moments(sensor: Sensor) -> Chain:
    return lambda electrons: moments(sensor, electrons, 1.0)


if __name__ == "__main__":
    main()
