"""The closed-form budget of one range and illumination, and the exposure that follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detector.sensor.sensor import Sensor, usable_well_electrons
from experiments.chain.illumination import SOURCES, active_sources, responsivity, source_spectra, sun_stray_rate
from experiments.chain.view import view
from experiments.scenario import Scenario
from materials import library
from radiometry import link, stray
from radiometry.earth import earth_transport
from radiometry.geometry import FloatArray
from scenes.projection.bits import bit_pixels, bit_scale_px
from scenes.projection.frame_light import mean_frame_rate
from scenes.projection.visible import hidden_face, visible_tape
from scenes.view import View


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
            "full_well_fraction": (signal + dark) / usable_well_electrons(self.sensor),
            "smear_px": self.smear_px_per_s * exposure_s,
        }


def link_budget(scenario: Scenario, illumination: str, mean_rate: float | None = None) -> LinkBudget:
    """The closed-form budget of the scenario's range in an illumination.

    Args:
        scenario: of whose range, camera, marker and lights.
        illumination: 'eclipse' or 'sunlit'.
        mean_rate: electrons per second and pixel of the whole imaged frame, without stray light from outside it, for veiling
            glare to spread; absent, the closed form's own estimate (`frame_light`).
    """
    scene_view, marker, target = view(scenario), scenario.marker, scenario.target
    response, strength = responsivity(scenario), source_spectra(scenario)
    wavelength = link.band_grid(response)
    viewer = scene_view.to_marker(np.zeros(3))
    leds = scene_view.to_marker(scenario.leds.positions_m())
    falloff, sources = scenario.camera.relative_illumination(), active_sources(scenario, illumination)

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
    if illumination == "sunlit" and camera.point_source_transmittance:
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


def link_budget_beside(scenario: Scenario, illumination: str, rate: FloatArray) -> LinkBudget:
    """The closed-form budget, with the veil that a rendered frame's own mean rate (height, width) spreads."""
    if scenario.camera.veiling_glare == 0:
        return link_budget(scenario, illumination)
    stray_rate = sun_stray_rate(scenario) if "sunlit" in SOURCES[illumination] else 0.0
    return link_budget(scenario, illumination, float(rate.mean()) - stray_rate)


def solve_exposure(scenario: Scenario, budget: LinkBudget, exposure: float | str) -> float:
    """The exposure in seconds; 'auto' is the one that brings the bright bits to the wanted fraction of full well.

    Raises:
        ValueError: for 'auto' where no bit is in the frame.
    """
    if not isinstance(exposure, str):
        return exposure
    auto = scenario.auto_exposure
    charge = auto.full_well_fraction * usable_well_electrons(scenario.sensor)
    rate = budget.signal_rate + scenario.sensor.dark_rate_electrons_per_s
    if np.isnan(rate):
        raise ValueError(
            f"exposure_s: 'auto' needs a bit in the frame, and none is at {scenario.range_m:g} m; shorten "
            "camera.focal_length_m, leave the range out, or give seconds [s]"
        )
    longest = min(auto.longest_s, scenario.leds.longest_pulse_s)
    return float(np.clip(charge / rate if rate > 0 else np.inf, min(auto.shortest_s, longest), longest))
