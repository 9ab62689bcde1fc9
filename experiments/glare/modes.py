"""Counter-measures against sun glare, each a mode: filter, shutter, on/off pair, the chaser's own shadow, the pipeline.

A mode turns the electron rates of LEDs and Sun into an image, the noise the detector is told of, and features. The LED pulse is
set so that the bright bits reach the scenario's fraction of the well; the Sun shines as long as the shutter is open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from detector.baseline import baseline_features, to_eight_bits
from detector.features import Features, detect_features
from detector.noise import NoiseModel
from detector.sensor import Sensor, expose
from experiments.chain import usable_well
from experiments.presets import presets
from experiments.scenario import Scenario
from radiometry.filters import Bandpass
from radiometry.geometry import FloatArray, sun_direction
from scenes.transport import View

#: Error of the predicted image motion between the frames of a pair, over the motion. Assumption: a tracking filter's.
MOTION_ERROR = 0.05
#: What resampling and the error of the motion leave in a registered frame, as a shift [px]; tells the noise model how far
#: to trust pixels where the subtracted light is steep. Assumption.
REGISTRATION_SIGMA_PX = 0.05


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
    chaser_radius_m: float = 0.0
    """Radius of the disc, in the plane of the lens and about the axis, that shadows the target [m]; 0 is none."""
    pipeline: Literal["mantis", "thesis"] = "mantis"
    """Feature extraction: `detector.features`, or `detector.baseline` on 8 bits."""


#: 20 µs: shortest exposure that many global-shutter cameras offer (assumption); 1 ms: one of the budget's exposures.
MODES: dict[str, Mode] = {
    "single": Mode("one LED-synchronous frame, the scenario's filter"),
    "longpass": Mode("one LED-synchronous frame, LP715 longpass", filter="lp715"),
    "narrow": Mode("one LED-synchronous frame, 25 nm bandpass", filter="bp850_25"),
    "shutter": Mode("the same LED pulse, shutter open for 20 µs", shutter_s=20e-6),
    "long": Mode("the same LED pulse, shutter open for 1 ms", shutter_s=1e-3),
    "pair": Mode("LEDs on minus LEDs off, registered", pair="registered"),
    "pair_raw": Mode("LEDs on minus LEDs off, not registered", pair="raw"),
    "shadowed": Mode("one frame, the chaser's body (0.5 m radius) shadows the target", chaser_radius_m=0.5),
    "thesis": Mode("the thesis's pipeline: LP715, 8 bits, OpenCV ArUco and blobs", filter="lp715", pipeline="thesis"),
}


@dataclass(frozen=True)
class Lit:
    """Electron rates (H, W) of a geometry through one filter [e⁻/s]: LEDs, Sun, and the Sun one frame interval later."""

    led: FloatArray
    sun: FloatArray
    moved_sun: FloatArray


@dataclass(frozen=True)
class Exposed:
    """An image, what is known of its noise, and the frame with LEDs that it came from."""

    image: FloatArray | NDArray[np.uint16]
    noise: NoiseModel
    lit_dn: NDArray[np.uint16]


def through(scenario: Scenario, mode: Mode) -> Scenario:
    """The scenario with the mode's filter."""
    if mode.filter is None:
        return scenario
    return scenario.model_copy(update={"filter": Bandpass(**presets("filter")[mode.filter])})


def pulse_s(scenario: Scenario, mode: Mode, led_bits: float, sun_bits: float) -> float:
    """LED pulse that brings the bright bits to the scenario's fraction of the well [s], from their rates [e⁻/s].

    A shutter that closes with the pulse counts the Sun's light on the bits in; one of fixed length cannot.
    """
    auto = scenario.auto_exposure
    rate = led_bits + (sun_bits if mode.shutter_s is None else 0.0)
    seconds = auto.full_well_fraction * usable_well(scenario.sensor) / max(rate, 1e-9)
    return float(np.clip(seconds, auto.shortest_s, auto.longest_s if mode.shutter_s is None else mode.shutter_s))


def take(
    sensor: Sensor, mode: Mode, lit: Lit, seconds: float, motion_px: FloatArray, rng: np.random.Generator
) -> Exposed:
    """One image of a mode.

    Args:
        seconds: LED pulse.
        motion_px: image motion (2,) of the target's marker between the two frames of a pair.
    """
    shutter = seconds if mode.shutter_s is None else mode.shutter_s
    on = expose(sensor, (lit.led * seconds + lit.sun * shutter) / shutter, shutter, rng).dn
    if mode.pair:
        off = expose(sensor, lit.moved_sun, shutter, rng).dn
        predicted = motion_px * (1 + MOTION_ERROR * rng.standard_normal()) if mode.pair == "registered" else np.zeros(2)
        image, noise = difference(sensor, on, off, predicted)
        return Exposed(image, noise, on)
    gain = 1 / sensor.gain_electrons_per_dn
    noise = NoiseModel(gain, sensor.total_noise_electrons * gain, sensor.offset_dn, sensor.saturation_dn)
    return Exposed(on, noise, on)


def features_of(scenario: Scenario, mode: Mode, shown: Exposed) -> Features:
    """What the mode's pipeline finds in an image."""
    if mode.pipeline == "thesis":
        sensor = scenario.sensor
        return baseline_features(to_eight_bits(shown.image, sensor.offset_dn, sensor.saturation_dn), scenario.marker)
    return detect_features(shown.image, scenario.marker, scenario.camera, shown.noise)


def difference(
    sensor: Sensor, on_dn: NDArray[np.uint16], off_dn: NDArray[np.uint16], motion_px: FloatArray
) -> tuple[FloatArray, NoiseModel]:
    """LEDs on minus LEDs off [e⁻], the second shifted back by a motion (2,) [px], and the noise of the difference.

    The subtracted light counts twice in the variance: as shot noise of the first frame and, with read noise, through the
    shift's kernel, of the second. Where either is clipped, the difference says nothing: infinite variance.
    """
    gain, sigma = sensor.gain_electrons_per_dn, sensor.total_noise_electrons
    on, off = ((frame - np.float32(sensor.offset_dn)) * np.float32(gain) for frame in (on_dn, off_dn))
    single = NoiseModel(1 / gain, sigma / gain, sensor.offset_dn, sensor.saturation_dn)
    clipped = (on_dn >= single.saturated_above_dn) | (
        shifted((off_dn >= single.saturated_above_dn).astype(np.float32), motion_px, power=2) > 0
    )
    sun = shifted(off, motion_px)
    down, across = np.gradient(sun)
    steep = REGISTRATION_SIGMA_PX**2 * (down**2 + across**2) if motion_px.any() else 0.0
    extra = np.maximum(sun, 0) + shifted(np.maximum(off, 0) + np.float32(sigma**2), motion_px, power=2) + steep
    return on - sun, NoiseModel(1.0, sigma, extra_variance_dn2=np.where(clipped, np.inf, extra))


def shifted(image: FloatArray, motion_px: FloatArray, power: int = 1) -> FloatArray:
    """The image (H, W) moved back by a motion (2,) [px], by cubic convolution (Keys 1981, a = −½) with repeated edges.

    With `power` 2 the kernel is squared: variances of the moved image from those of the image.
    """
    from scipy.ndimage import correlate1d

    result = np.asarray(image, np.float32)
    for axis, move in ((1, motion_px[0]), (0, motion_px[1])):
        whole = int(np.floor(move))
        t = np.abs(np.arange(-1, 3) - (move - whole))
        kernel = np.where(t < 1, 1.5 * t**3 - 2.5 * t**2 + 1, -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2) ** power
        padded = np.zeros(2 * (abs(whole) + 2) + 1)
        middle = len(padded) // 2
        padded[middle + whole - 1 : middle + whole + 3] = kernel
        result = correlate1d(result, padded, axis=axis, mode="nearest")
    return result


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
