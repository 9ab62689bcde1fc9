"""Speed of peers' sensor chains; run by a Python that has them. Reads a request from stdin, answers on stdout, as JSON.

Request: `height`, `width`, `levels` [e-] by name (a number, or [dark, bright] for a bright square on dark), `sensor`
(full well, read noise, gain, offset, largest number, bits), `seconds` to spend on each. Answer: megapixels a second
by peer and level, and why not.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def pyxel_chain(sensor: dict[str, float], shape: tuple[int, int]) -> Callable[[Any], object]:
    """Pyxel: shot noise, conversion, full well, measurement, node noise and converter, in its own functions; no offset."""
    from pyxel.detectors import CMOS, Characteristics, ChargeToVoltSettings, CMOSGeometry, Environment
    from pyxel.models import (
        charge_collection,
        charge_generation,
        charge_measurement,
        photon_collection,
        readout_electronics,
    )

    volts_per_electron = 1e-5
    span = sensor["largest_dn"] * sensor["gain"] * volts_per_electron
    characteristics = Characteristics(
        quantum_efficiency=1.0,
        charge_to_volt=ChargeToVoltSettings(value=volts_per_electron),
        pre_amplification=1.0,
        full_well_capacity=int(sensor["full_well"]),
        adc_bit_resolution=int(sensor["bits"]),
        adc_voltage_range=(0.0, span),
    )
    detector = CMOS(CMOSGeometry(row=shape[0], col=shape[1]), Environment(temperature=293.0), characteristics)
    seeds = iter(range(1, 10**9))

    def chain(electrons: Any) -> object:
        detector.empty()
        detector.photon.array = electrons.copy()
        photon_collection.shot_noise(detector, seed=next(seeds))
        charge_generation.simple_conversion(detector, seed=next(seeds), binomial_sampling=False)
        charge_collection.simple_collection(detector)
        charge_collection.simple_full_well(detector)
        charge_measurement.simple_measurement(detector)
        charge_measurement.output_node_noise(detector, sensor["read_noise"] * volts_per_electron, seed=next(seeds))
        readout_electronics.simple_amplifier(detector)
        readout_electronics.simple_adc(detector)
        return detector.image.array

    return chain


def prysm_chain(sensor: dict[str, float], shape: tuple[int, int]) -> Callable[[Any], object]:
    """prysm's detector model; it draws every count as a Gaussian and truncates instead of rounding."""
    from prysm.detector import Detector

    detector = Detector(
        dark_current=0,
        read_noise=sensor["read_noise"],
        bias=sensor["offset_dn"] * sensor["gain"],
        fwc=sensor["full_well"],
        conversion_gain=sensor["gain"],
        bits=int(sensor["bits"]),
        exposure_time=1,
    )
    return detector.expose


def galsim_chain(sensor: dict[str, float], shape: tuple[int, int]) -> Callable[[Any], object]:
    """GalSim's CCD noise on an image, then its quantisation; no full well."""
    import galsim

    noise = galsim.CCDNoise(galsim.BaseDeviate(1), gain=sensor["gain"], read_noise=sensor["read_noise"])

    def chain(electrons: Any) -> object:
        image = galsim.Image(electrons / sensor["gain"], dtype=np.float32)
        image.addNoise(noise)
        image += sensor["offset_dn"]
        image.quantize()
        return image

    return chain


def megapixels_per_second(chain: Callable[[Any], object], electrons: Any, seconds: float) -> float:
    """Best of the frames exposed in a time, after one to warm up."""
    chain(electrons)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        chain(electrons)
        best = min(best, time.perf_counter() - start)
    return electrons.size / best / 1e6


def scene(level: Any, shape: tuple[int, int]) -> Any:
    """Mean charge of a frame: one level, or a bright square on a dark ground."""
    if not isinstance(level, list):
        return np.full(shape, float(level))
    image = np.full(shape, float(level[0]))
    image[shape[0] // 4 : 3 * shape[0] // 4, shape[1] // 4 : 3 * shape[1] // 4] = level[1]
    return image


def main() -> None:
    request = json.loads(sys.stdin.read())
    shape = request["height"], request["width"]
    answer: dict[str, Any] = {}
    for name, factory in (("Pyxel", pyxel_chain), ("GalSim", galsim_chain), ("prysm", prysm_chain)):
        try:
            chain = factory(request["sensor"], shape)
            answer[name] = {
                level: megapixels_per_second(chain, scene(value, shape), request["seconds"])
                for level, value in request["levels"].items()
            }
        except Exception as error:  # said on the page; the others are still worth having
            answer[name] = f"{type(error).__name__}: {error}"
    print("\n" + json.dumps(answer))


if __name__ == "__main__":
    main()
