"""The transport basis of a scenario: how densely it is sampled, rendering, and whether a basis belongs to a scenario."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from detector.sensor.sensor import usable_well_electrons
from experiments.chain.provenance import provenance
from experiments.chain.view import view
from experiments.scenario import Scenario
from materials import library
from scenes.files.cache import TransportCache
from scenes.render.transport import AFTER_TRANSPORT, Quality, TransportBasis, render_cases
from scenes.view import View


def quality(scenario: Scenario) -> Quality:
    """How densely the scenario's transport is sampled: for every exposure, up to the full well, of most sensors.

    All exposures and sensors share a transport, so it is made for the most charge that a pixel can hold; wells that differ by
    less than a factor of two, and all small ones, share one, too.
    """
    least = Quality.electrons
    well = least * 2.0 ** np.ceil(np.log2(max(usable_well_electrons(scenario.sensor) / least, 1.0)))
    return Quality(scenario.render.frame_samples, scenario.render.marker_rays, scenario.render.seed, float(well))


def geometry_digest(scenario: Scenario) -> str:
    """Hash of what changes transport, 16 hexadecimal digits; source powers and spectra are left out."""
    leds = scenario.leds.model_dump(include={"count", "ring_radius_m", "half_angle_deg"})
    seen = view(scenario)
    camera = seen.camera.model_dump(exclude=set(AFTER_TRANSPORT))
    earth = scenario.earth and scenario.earth.model_dump(exclude={"albedo"})
    parts = [scenario.range_m, seen.nodes_nm, leds, camera, earth]
    parts += [part.model_dump(mode="json") for part in (scenario.marker, scenario.target, scenario.sun)]
    parts += [library.fingerprint(name) for name in scenario.target.materials]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def check_geometry(scenario: Scenario, basis: TransportBasis, name: object) -> None:
    """Refuse a transport basis that this project rendered from another geometry, or whose wavelengths miss the passband.

    Raises:
        ValueError: naming both ranges, or both bands. Of a basis without our attributes, from another renderer, only the
            wavelengths can be checked: four at least, and none further from the end of the passband than from the next.
    """
    low, high = scenario.filter.spectrum().support_nm
    nodes, reach = basis.nodes_nm, max(np.diff(basis.nodes_nm), default=0)
    if len(nodes) < 4 or nodes[0] - reach > low or nodes[-1] + reach < high:
        raise ValueError(
            f"{name}: layers at {', '.join(map(str, nodes))} nm; expected four or more that span the passband {low:g}-{high:g} nm"
        )
    known = basis.attributes.get("geometry_hash")
    if known is not None and known != geometry_digest(scenario):
        raise ValueError(
            f"{name}: rendered from another geometry (range {basis.attributes.get('range_m', 0):g} m, the scenario has "
            f"{scenario.range_m:g} m; or camera, marker, target, LED ring, Sun, Earth or filter band differ)"
        )


def transport(scenario: Scenario) -> TransportBasis:
    """Render the transport basis of the scenario's geometry, with provenance in its attributes."""
    return next(transports([scenario]))


def transports(scenarios: Iterable[Scenario], cache: TransportCache | None = None) -> Iterator[TransportBasis]:
    """The transport bases of many scenarios' geometries, in order, with provenance in their attributes.

    Those in a row that differ only in pose, lights and camera are rendered together, whatever their number: scenarios are taken
    as they are needed. Each basis is the same as if it had been rendered alone.

    Args:
        scenarios: of each, the geometry is rendered.
        cache: where bases are looked for first and kept; default none.
    """
    taken: deque[Scenario] = deque()

    def cases() -> Iterator[tuple[View, Quality]]:
        for scenario in scenarios:
            taken.append(scenario)
            yield view(scenario), quality(scenario)

    for basis in cache.bases(cases()) if cache is not None else render_cases(cases()):
        scenario = taken.popleft()
        own = provenance(scenario) | {"range_m": scenario.range_m, "geometry_hash": geometry_digest(scenario)}
        yield replace(basis, attributes=basis.attributes | own)
