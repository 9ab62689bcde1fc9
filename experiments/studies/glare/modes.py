"""Counter-measures against sun glare, each a mode.

They are the filter, the shutter, the on/off pair, the exposure bracket, a second band, polarisers, the chaser's own shadow, and
the pipeline.

A mode turns the electron rates of LEDs and Sun into an image, the noise the detector is told of, and a detection. The LED pulse
is set so that the bright bits reach the scenario's fraction of the well; the Sun shines as long as the shutter is open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import detector.detect as detector
from detector.detect import Detection
from detector.sensor.noise import NoiseModel, sensor_noise
from detector.sensor.pair import difference
from detector.sensor.sensor import expose
from experiments import chain
from experiments.scenario import Scenario
from experiments.scenario.presets import presets
from experiments.studies.glare.bracket import fuse
from experiments.studies.shared.baseline import baseline_detect, to_eight_bits
from radiometry.filters import Bandpass
from radiometry.geometry import FloatArray, sun_direction
from scenes.view import View

#: Error of the predicted image motion between the frames of a pair, over the motion. Assumption: a tracking filter's.
MOTION_ERROR = 0.05
#: Part of unpolarised light that a polariser passes, twice over. Assumption: a wire grid for the near infrared.
POLARISER_TRANSMISSION = 0.9
#: Degree of linear polarisation that the tape's return keeps of polarised LED light. Assumption: prisms turn it in part.
POLARISATION_KEPT = 0.6


@dataclass(frozen=True)
class Mode:
    """One counter-measure, or the lack of it."""

    title: str
    """What it is, in a few words."""
    filter: str | None = None
    """Filter preset; None is the scenario's filter."""
    shutter_s: float | None = None
    """How long the shutter is open [s]; None: as long as the LED pulse."""
    pair: Literal["", "raw", "registered"] = ""
    """Whether a frame without LEDs is subtracted, as it is or shifted back by the predicted motion."""
    bracket: tuple[float, ...] = (1.0,)
    """Exposures of a bracket over the LED pulse, falling; each with a pulse and shutter of its own."""
    off_filter: str | None = None
    """Filter preset, beside the LEDs' band, of a second camera at the same moment, whose image is subtracted."""
    polarised: bool = False
    """Whether the LEDs shine through a polariser and the camera looks through one parallel to it."""
    chaser_radius_m: float = 0.0
    """Radius of the disc, in the plane of the lens and about the axis, that shadows the target [m]; 0 is none."""
    pipeline: Literal["mantis", "thesis"] = "mantis"
    """Feature extraction: `detector.detect`, or the thesis's (`shared.baseline`) on 8 bits."""


#: 20 µs: shortest exposure that many global-shutter cameras offer (assumption); 1 ms: one of the budget's exposures.
MODES: dict[str, Mode] = {
    "single": Mode("one LED-synchronous frame, the scenario's filter"),
    "longpass": Mode("one LED-synchronous frame, LP715 longpass", filter="lp715"),
    "narrow": Mode("one LED-synchronous frame, 25 nm bandpass", filter="bp850_25"),
    "shutter": Mode("the same LED pulse, shutter open for 20 µs", shutter_s=20e-6),
    "long": Mode("the same LED pulse, shutter open for 1 ms", shutter_s=1e-3),
    "pair": Mode("LEDs on minus LEDs off, registered", pair="registered"),
    "pair_raw": Mode("LEDs on minus LEDs off, not registered", pair="raw"),
    "bracket": Mode(
        "exposure bracket: the pulse, a quarter and a sixteenth of it, fused", bracket=(1.0, 1 / 4, 1 / 16)
    ),
    "two_bands": Mode("850 nm minus 785 nm at the same moment", filter="bp850_25", off_filter="bp785_25"),
    "polarised": Mode("one frame, polarisers before LEDs and lens", polarised=True),
    "shadowed": Mode("one frame, the chaser's body (0.5 m radius) shadows the target", chaser_radius_m=0.5),
    "thesis": Mode("the thesis's pipeline: LP715, 8 bits, OpenCV ArUco and blobs", filter="lp715", pipeline="thesis"),
}


@dataclass(frozen=True)
class Rates:
    """Electron rates (H, W) of a geometry through one filter [e⁻/s].

    Attributes:
        led, sun: light of the LEDs and of the Sun.
        moved_sun: sunlight one frame interval later.
        off: all light through the filter of the second band, where there is one.
        off_scale: sunlight from a grey surface through the first filter over that through the second.
    """

    led: FloatArray
    sun: FloatArray
    moved_sun: FloatArray
    off: FloatArray | None = None
    off_scale: float = 1.0


@dataclass(frozen=True)
class ModeImage:
    """The image of a mode.

    Attributes:
        pixels: (H, W), as the detector gets it.
        noise: what is known of its noise.
        lit_dn: the frame with LEDs, which tells how far it saturates; of a bracket the shortest.
    """

    pixels: FloatArray | NDArray[np.uint16]
    noise: NoiseModel
    lit_dn: NDArray[np.uint16]


def through(scenario: Scenario, preset: str | None) -> Scenario:
    """The scenario with the filter of a preset; None is its own."""
    if preset is None:
        return scenario
    return scenario.model_copy(update={"filter": Bandpass(**presets("filter")[preset])})


def pulse_s(scenario: Scenario, mode: Mode, led_bits: float, sun_bits: float) -> float:
    """LED pulse that brings the bright bits to the scenario's fraction of the well [s], from their rates [e⁻/s].

    A shutter that closes with the pulse counts the Sun's light on the bits in; one of fixed length cannot.
    """
    auto = scenario.auto_exposure
    rate = led_bits + (sun_bits if mode.shutter_s is None else 0.0)
    seconds = auto.full_well_fraction * chain.usable_well_electrons(scenario.sensor) / max(rate, 1e-9)
    return float(np.clip(seconds, auto.shortest_s, auto.longest_s if mode.shutter_s is None else mode.shutter_s))


def expose_mode(
    scenario: Scenario, mode: Mode, rates: Rates, seconds: float, motion_px: FloatArray, rng: np.random.Generator
) -> ModeImage:
    """One image of a mode.

    Args:
        scenario: camera, lights, marker and target.
        mode: the counter-measure.
        rates: electron rates of LEDs and Sun.
        rng: draws the noise.
        seconds: LED pulse.
        motion_px: image motion (2,) of the target's marker between the two frames of a pair.
    """
    sensor, noise = scenario.sensor, sensor_noise(scenario.sensor)
    shutter = seconds if mode.shutter_s is None else mode.shutter_s
    on = expose(sensor, (rates.led * seconds + rates.sun * shutter) / shutter, shutter, rng).dn
    if mode.pair:
        off = expose(sensor, rates.moved_sun, shutter, rng).dn
        predicted = None
        if mode.pair == "registered":
            predicted = motion_px * (1 + MOTION_ERROR * rng.standard_normal())
        return ModeImage(*difference(on, off, noise, predicted), on)
    if rates.off is not None:
        off = expose(sensor, rates.off, shutter, rng).dn
        return ModeImage(*difference(on, off, noise, scale=rates.off_scale), on)
    if len(mode.bracket) > 1:
        steps = bracket_exposures_s(scenario, mode, seconds)
        frames = [on, *(expose(sensor, rates.led + rates.sun, s, rng).dn for s in steps[1:])]
        return ModeImage(*fuse(sensor, frames, steps), frames[-1])
    return ModeImage(on, noise, on)


def bracket_exposures_s(scenario: Scenario, mode: Mode, seconds: float) -> list[float]:
    """Exposures of a mode's bracket from its LED pulse on [s]: those that the camera can make, each once."""
    return sorted({max(seconds * share, scenario.auto_exposure.shortest_s) for share in mode.bracket}, reverse=True)


def detect(scenario: Scenario, mode: Mode, image: ModeImage) -> Detection:
    """What the mode's pipeline finds in an image."""
    camera = scenario.camera
    if mode.pipeline == "thesis":
        sensor = scenario.sensor
        eight_bits = to_eight_bits(image.pixels, sensor.offset_dn, sensor.saturation_dn)
        return baseline_detect(eight_bits, scenario.marker, camera)
    return detector.detect(
        image.pixels, scenario.marker, camera, noise=image.noise, led_ring_radius_m=scenario.leds.ring_radius_m
    )


def chaser_shadow(view: View, radius_m: float) -> FloatArray:
    """Share of the Sun's disc that the chaser leaves free, (H, W), for what each pixel sees in the marker's plane.

    The chaser is an opaque disc about the optical axis in the plane of the lens; across its penumbra the share is linear.
    """
    camera = view.camera
    column, row = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    plane = view.to_plane(np.column_stack([column.ravel(), row.ravel()]))
    points = plane @ view.rotation[:, :2].T + view.translation_m
    sun = sun_direction(np.radians(view.sun.phase_deg), np.radians(view.sun.azimuth_deg))
    if radius_m == 0 or sun[2] >= 0:
        return np.ones(column.shape)
    travel = points[:, 2] / -sun[2]
    distance = np.hypot(*(points[:, :2] + travel[:, None] * sun[:2]).T)
    penumbra = travel * np.tan(view.sun.angular_radius_rad)
    return np.clip(0.5 + (distance - radius_m) / (2 * penumbra), 0, 1).reshape(column.shape)
