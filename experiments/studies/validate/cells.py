"""One cell of the validation: bits of one geometry rendered and in closed form, and what their difference is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.sensor.sensor import Sensor, expose, moments, presets
from experiments import chain
from experiments.scenario import Scenario
from experiments.studies.validate.plan import SCENARIO_SENSOR, Plan
from materials import library
from radiometry import link
from radiometry.geometry import FloatArray
from scenes.render.transport import TransportBasis

#: Pixels (rows, columns) of each bit.
_Pixels = list[tuple[NDArray[np.intp], NDArray[np.intp]]]

#: Below this sampling the point spread reaches from a bit's pixels beyond the marker.
FACETS_PX_PER_BIT = 1.0

QUANTITIES = ("signal", "background", "snr", "cnr")
#: Effects that the closed form includes; the budget says by how much the signal would differ without each.
EFFECTS = {
    "point_spread": "lens without point spread",
    "neighbours": "bits that fill their pixels",
    "surroundings": "closed encoding elements, black face",
    "led_pattern": "LEDs that radiate alike in all directions",
    "observation_angle": "one observation angle b/R for all LEDs and bits",
    "natural_falloff": "no cos⁴ fall-off",
}
#: What the closed form leaves out, or the renderer adds, relative to the signal and to the background.
REMAINDERS = {
    "facets": "crinkles of the foil beside the marker (rendered with against without them)",
    "monte_carlo": "standard deviation over renderings with different seeds",
}


def at_geometry(scenario: Scenario, range_m: float, size_m: float, tilt_deg: float) -> Scenario:
    """The scenario at a range, with a marker of a size, tilted towards the Sun's default side.

    The tilt is shared by yaw and pitch, cos(tilt) = cos(yaw) cos(pitch), so that the marker's axes are skew in the image.
    """
    share_deg = float(np.degrees(np.arccos(np.sqrt(np.cos(np.radians(tilt_deg))))))
    return scenario.at(
        range_m=range_m,
        marker=scenario.marker.model_dump() | {"size_m": size_m},
        target=scenario.target.model_dump() | {"yaw_deg": share_deg, "pitch_deg": -share_deg, "roll_deg": 0.0},
    )


def why_not(scenario: Scenario) -> str:
    """Why a geometry cannot be validated; empty where it can."""
    camera, corners = scenario.camera, chain.view(scenario).to_image(scenario.marker.corners_m)
    inside = (corners >= -0.5) & (corners <= np.array([camera.width_px, camera.height_px]) - 0.5)
    return "" if inside.all() else "the ArUco square leaves the frame"


def cropped(scenario: Scenario) -> Scenario:
    """The same camera with only its middle, around the ArUco square: every pixel keeps its place in the scene.

    Counts keep their parity, and so the optical axis its place between pixels. Veiling glare is left out: it spreads the light
    of the whole frame.
    """
    camera, margin_px = scenario.camera, 4
    reach = np.abs(chain.view(scenario).to_image(scenario.marker.corners_m) - camera.principal_point_px).max(axis=0)
    size: dict[str, int] = {}
    for key, half in zip(("width_px", "height_px"), reach, strict=True):
        full = getattr(camera, key)
        size[key] = min(full, max(16 + full % 2, 2 * int(np.ceil(half + margin_px)) + full % 2))
    return scenario.at(camera=camera.model_dump() | size | {"veiling_glare": 0.0})


class Bits:
    """Rendered and closed-form bits of one geometry in every illumination."""

    def __init__(self, scenario: Scenario, plan: Plan) -> None:
        view = chain.view(scenario)
        render = {"frame_samples": 1, "marker_rays": plan.rays, "wavelength_nodes": scenario.render.wavelength_nodes}
        suns = [
            scenario.at(
                sun=scenario.sun.model_dump() | {"phase_deg": p}, render=render | {"seed": scenario.seed + 10 * k}
            )
            for k, p in enumerate(plan.phases_deg)
        ]
        self.bases = [chain.transport(sun) for sun in suns]
        #: (scenario, 'eclipse' or 'sunlit', transport) by label; the LEDs are the same under every Sun.
        self.illuminations: dict[str, tuple[Scenario, str, TransportBasis]] = {
            "eclipse": (suns[0], "eclipse", self.bases[0]),
            **{f"sun {s.sun.phase_deg:g} deg": (s, "sunlit", b) for s, b in zip(suns, self.bases, strict=True)},
        }
        self.white = chain.bit_pixels(view, scenario.marker.white_bit_centres_m())
        self.black = chain.bit_pixels(view, scenario.marker.black_bit_centres_m())

    def _rendered(self, scenario: Scenario, illumination: str, basis: TransportBasis) -> tuple[FloatArray, FloatArray]:
        """Electron rates of the frame, and (signal, background)."""
        rate = chain.electron_rate(scenario, basis, illumination)
        return rate, np.array([np.mean([rate[p].mean() for p in pixels]) for pixels in (self.white, self.black)])

    def cell(self, label: str, sensor: Sensor, draws: int, key: tuple[int, ...]) -> dict[str, float]:
        """Both sides of every quantity in electrons and ratios, and the noise statistics."""
        scenario, illumination, basis = self.illuminations[label]
        scenario = scenario.model_copy(update={"sensor": sensor})
        budget = chain.link_budget(scenario, illumination)
        seconds = chain.solve_exposure(scenario, budget, "auto")
        rate, (signal, background) = self._rendered(scenario, illumination, basis)
        analytic = budget.at(seconds)
        electrons = signal * seconds, background * seconds
        dark, noise = analytic["dark"], sensor.total_noise_electrons
        rendered = (*electrons, link.snr(electrons[0], dark, noise), link.cnr(*electrons, dark, noise))
        values = {f"{name}_analytic": analytic[name] for name in QUANTITIES}
        values |= {f"{name}_rendered": float(v) for name, v in zip(QUANTITIES, rendered, strict=True)}
        rng = np.random.default_rng((scenario.seed, *key))
        return (
            values | {"exposure_s": seconds} | noise_statistics(sensor, rate[_joined(self.white)], seconds, draws, rng)
        )

    def effects(self, label: str) -> list[float]:
        """Relative change of the closed-form signal without each of `EFFECTS`."""
        scenario, illumination, _ = self.illuminations[label]
        camera, budget = scenario.camera, chain.link_budget(scenario, illumination)
        signal, led_share = budget.signal_rate, chain.link_budget(scenario, "eclipse").signal_rate / budget.signal_rate
        sharp = scenario.model_copy(update={"camera": camera.model_copy(update={"psf_sigma_px": 0.0})})
        alone = scenario.model_copy(
            update={
                "marker": scenario.marker.model_copy(update={"slat_fraction": 1.0}),
                "target": scenario.target.model_copy(update={"face_material": scenario.target.absorber_material}),
            }
        )
        tape = _tape_radiance(scenario)
        return [
            chain.link_budget(sharp, illumination).signal_rate / signal - 1,
            budget.tape_rate / signal - 1,
            chain.link_budget(alone, illumination).signal_rate / signal - 1,
            led_share * (_tape_radiance(scenario, pattern=False) / tape - 1),
            led_share * (_tape_radiance(scenario, angles=False) / tape - 1),
            1 / float(np.mean([camera.relative_illumination()[p].mean() for p in self.white])) - 1,
        ]

    def remainders(self, label: str) -> FloatArray:
        """(sources, signal and background) relative to each, of `REMAINDERS`."""
        scenario, illumination, basis = self.illuminations[label]
        rendered = self._rendered(scenario, illumination, basis)[1]
        result = np.zeros((len(REMAINDERS), 2))
        if scenario.marker.bit_m * min(chain.bit_scale_px(chain.view(scenario))) < FACETS_PX_PER_BIT:
            flat = scenario.at(target=scenario.target.model_dump() | {"facet_slope_deg": 0.0})
            result[0] = rendered / self._rendered(flat, illumination, chain.transport(flat))[1] - 1
        # The LEDs were rendered under every Sun with another seed; the Sun's own light has no angle to choose but its disc's.
        repeats = np.array([self._rendered(scenario, "eclipse", b)[1] for b in self.bases])
        result[1] = repeats.std(axis=0, ddof=1) / rendered if len(repeats) > 1 else np.nan
        return result


def sensor_of(scenario: Scenario, name: str) -> Sensor:
    """The sensor of a plan's name, with all pixels alike: the draws compare temporal noise, and a fixed pattern has none."""
    sensor = scenario.sensor if name == SCENARIO_SENSOR else presets()[name].sensor
    return sensor.model_copy(update={"prnu": 0.0, "dsnu_electrons": 0.0, "hot_fraction": 0.0, "dead_fraction": 0.0})


def _joined(pixels: _Pixels) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    return np.concatenate([p[0] for p in pixels]), np.concatenate([p[1] for p in pixels])


def _tape_radiance(scenario: Scenario, pattern: bool = True, angles: bool = True) -> float:
    """Mean radiance of the bits' tape per intensity of the ring [m⁻²], without the LEDs' pattern or their own angles."""
    view, leds = chain.view(scenario), scenario.leds
    points, viewer, axis = scenario.marker.white_bit_centres_m(), view.to_marker(np.zeros(3)), view.rotation[2]
    tape = library.load(scenario.target.tape_material).brdf
    to_viewer = viewer / np.linalg.norm(viewer)
    # Square to the plane of normal and viewer, so that the entrance angle stays that of the tilt.
    sideways = np.cross(to_viewer, [0.0, 1.0, 0.0] if abs(to_viewer[2]) > 1 - 1e-9 else [0.0, 0.0, 1.0])
    alpha = np.arctan(leds.ring_radius_m / scenario.range_m)
    to_led = np.cos(alpha) * to_viewer + np.sin(alpha) * sideways / np.linalg.norm(sideways)

    def brdf(normal: FloatArray, led: FloatArray, eye: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
        value = tape(normal, led, eye, wavelength_nm) if angles else tape(normal, to_led, to_viewer, wavelength_nm)
        return value if pattern else value / leds.pattern(-led @ axis)

    centre_nm = np.array([leds.centroid_nm])
    per_point = link.ring_transport(
        points,
        viewer_m=viewer,
        leds_m=view.to_marker(leds.positions_m()),
        axis=axis,
        ring=leds,
        brdf=brdf,
        wavelength_nm=centre_nm,
    )
    return float(per_point.mean())


def noise_statistics(
    sensor: Sensor, rate: FloatArray, exposure_s: float, draws: int, rng: np.random.Generator
) -> dict[str, float]:
    """Drawn frames against closed-form moments, over pixels (n,) of known rates.

    Returns:
        Mean over pixels of the variance between draws over the closed-form variance, its degrees of freedom n (draws − 1), and
        the standardised deviation of the drawn from the closed-form mean.
    """
    mean_dn, variance_dn = moments(sensor, rate, exposure_s)
    dn = np.array([expose(sensor, rate[None], exposure_s, rng).dn[0] for _ in range(draws)], float)
    z = np.sum(dn - mean_dn) / np.sqrt(draws * np.sum(variance_dn))
    ratio = np.mean(dn.var(axis=0, ddof=1) / variance_dn)
    return {"noise_variance_ratio": float(ratio), "noise_mean_z": float(z), "noise_freedom": len(rate) * (draws - 1.0)}
