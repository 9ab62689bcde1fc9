"""An on/off pair: the frame with the LEDs less the frame without, and the noise of the difference."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from detector.sensor.noise import NoiseModel, estimate_noise
from radiometry.geometry import FloatArray

#: What resampling and the error of the motion leave in a registered frame, as a shift [px]; tells the noise model how far
#: to trust pixels where the subtracted light is steep. Assumption.
REGISTRATION_SIGMA_PX = 0.05
#: Levels of brightness at which the noise of a pair is measured, each of as many pixels.
LEVELS = 12


def difference(
    on: NDArray[Any],
    off: NDArray[Any],
    noise: NoiseModel,
    motion_px: FloatArray | None = None,
    scale: float = 1.0,
) -> tuple[FloatArray, NoiseModel]:
    """Frame `on` (H, W) less `scale` times frame `off` (H, W) without their offset, in their own unit, and the noise of it.

    The subtracted light counts twice in the variance: as shot noise of the first frame and, with read noise, through the
    shift's kernel, of the second. Where either is clipped, the difference says nothing: infinite variance.

    Args:
        on: the frame with the LEDs.
        off: the frame without them.
        scale: factor on the frame that is subtracted.
        noise: of one frame; both are of one camera. `pair_noise` estimates it where it is not known.
        motion_px: motion (2,) of the image from the first frame to the second, which is shifted back by it; None is none.

    Raises:
        ValueError: when the frames differ in size or in kind of number.
    """
    if on.shape != off.shape or on.dtype != off.dtype:
        raise ValueError(
            f"off: {_kind(off)}; expected {_kind(on)} as the frame with the LEDs: two frames of one camera and setting"
        )
    moves = motion_px is not None and bool(np.any(motion_px))
    motion = np.zeros(2) if motion_px is None else motion_px
    dark, gain = np.float32(noise.offset_dn), np.float32(noise.gain_dn_per_electron)
    lit, sun = (np.asarray(frame, np.float32) - dark for frame in (on, off))
    full = (off >= noise.saturated_above_dn).astype(np.float32)
    own = gain * np.maximum(sun, 0) + np.float32(noise.read_noise_dn**2)
    if moves:
        full, own, sun = shifted(full, motion, power=2), shifted(own, motion, power=2), shifted(sun, motion)
    sun = np.float32(scale) * sun
    extra = gain * np.maximum(sun, 0) + np.float32(scale**2) * own
    if moves:
        down, across = np.gradient(sun)
        extra = extra + REGISTRATION_SIGMA_PX**2 * (down**2 + across**2)
    clipped = (on >= noise.saturated_above_dn) | (full > 0)
    return lit - sun, NoiseModel(
        noise.gain_dn_per_electron, noise.read_noise_dn, extra_variance_dn2=np.where(clipped, np.inf, extra)
    )


def _kind(frame: NDArray[Any]) -> str:
    return f"{'×'.join(map(str, frame.shape[::-1]))} px of {frame.dtype}"


def pair_noise(on: NDArray[Any], off: NDArray[Any]) -> NoiseModel:
    """Noise of either frame (H, W) of a pair from the two: photon transfer, variance of the difference against the level.

    The light that both frames hold cancels, and second differences along the rows pass over slow changes of what one of them has
    more (see `estimate_noise`); the few pixels at the marker's edges hardly touch a robust scatter. Where the LEDs light rough
    surroundings, these count as noise.
    """
    rows = np.asarray(on, float), np.asarray(off, float)
    less = rows[0] - rows[1]
    second = np.abs(less[:, 2:] - 2 * less[:, 1:-1] + less[:, :-2]).ravel()
    level = ((rows[0] + rows[1])[:, 1:-1] / 2).ravel()
    rough = estimate_noise(np.maximum(on, off))
    readable = level < rough.saturated_above_dn
    level, second = level[readable], second[readable]
    order = np.argsort(level, kind="stable")
    parts = [part for part in np.array_split(order, LEVELS) if len(part)]
    if not parts:
        return rough
    levels = np.array([level[part].mean() for part in parts])
    # A second difference of a difference of two frames has 6 · 2 times the variance of a pixel.
    variance = np.array([(1.4826 * np.median(second[part])) ** 2 / 12 for part in parts])
    low = levels[0]
    floor = rough.read_noise_dn**2 if not variance[0] > 0 else variance[0]
    # A variance is known in proportion to itself.
    weight = 1 / np.maximum(variance, floor) ** 2
    spread = levels - (weight @ levels) / weight.sum()
    power = float(weight @ spread**2)
    gain = max(float(weight @ (spread * variance)) / power, 0.0) if power > 0 else 0.0
    read2 = float(weight @ (variance - gain * (levels - low))) / float(weight.sum())
    least = 0.3 if np.issubdtype(on.dtype, np.integer) else 1e-12  # rounding
    return NoiseModel(gain, max(float(np.sqrt(max(read2, 0.0))), least), float(low), rough.saturation_dn)


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
