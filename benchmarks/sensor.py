"""Speed of the sensor chain on one core, beside other packages'."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.rows import Row
from benchmarks.sensor_job import megapixels_per_second, scene

TITLE = "The sensor chain, megapixels a second on one core"
TEXT = """
Frames of 1024 × 1024 px from mean charge to digital numbers: Poisson draw, full well, read noise, gain and offset,
rounding and converter. `expose` draws the law itself (`detector/sensor/sensor.py`); *with fixed pattern* adds the camera's
PRNU and DSNU maps. *Plain numpy* is the same chain written down in double precision with numpy's generator. Pyxel is
called through its models' functions on a CMOS detector, without its pipeline's overhead; GalSim has no full well;
prysm draws Gaussian counts and truncates. The best frame of each level counts.
"""
COLUMNS = "level"

_LEVELS: dict[str, Any] = {
    "0 e⁻": 0.0,
    "0.5 e⁻": 0.5,
    "3 e⁻": 3.0,
    "9 e⁻": 9.0,
    "100 e⁻": 100.0,
    "10 000 e⁻": 1e4,
    "saturated": 1e6,
    "marker on dark": [3.0, 6500.0],
}
_SHAPE = (1024, 1024)


def run(quick: bool) -> list[Row]:
    """Megapixels a second by chain and level."""
    from detector.sensor.sensor import Sensor, expose, fixed_pattern

    seconds = 0.15 if quick else 0.6
    sensor = Sensor(prnu=0.01, dsnu_electrons=5.0)
    rng = np.random.default_rng(1)
    pattern = fixed_pattern(sensor, _SHAPE, rng)
    chains: dict[str, Callable[[Any], object]] = {
        "expose": lambda electrons: expose(sensor, electrons, 1.0, rng),
        "with fixed pattern": lambda electrons: expose(sensor, electrons, 1.0, rng, pattern),
        "plain numpy": _plain_numpy(sensor, rng),
    }
    found = {
        name: {level: megapixels_per_second(chain, scene(value, _SHAPE), seconds) for level, value in _LEVELS.items()}
        for name, chain in chains.items()
    }
    request = {
        "height": _SHAPE[0],
        "width": _SHAPE[1],
        "levels": _LEVELS,
        "seconds": seconds,
        "sensor": {
            "full_well": sensor.full_well_electrons,
            "read_noise": sensor.read_noise_electrons,
            "gain": sensor.gain_electrons_per_dn,
            "offset_dn": sensor.offset_dn,
            "largest_dn": sensor.max_dn,
            "bits": sensor.bits,
        },
    }
    rows = []
    for name, speeds in peers.run_script("sensor_job.py", request).items():
        version = peers.version({"Pyxel": "pyxel-sim", "GalSim": "galsim"}.get(name, name))
        if isinstance(speeds, str):
            rows.append(Row(name, np.nan, note="not installed (extra `bench`)" if version is None else speeds))
        else:
            found[f"{name} {version}"] = speeds
    slowest = min(found["expose"], key=lambda level: found["expose"][level])
    rows.insert(0, Row("slowest level of `expose`", found["expose"][slowest], "Mpx/s", "≥ 20", slowest))
    return rows + [
        Row(level, speed, "Mpx/s", series=name) for name, speeds in found.items() for level, speed in speeds.items()
    ]


def _plain_numpy(sensor: Any, rng: np.random.Generator) -> Callable[[Any], object]:
    """The chain as one would write it down: exact Poisson, double precision, whole frames."""

    def chain(electrons: Any) -> object:
        charge = np.minimum(rng.poisson(electrons), sensor.full_well_electrons)
        signal = charge + rng.normal(0, sensor.read_noise_electrons, electrons.shape)
        dn = np.rint(signal / sensor.gain_electrons_per_dn + sensor.offset_dn)
        return np.clip(dn, 0, sensor.max_dn).astype(np.uint16)

    return chain


for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
