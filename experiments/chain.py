"""The chain, in the one place that runs it: scenario -> transport -> electron rate -> DN -> features -> pose.

Every study calls these functions; each stage can also be run by itself from files (`mantis render`, `expose`, `detect`).
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.features import Features, detect_features
from detector.noise import NoiseModel
from detector.pair import difference, pair_noise
from detector.pose import Pose, solve_pose
from detector.sensor import Frame, expose
from experiments.geometry import bit_pixels, bit_scale_px, view
from experiments.illumination import LIGHTS_ON, lights_on, responsivity, strengths, sun_stray_rate
from experiments.link_budget import LinkBudget, exposure_s, link_budget, link_budget_beside, usable_well
from experiments.rectify import ideal_camera, in_the_image, rectified, rectified_noise
from experiments.scenario import Scenario
from materials import library
from radiometry import stray
from radiometry.geometry import FloatArray, rotation_angle
from radiometry.optics import node_weights
from scenes import density
from scenes.cache import TransportCache
from scenes.regions import frame_box, marker_box, marker_pixels
from scenes.transport import AFTER_TRANSPORT, Quality, TransportBasis, View, render_cases

#: The chain's functions, those of other modules included: studies take all from here.
__all__ = [
    "LIGHTS_ON",
    "LinkBudget",
    "Sighting",
    "bit_pixels",
    "bit_scale_px",
    "check_geometry",
    "electron_rate",
    "exposure_s",
    "frame_generator",
    "geometry_digest",
    "lights_on",
    "link_budget",
    "link_budget_beside",
    "look",
    "noise_model",
    "pose_errors",
    "provenance",
    "quality",
    "renderer_variance_fraction",
    "responsivity",
    "strengths",
    "sun_stray_rate",
    "take_frame",
    "transport",
    "transports",
    "usable_well",
    "view",
]


def quality(scenario: Scenario) -> Quality:
    """How densely the scenario's transport is sampled: for every exposure, up to the full well, of most sensors.

    All exposures and sensors share a transport, so it is made for the most charge that a pixel can hold; wells that differ by
    less than a factor of two, and all small ones, share one, too.
    """
    least = Quality.electrons
    well = least * 2.0 ** np.ceil(np.log2(max(usable_well(scenario.sensor) / least, 1.0)))
    return Quality(scenario.render.frame_samples, scenario.render.marker_rays, scenario.render.seed, float(well))


def transport(scenario: Scenario) -> TransportBasis:
    """Render the transport basis of the scenario's geometry, with provenance in its attributes."""
    return next(transports([scenario]))


def transports(scenarios: Iterable[Scenario], cache: TransportCache | None = None) -> Iterator[TransportBasis]:
    """The transport bases of many scenarios' geometries, in order, with provenance in their attributes.

    Those in a row that differ only in pose, lights and camera are rendered together, whatever their number: scenarios are taken
    as they are needed. Each basis is the same as if it had been rendered alone.

    Args:
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


def provenance(scenario: Scenario) -> dict[str, str | float]:
    """What is needed to make a result again: scenario, its hash, seed and versions."""
    camera = scenario.camera
    return {
        "scenario": scenario.model_dump_json(),
        "scenario_hash": scenario.digest(),
        "seed": float(scenario.seed),
        "camera": f"{camera.width_px}x{camera.height_px} px, f {camera.focal_length_m:g} m, F/{camera.f_number:g}",
        "software": f"mantis-radiometry {version('mantis-radiometry')}",
        "versions": ", ".join(
            f"{name} {version(name)}" for name in ("mitsuba", "drjit", "numpy", "opencv-python-headless")
        )
        + f", python {platform.python_version()}",
    }


def electron_rate(scenario: Scenario, basis: TransportBasis, light: str) -> FloatArray:
    """Photo-electrons per second of every pixel, (height, width), in an illumination ('eclipse' or 'sun').

    The lens's glare is spread, and stray light of the Sun added, last.

    Raises:
        ValueError: when the basis is not of the camera's size, or lacks a light that the scenario has.
    """
    camera, strength = scenario.camera, strengths(scenario)
    shape = (camera.height_px, camera.width_px)
    sine2 = 1 - np.sqrt(camera.natural_falloff())
    table = _incidence_table(scenario, float(sine2.max()))
    rate = np.zeros(shape)
    for source in lights_on(scenario, light):
        if source not in basis.layers:
            raise ValueError(f"transport basis has no {source} layers; render it again with the scenario's [{source}]")
        images = basis.layers[source]
        if images.shape[1:] != shape:
            raise ValueError(
                f"transport basis is {images.shape[2]} × {images.shape[1]} px, the camera {shape[1]} × {shape[0]} px"
            )
        weights = np.array(
            [node_weights(strength[source] * responsivity(scenario, np.arcsin(s**0.5)), basis.nodes_nm) for s in table]
        )
        if len(table) == 1:
            rate += np.tensordot(weights[0], images, axes=1)
        else:
            for image, weight in zip(images, weights.T, strict=True):
                rate += np.interp(sine2, table, weight) * image
    # The weights of the outer nodes can be negative, so a black pixel may come out at minus a rounding error.
    rate = np.maximum(rate, 0.0) * camera.relative_illumination()
    if camera.veiling_glare > 0:
        rate = stray.veiled(rate, camera.veiling_glare)
    return rate + sun_stray_rate(scenario) if light == "sun" and camera.point_source_transmittance else rate


def renderer_variance_fraction(
    scenario: Scenario, basis: TransportBasis, light: str, seconds: float, rate: FloatArray | None = None
) -> float:
    """Largest share of the renderer's variance in shot noise's, over the ArUco's and the elements' pixels, in an exposure.

    A pixel that would overflow counts in the exposure that just fills it. The renderer's variance is that of two independent
    halves of the rays, averaged over 5 × 5 pixels (`scenes.density.fractions`). NaN where the basis does not tell it, or no such
    pixel is in the frame.

    Args:
        rate: `electron_rate` of the same, where it is known.
    """
    if any(source not in basis.noise for source in lights_on(scenario, light)):
        return float("nan")
    scene_view = view(scenario)
    frame = frame_box(scene_view)
    box = marker_box(scene_view).within(frame)
    seen, part = marker_pixels(scene_view, box), box.slices(frame)
    pixels = seen.aruco | seen.opening
    if not pixels.any():
        return float("nan")
    strength, response = strengths(scenario), responsivity(scenario)
    falloff = scenario.camera.relative_illumination()[part] * seconds
    draw = np.zeros(pixels.shape)
    for source in lights_on(scenario, light):
        # The noise is a mean over the wavelengths; reflectances vary little over a passband.
        draw += basis.noise[source][part] * float(np.sum(node_weights(strength[source] * response, basis.nodes_nm)))
    electrons = (electron_rate(scenario, basis, light) if rate is None else rate)[part] * seconds
    fill = np.minimum(1.0, usable_well(scenario.sensor) / np.maximum(electrons, 1e-12))
    return float(density.fractions(draw * falloff * fill, electrons * fill, pixels)[pixels].max())


def _incidence_table(scenario: Scenario, largest: float) -> FloatArray:
    """Values of sin²θ up to the largest of the field, between which the filter's edges shift by 0.05 nm at most.

    Between them the weights of the nodes are taken as linear: a line of 2 nm across a steep edge allows no smoother curve.
    """
    if scenario.filter.effective_index == 0:
        return np.zeros(1)
    shift_nm = scenario.filter.high_nm * (1 - np.sqrt(1 - largest / scenario.filter.effective_index**2))
    return np.linspace(0.0, largest, 2 + int(shift_nm / 0.05))


def frame_generator(scenario: Scenario, light: str, seconds: float, trial: int = 0) -> np.random.Generator:
    """Generator of one frame's noise, independent between ranges, illuminations, exposures and trials."""
    key = (scenario.seed, round(scenario.range_m * 1e6), list(LIGHTS_ON).index(light), round(seconds * 1e12), trial)
    return np.random.default_rng(key)


def take_frame(scenario: Scenario, rate: FloatArray, light: str, seconds: float, trial: int = 0) -> Frame:
    """One exposure of the scenario's sensor."""
    return expose(scenario.sensor, rate, seconds, frame_generator(scenario, light, seconds, trial))


def noise_model(scenario: Scenario, image: NDArray[Any]) -> NoiseModel | None:
    """Noise of an image where it can come from the scenario's sensor, else None: the detector then estimates it."""
    sensor = scenario.sensor
    container = np.uint8 if sensor.bits <= 8 else np.uint16
    if image.dtype != container or image.max(initial=0) > sensor.max_dn:
        return None
    gain = 1 / sensor.gain_electrons_per_dn
    return NoiseModel(gain, sensor.total_noise_electrons * gain, sensor.offset_dn, sensor.saturation_dn)


@dataclass(frozen=True)
class Sighting:
    """What the detector and the pose solver make of one image."""

    features: Features
    pose: Pose | None

    def _repr_html_(self) -> str:
        from experiments.notebook import sighting_html

        return sighting_html(self)


def look(scenario: Scenario, image: NDArray[Any], off: NDArray[Any] | None = None) -> Sighting:
    """Find the scenario's marker in an image and solve its pose; a distorted lens's image is rectified first.

    Args:
        off: a frame without the LEDs, taken as the image was: it is subtracted, and the noise of both is heeded.

    Raises:
        ValueError: when the image is not two-dimensional, of another size than the camera's, or holds NaN or infinity, or `off`
            is of another size or kind of number than the image.
    """
    camera = scenario.camera
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"image is {'×'.join(map(str, image.shape[::-1]))} px, the camera {camera.width_px}×{camera.height_px} px "
            "(camera.width_px, camera.height_px)"
        )
    noise, camera = noise_model(scenario, image), view(scenario).camera
    if off is not None:
        known = noise if noise_model(scenario, off) is not None else None
        image, noise = difference(image, off, known or pair_noise(image, off))
    ideal = ideal_camera(camera) if camera.distorted else camera
    seen = rectified(image, camera, ideal, noise) if camera.distorted else image
    noise = rectified_noise(noise, camera, ideal) if camera.distorted else noise
    features = detect_features(seen, scenario.marker, ideal, noise, scenario.leds.ring_radius_m)
    pose = solve_pose(features, scenario.marker, ideal) if features.detected else None
    return Sighting(in_the_image(features, camera, ideal) if camera.distorted else features, pose)


def pose_errors(scenario: Scenario, pose: Pose | None) -> tuple[float, float]:
    """Attitude error [rad] and range error over range; NaN without a pose."""
    if pose is None:
        return np.nan, np.nan
    truth = view(scenario)
    distance = np.linalg.norm(truth.translation_m)
    return (
        rotation_angle(truth.rotation, pose.rotation),
        float(abs(np.linalg.norm(pose.translation_m) - distance) / distance),
    )
