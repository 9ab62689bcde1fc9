"""Closed form against rendering, cell by cell, with an error budget and a check of the drawn noise.

A cell is a range, marker size, tilt, illumination and sensor. Transport is rendered once per geometry and Sun; the eclipse and
every sensor come from the same basis images. Only the detector's pixels about the bits are rendered, at their own places.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from detector.sensor.sensor import Sensor, expose, moments, presets
from experiments import chain
from experiments.chain.progress import Progress
from experiments.scenario import Scenario, load_scenario
from materials import library
from radiometry import link
from radiometry.geometry import FloatArray
from scenes.render.transport import TransportBasis

#: Pixels (rows, columns) of each bit.
_Pixels = list[tuple[NDArray[np.intp], NDArray[np.intp]]]

#: Largest relative difference that agrees: from so many pixels per bit on, and below.
FINE_PX_PER_BIT, FINE_TOLERANCE, COARSE_TOLERANCE = 3.0, 0.01, 0.03
#: Probability that every noise check of a run passes where drawn and closed-form noise are the same.
CONFIDENCE = 0.999
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
#: Sensor name that stands for the scenario's own.
SCENARIO_SENSOR = "scenario"


@dataclass(frozen=True)
class Plan:
    """The cells, the noise draws of each, and the rays of a rendering."""

    ranges_m: tuple[float, ...] = tuple(float(r) for r in range(1, 21))
    sizes_m: tuple[float, ...] = (0.05, 0.10, 0.20)
    tilts_deg: tuple[float, ...] = (0.0, 20.0, 40.0)
    phases_deg: tuple[float, ...] = (15.0, 45.0, 75.0)
    sensors: tuple[str, ...] = (SCENARIO_SENSOR, "icx429al")
    draws: int = 16
    rays: int = 2_000_000


FULL = Plan()
QUICK = Plan((1.0, 3.0, 8.0, 20.0), (0.05, 0.20), (0.0, 40.0), (45.0, 75.0), rays=500_000)

DIMS = ("range_m", "size_m", "tilt_deg", "illumination", "sensor")
_NOISE = ("noise_variance_ratio", "noise_mean_z", "noise_freedom")


def run(
    out_dir: Path | None = None,
    quick: bool = False,
    progress: Progress | None = None,
    seed: int | None = None,
    scenario: Scenario | None = None,
) -> xr.Dataset:
    """Validate the whole grid and, into a folder, write results.nc, cells.csv, agreement.svg and error-budget.svg.

    Args:
        quick: four ranges, two sizes, two tilts and two Suns instead of 20 × 3 × 3 × 3.
        seed: of renderings and noise; default the scenario's.
        scenario: camera, LEDs and materials; default the shipped one. Range, marker size, tilt and phase are the plan's.

    Raises:
        OSError: when a file cannot be written.
    """
    scenario = scenario or load_scenario()
    dataset = validate(QUICK if quick else FULL, scenario if seed is None else scenario.at(seed=seed), progress)
    if out_dir is not None:
        from experiments.reporting.figures import save_svg
        from experiments.reporting.files import write_netcdf, write_text
        from experiments.studies.validate import figures as validate_figures
        from experiments.studies.validate import tables as validate_tables

        write_netcdf(dataset, out_dir / "results.nc")
        write_text(validate_tables.cells_csv(dataset), out_dir / "cells.csv")
        save_svg(validate_figures.agreement(dataset), out_dir / "agreement.svg")
        save_svg(validate_figures.error_budget(dataset), out_dir / "error-budget.svg")
    return dataset


def validate(plan: Plan, scenario: Scenario, progress: Progress | None = None) -> xr.Dataset:
    """The labelled result of a plan; a cell whose bits leave the frame holds NaN and a reason."""
    illuminations = ("eclipse", *(f"sun {phase:g} deg" for phase in plan.phases_deg))
    shape = (len(plan.ranges_m), len(plan.sizes_m), len(plan.tilts_deg), len(illuminations))
    names = [f"{q}_{how}" for q in QUANTITIES for how in ("analytic", "rendered")] + ["exposure_s", *_NOISE]
    cells = {name: np.full((*shape, len(plan.sensors)), np.nan) for name in names}
    effects = np.full((*shape, len(EFFECTS)), np.nan)
    remainders = np.full((*shape, len(REMAINDERS), 2), np.nan)
    px_per_bit, reason = np.full(shape[:3], np.nan), np.full(shape[:3], "", dtype=object)

    # Size outermost: the renderer keeps the scenes of a few markers.
    steps = list(product(enumerate(plan.sizes_m), enumerate(plan.tilts_deg), enumerate(plan.ranges_m)))
    for done, ((s, size_m), (t, tilt_deg), (r, range_m)) in enumerate(steps):
        here = at_geometry(scenario, range_m, size_m, tilt_deg)
        index = (r, s, t)
        px_per_bit[index] = here.marker.bit_m * min(chain.bit_scale_px(chain.view(here)))
        reason[index] = why_not(here)
        if not reason[index]:
            bits = _Bits(cropped(here), plan)
            for k, illumination in enumerate(bits.illuminations):
                for d, name in enumerate(plan.sensors):
                    for key, value in bits.cell(
                        illumination, _sensor(scenario, name), plan.draws, (*index, k, d)
                    ).items():
                        cells[key][*index, k, d] = value
                effects[*index, k] = bits.effects(illumination)
                remainders[*index, k] = bits.remainders(illumination)
        if progress:
            progress(done + 1, len(steps), f"{size_m * 100:g} cm, {tilt_deg:g}°, {range_m:g} m")
    dataset = xr.Dataset(
        {name: (DIMS, values) for name, values in cells.items()}
        | {
            "effect_on_signal": ((*DIMS[:4], "effect"), effects),
            "remainder": ((*DIMS[:4], "source", "quantity"), remainders),
            "px_per_bit": (DIMS[:3], px_per_bit),
            "reason": (DIMS[:3], reason.astype(str)),
        },
        coords={
            "range_m": list(plan.ranges_m), "size_m": list(plan.sizes_m), "tilt_deg": list(plan.tilts_deg),
            "illumination": list(illuminations), "phase_deg": ("illumination", [np.nan, *plan.phases_deg]), "sensor": list(plan.sensors),
            "effect": list(EFFECTS), "source": list(REMAINDERS), "quantity": ["signal", "background"],
        },
        attrs={"title": "Closed form against rendering", "draws": plan.draws, **chain.provenance(scenario)},
    )  # fmt: skip
    return judged(dataset)


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


class _Bits:
    """Rendered and closed-form bits of one geometry in every light."""

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
        #: (scenario, 'eclipse' or 'sun', transport) by label; the LEDs are the same under every Sun.
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


def _sensor(scenario: Scenario, name: str) -> Sensor:
    return scenario.sensor if name == SCENARIO_SENSOR else presets()[name].sensor


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
    return float(
        link.ring_transport(points, viewer, view.to_marker(leds.positions_m()), axis, leds, brdf, centre_nm).mean()
    )


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


def judged(dataset: xr.Dataset) -> xr.Dataset:
    """A dataset of both sides of every cell with differences, limits and verdicts, made anew."""
    for name in QUANTITIES:
        dataset[f"{name}_difference"] = dataset[f"{name}_rendered"] / dataset[f"{name}_analytic"] - 1
    dataset["tolerance"] = xr.where(dataset.px_per_bit >= FINE_PX_PER_BIT, FINE_TOLERANCE, COARSE_TOLERANCE)
    validated = np.isfinite(dataset.signal_difference)
    # Šidák: each of 2 N checks is held to such a level that all pass together with the confidence.
    tail = (1 - CONFIDENCE ** (1 / max(2 * int(validated.sum()), 1))) / 2
    freedom = dataset.noise_freedom
    for name, level in (("low", tail), ("high", 1 - tail)):
        dataset[f"noise_variance_{name}"] = (DIMS, stats.chi2.ppf(level, freedom) / freedom.values)
    ratio = dataset.noise_variance_ratio
    dataset["noise_agrees"] = (ratio > dataset.noise_variance_low) & (ratio < dataset.noise_variance_high)
    dataset["noise_agrees"] &= np.abs(dataset.noise_mean_z) < stats.norm.isf(tail)
    worst = np.max([np.abs(dataset[f"{name}_difference"].values) for name in QUANTITIES], axis=0)
    dataset["worst_difference"] = (DIMS, worst)
    dataset["agrees"] = ~validated | ((dataset.worst_difference <= dataset.tolerance) & dataset.noise_agrees)
    return dataset
