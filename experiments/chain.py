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
from detector.pose import Pose, solve_pose
from detector.sensor import Frame, Sensor, expose
from experiments.frame_light import mean_frame_rate
from experiments.rectify import ideal_camera, in_the_image, rectified
from experiments.scenario import Scenario
from experiments.visible_marker import hidden_face, visible_tape
from materials import library
from radiometry import link, stray
from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray, rotation_angle
from radiometry.optics import camera_at, electron_responsivity, node_weights, wavelength_nodes
from radiometry.spectrum import Spectrum
from scenes import density
from scenes.cache import TransportCache
from scenes.regions import frame_box, marker_box, marker_pixels
from scenes.transport import AFTER_TRANSPORT, Quality, TransportBasis, View, render_cases

#: Which lights shine in each illumination.
LIGHTS_ON = {"eclipse": ("led",), "sun": ("led", "sun")}


def lights_on(scenario: Scenario, light: str) -> tuple[str, ...]:
    """Lights that shine in an illumination; the sunlit Earth with the Sun, where the scenario has one."""
    return (*LIGHTS_ON[light], "earth") if light == "sun" and scenario.earth is not None else LIGHTS_ON[light]


def view(scenario: Scenario) -> View:
    """The part of a scenario that changes transport; its camera's point spread is the whole blur at the range."""
    nodes = wavelength_nodes(scenario.filter.spectrum(), scenario.render.wavelength_nodes)
    return View(
        camera_at(scenario.camera, scenario.range_m, scenario.filter.centre_nm),
        scenario.marker, scenario.target, scenario.leds, scenario.sun, scenario.range_m, nodes, scenario.earth,
    )  # fmt: skip


def quality(scenario: Scenario) -> Quality:
    """How densely the scenario's transport is sampled: for every exposure, up to the full well, of most sensors.

    All exposures and sensors share a transport, so it is made for the most charge that a pixel can hold; wells that differ by
    less than a factor of two, and all small ones, share one, too.
    """
    least = Quality.electrons
    well = least * 2.0 ** np.ceil(np.log2(max(usable_well(scenario.sensor) / least, 1.0)))
    return Quality(scenario.render.frame_samples, scenario.render.marker_rays, scenario.seed, float(well))


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


def strengths(scenario: Scenario) -> dict[str, Spectrum]:
    """Spectral strength of each light: the ring's intensity [W sr⁻¹ nm⁻¹], the Sun's irradiance [W m⁻² nm⁻¹], the Earth's
    radiance [W m⁻² sr⁻¹ nm⁻¹] where there is one."""
    earth = {} if scenario.earth is None else {"earth": scenario.earth.radiance(scenario.sun)}
    return {"led": scenario.leds.spectral_intensity(), "sun": scenario.sun.irradiance(), **earth}


def responsivity(scenario: Scenario, incidence_rad: float = 0.0) -> Spectrum:
    """Electron rate per spectral radiance of the scenario's camera, filter and sensor, at a field angle before the lens."""
    transmission = scenario.filter.spectrum(incidence_rad)
    return electron_responsivity(scenario.camera, transmission, scenario.sensor.qe_spectrum())


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


def sun_stray_rate(scenario: Scenario) -> float:
    """Electrons per second that a Sun outside the field adds to every pixel; its angle from the axis is π − phase."""
    angle = np.pi - np.radians(scenario.sun.phase_deg)
    quantum_efficiency = scenario.sensor.qe_spectrum()
    return stray.stray_rate(
        scenario.camera, angle, scenario.sun.irradiance(), scenario.filter.spectrum(), quantum_efficiency
    )


def _incidence_table(scenario: Scenario, largest: float) -> FloatArray:
    """Values of sin²θ up to the largest of the field, between which the filter's edges shift by 0.05 nm at most.

    Between them the weights of the nodes are taken as linear: a line of 2 nm across a steep edge allows no smoother curve.
    """
    if scenario.filter.effective_index == 0:
        return np.zeros(1)
    shift_nm = scenario.filter.high_nm * (1 - np.sqrt(1 - largest / scenario.filter.effective_index**2))
    return np.linspace(0.0, largest, 2 + int(shift_nm / 0.05))


@dataclass(frozen=True)
class LinkBudget:
    """Closed-form budget of one range and illumination.

    Attributes:
        signal_rate, background_rate: electrons per second of a bright bit's and of a neighbouring dark cell's pixels.
        tape_rate: of tape that fills its pixels, without point spread and neighbours.
        px_per_bit: pixels along the shorter side of a bit.
        smear_px_per_s: motion of the target across the image.
        fill: share of a bright bit's light that comes from reflective cells.
    """

    sensor: Sensor
    signal_rate: float
    background_rate: float
    tape_rate: float
    px_per_bit: float
    smear_px_per_s: float
    fill: float

    def at(self, exposure_s: float) -> dict[str, float]:
        """Signal, background and dark charge [electrons], SNR, CNR, full-well fraction and smear [px] of one exposure."""
        signal, background = self.signal_rate * exposure_s, self.background_rate * exposure_s
        dark, noise = self.sensor.dark_electrons(exposure_s), self.sensor.total_noise_electrons
        return {
            "signal": signal,
            "background": background,
            "dark": dark,
            "snr": float(link.snr(signal, dark, noise)),
            "cnr": float(link.cnr(signal, background, dark, noise)),
            "full_well_fraction": (signal + dark) / usable_well(self.sensor),
            "smear_px": self.smear_px_per_s * exposure_s,
        }

    def _repr_html_(self) -> str:
        from experiments.notebook import budget_html

        return budget_html(self)


def usable_well(sensor: Sensor) -> float:
    """Charge at which the response ends [electrons]: the full well, or the converter's range where that is smaller."""
    return min(sensor.full_well_electrons, (sensor.max_dn - sensor.offset_dn) * sensor.gain_electrons_per_dn)


def bit_scale_px(scene_view: View) -> tuple[float, float]:
    """Pixels per metre along the marker's x and y axes at its centre, foreshortening included."""
    step = 1e-4
    ends = scene_view.to_image(np.array([[step, 0, 0], [-step, 0, 0], [0, step, 0], [0, -step, 0]]))
    return (
        float(np.linalg.norm(ends[0] - ends[1]) / (2 * step)),
        float(np.linalg.norm(ends[2] - ends[3]) / (2 * step)),
    )


def link_budget(scenario: Scenario, light: str, mean_rate: float | None = None) -> LinkBudget:
    """The closed-form budget of the scenario's range in an illumination.

    Args:
        mean_rate: electrons per second and pixel of the whole imaged frame, without stray light from outside it, for veiling
            glare to spread; absent, the closed form's own estimate (`frame_light`).
    """
    scene_view, marker, target = view(scenario), scenario.marker, scenario.target
    response, strength = responsivity(scenario), strengths(scenario)
    wavelength = link.band_grid(response)
    viewer = scene_view.to_marker(np.zeros(3))
    leds = scene_view.to_marker(scenario.leds.positions_m())
    falloff, sources = scenario.camera.relative_illumination(), lights_on(scenario, light)

    def rate(points_m: FloatArray, material: str, lights: tuple[str, ...]) -> FloatArray:
        brdf, total = library.load(material).brdf, np.zeros(len(points_m))
        for source in lights:
            if source == "sun":
                transport = link.sun_transport(points_m, viewer, scene_view.sun_in_marker, brdf, wavelength)
            elif source == "earth":
                transport = _earth_transport(scene_view, brdf, wavelength)
            else:
                axis = scene_view.rotation[2]
                transport = link.ring_transport(points_m, viewer, leds, axis, scenario.leds, brdf, wavelength)
            total += link.electron_rate(transport, wavelength, strength[source], response)
        column, row = np.rint(scene_view.to_image(points_m)).astype(int).T
        return total * falloff[row.clip(0, falloff.shape[0] - 1), column.clip(0, falloff.shape[1] - 1)]

    tape, outlines = visible_tape(scene_view), hidden_face(scene_view)

    def mean_over_bits(centres_m: FloatArray) -> tuple[float, float]:
        pixels = [np.column_stack(p[::-1]) for p in bit_pixels(scene_view, centres_m)]
        seen = np.array([len(p) > 0 for p in pixels])
        if not seen.any():
            return np.nan, np.nan
        ends = np.cumsum([len(p) for p in pixels])[:-1]

        def share(polygons_px: FloatArray, parts: FloatArray) -> FloatArray:  # mean over each bit's pixels
            pixel_share = link.reflective_fill(
                np.concatenate(pixels), polygons_px, scene_view.camera.psf_sigma_px, parts
            )
            return np.array([part.mean() for part in np.split(pixel_share, ends) if len(part)])

        fill, centres = share(*tape), centres_m[seen]
        level = fill * rate(centres, target.tape_material, sources)
        for source in sources:
            hidden = share(outlines["sun" if source == "sun" else "led"][None], np.ones(1))
            level += (hidden - fill) * rate(centres, target.absorber_material, (source,))
            level += (1 - hidden) * rate(centres, target.face_material, (source,))
        return float(np.mean(level)), float(np.mean(fill))

    white, black = marker.white_bit_centres_m(), marker.black_bit_centres_m()
    (signal, fill), (background, _) = mean_over_bits(white), mean_over_bits(black)
    camera = scenario.camera
    if camera.veiling_glare > 0:
        if mean_rate is None:
            mean_rate = mean_frame_rate(scene_view, lambda points, material: rate(points, material, sources))
        signal, background = (float(stray.veiled(v, camera.veiling_glare, mean_rate)) for v in (signal, background))
    if light == "sun" and camera.point_source_transmittance:
        signal, background = (v + sun_stray_rate(scenario) for v in (signal, background))
    speed = np.radians(scenario.target.tumble_deg_s) * scenario.target.tumble_lever_m
    return LinkBudget(
        scenario.sensor,
        signal,
        background,
        float(np.mean(rate(white, target.tape_material, sources))),
        float(marker.bit_m * min(bit_scale_px(scene_view))),
        float(link.smear_px(scenario.camera, scenario.range_m, speed, 1.0)),
        fill,
    )


def _earth_transport(scene_view: View, brdf: link.Brdf, wavelength_nm: FloatArray) -> FloatArray:
    """Earth's light in the closed form: the disc is so far, and so wide, that the marker's centre stands for all of it."""
    assert scene_view.earth is not None
    viewer = scene_view.to_marker(np.zeros(3))
    return earth_transport(
        viewer / np.linalg.norm(viewer),
        scene_view.earth_in_marker,
        scene_view.earth.angular_radius_rad,
        brdf,
        wavelength_nm,
    )


def link_budget_beside(scenario: Scenario, light: str, rate: FloatArray) -> LinkBudget:
    """The closed-form budget, with the veil that a rendered frame's own mean rate (height, width) spreads."""
    if scenario.camera.veiling_glare == 0:
        return link_budget(scenario, light)
    stray_rate = sun_stray_rate(scenario) if "sun" in LIGHTS_ON[light] else 0.0
    return link_budget(scenario, light, float(rate.mean()) - stray_rate)


def exposure_s(scenario: Scenario, budget: LinkBudget, exposure: float | str) -> float:
    """The exposure in seconds; 'auto' is the one that brings the bright bits to the wanted fraction of full well.

    Raises:
        ValueError: for 'auto' where no bit is in the frame.
    """
    if not isinstance(exposure, str):
        return exposure
    auto = scenario.auto_exposure
    charge = auto.full_well_fraction * usable_well(scenario.sensor)
    rate = budget.signal_rate + scenario.sensor.dark_rate_electrons_per_s
    if np.isnan(rate):
        raise ValueError(
            f"exposure_s: 'auto' needs a bit in the frame, and none is at {scenario.range_m:g} m; give seconds [s]"
        )
    longest = min(auto.longest_s, scenario.leds.longest_pulse_s)
    return float(np.clip(charge / rate if rate > 0 else np.inf, min(auto.shortest_s, longest), longest))


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


def look(scenario: Scenario, image: NDArray[Any]) -> Sighting:
    """Find the scenario's marker in an image and solve its pose; a distorted lens's image is rectified first.

    Raises:
        ValueError: when the image is not two-dimensional, of another size than the camera's, or holds NaN or infinity.
    """
    camera = scenario.camera
    if image.shape != (camera.height_px, camera.width_px):
        raise ValueError(
            f"image is {'×'.join(map(str, image.shape[::-1]))} px, the camera {camera.width_px}×{camera.height_px} px"
        )
    noise, camera = noise_model(scenario, image), view(scenario).camera
    ideal = ideal_camera(camera) if camera.distorted else camera
    seen = rectified(image, camera, ideal, noise) if camera.distorted else image
    features = detect_features(seen, scenario.marker, ideal, noise)
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


def bit_pixels(scene_view: View, centres_m: FloatArray) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Pixels (rows, columns) that count as each bit: within `link.sampling_window_px` of its centre, the nearest at least."""
    scale = np.array(bit_scale_px(scene_view))
    half = link.sampling_window_px(scene_view.marker.bit_m * scale) / 2
    reach = int(np.ceil(half.max() * 1.5)) + 1
    offsets = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    camera, pixels = scene_view.camera, []
    for centre, middle in zip(scene_view.to_image(centres_m), centres_m, strict=True):
        nearby = np.rint(centre).astype(int) + offsets
        inside = np.all(np.abs(on_plane(scene_view, nearby) - middle[:2]) * scale <= half, axis=1)
        if not inside.any():
            inside = np.all(offsets == 0, axis=1)
        column, row = nearby[inside].T
        seen = (column >= 0) & (row >= 0) & (column < camera.width_px) & (row < camera.height_px)
        pixels.append((row[seen], column[seen]))
    return pixels


def on_plane(scene_view: View, image_px: FloatArray) -> FloatArray:
    """Marker-plane coordinates (n, 2) [m] of image positions (n, 2)."""
    return scene_view.to_plane(image_px)
