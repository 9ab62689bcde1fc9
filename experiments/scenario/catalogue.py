"""What can be chosen by name in a scenario: sensors, lenses, LEDs, filters, markers and tapes, with main figures and sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.scenario.presets import presets, table
from materials import library
from materials.library import END_OF_LIFE

#: What each section's table is called and shows: heading and key.
SHOWN: dict[str, tuple[str, dict[str, str]]] = {
    "sensor": (
        "Sensors",
        {
            "pixels": "grid",
            "pitch (µm)": "pitch_um",
            "QE at 850 nm": "quantum_efficiency",
            "full well (e-)": "full_well_electrons",
            "read noise (e-)": "read_noise_electrons",
            "bits": "bits",
        },
    ),
    "camera": (
        "Lenses",
        {
            "focal length (m)": "focal_length_m",
            "F-number": "f_number",
            "transmission": "lens_transmission",
            "point spread (px)": "psf_sigma_px",
        },
    ),
    "leds": (
        "LEDs, one emitter",
        {
            "on axis (W/sr)": "intensity_w_sr",
            "half angle (deg)": "half_angle_deg",
            "centre (nm)": "centroid_nm",
            "width (nm)": "fwhm_nm",
            "electrical (W)": "electrical_power_w",
        },
    ),
    "filter": (
        "Filters",
        {
            "from (nm)": "low_nm",
            "to (nm)": "high_nm",
            "transmission": "transmission",
            "index of angle shift": "effective_index",
        },
    ),
    "marker": (
        "Markers",
        {"dictionary": "dictionary", "ring (of the ArUco's side)": "ring_fraction", "gap": "gap_fraction"},
    ),
    "target": (
        "Tapes",
        {"f at 0.2 deg (1/sr)": "at_0.2_deg", "at 0.5 deg": "at_0.5_deg", "at 1 deg": "at_1_deg"},
    ),
}

#: Observation angles at which a tape's return is told [deg]; the entrance angle is 5 deg, the wavelength 850 nm.
_OBSERVATION_DEG = (0.2, 0.5, 1.0)


@dataclass(frozen=True)
class Entry:
    """One thing to choose: the key that takes it, its name, its values by key, and where they come from."""

    key: str
    name: str
    values: dict[str, Any]
    source: str

    @property
    def setting(self) -> str:
        """What to write after `--set`."""
        return f"{self.key}={self.name}"


def catalogue(section: str) -> list[Entry]:
    """Every preset of a section (or of its table's name), or of `target` every tape.

    Raises:
        ValueError: when the section takes nothing by name, saying which do.
    """
    section = section_of(section)
    if section == "target":
        return _tapes()
    if section == "sensor":
        return _sensors()
    data = table(section)
    return [
        Entry(f"{section}.preset", name, values, str(data[name]["source"])) for name, values in presets(section).items()
    ]


def section_of(name: str) -> str:
    """The section that takes presets of a name: its own, or what its table is called, say lenses.

    Raises:
        ValueError: when there is none, saying which there are.
    """
    called = {heading.split(",")[0].lower(): section for section, (heading, _) in SHOWN.items()}
    section = called.get(name.lower(), name)
    if section not in SHOWN:
        raise ValueError(f"presets: {name!r}, expected one of {', '.join(called)}")
    return section


def row(section: str, entry: Entry) -> list[str]:
    """Name and shown figures of an entry as text; '–' for what it leaves at the default."""
    return [entry.name, *(_text(entry.values.get(key)) for key in SHOWN[section][1].values())]


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, (tuple, list)):  # a curve over wavelength
        return f"{np.interp(850.0, *np.array(value, float).T):.3g}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _sensors() -> list[Entry]:
    from detector.sensor.sensor import presets as sensors

    found = []
    for name, preset in sensors().items():
        pitches = [f"{1e6 * preset.grid[f'pixel_pitch_{axis}_m']:.3g}" for axis in ("x", "y")]
        grid = f"{preset.grid['width_px']} × {preset.grid['height_px']}"
        values = {**preset.sensor.model_dump(), "grid": grid, "pitch_um": " × ".join(dict.fromkeys(pitches))}
        sources = "; ".join(f"{key}: {text}" for key, text in preset.provenance.items())
        found.append(Entry("sensor.preset", name, values, f"{preset.description}. {sources}"))
    return found


def _tapes() -> list[Entry]:
    from materials.goniometer import goniometer_scan

    found = []
    for name in library.available():
        if not name.startswith("tape_") or name.endswith(END_OF_LIFE):
            continue
        material = library.load(name)
        returned = goniometer_scan(material, 5.0, np.array(_OBSERVATION_DEG))
        values = {f"at_{angle:g}_deg": round(float(f), 1) for angle, f in zip(_OBSERVATION_DEG, returned, strict=True)}
        found.append(Entry("target.tape_material", name, values, f"{material.title}. {material.source}"))
    return found
