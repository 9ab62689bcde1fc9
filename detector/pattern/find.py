"""The marker's pattern in an image: candidates, decoded, fitted and accepted; and where none is, why not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from detector.pattern.candidates import search
from detector.pattern.corner_fit import LEAST_SIGMA_PX
from detector.pattern.corners import OTHER_BLUR, PatternFit, fit_pattern, sample
from detector.pattern.decode import MIN_CORRELATION, MIN_OTHER, Decoder, decoder_of, has_ring
from detector.pattern.pattern import homography, pixels_of
from detector.sensor.noise import NoiseModel
from radiometry.geometry import FloatArray
from scenes.marker import MarkerDesign

#: A quadrilateral is worth a fit where no other identity's correlation is better by more than this. Here and below: chosen
#: between what markers and marker-free frames show.
SLACK = 0.02
#: Accepted when the pattern leaves at most this part of the light's variance unexplained by noise,
MAX_UNEXPLAINED = 0.15
#: when it stands out of the noise by this many standard deviations, all pixels together,
MIN_SIGNIFICANCE = 12.0
#: and when no other identity's or turn's correlation comes as near as this.
MIN_LEAD = 0.02
#: Blurs that a quadrilateral is looked at through after the first guess [bits].
BLURS_PER_BIT = (0.2, 0.5, 0.8)
#: Without a ring that outshines the border, so many of the largest quadrilaterals are decoded, through these blurs [bits], and
#: fitted from this correlation on.
MOST_BLURRED, BLURS_WITHOUT_RING, MIN_BLURRED = 10, (0.65, 0.95), 0.8
#: A miss is laid to blur from this blur on [bits], and to saturation from this part of the bits on.
BLURRED_BITS, SATURATED_BITS = 0.6, 0.3
#: Frame by frame: part of the pixels that is saturated; contrast in noise deviations below which nothing can be seen; and the
#: median run of bright or of dark pixels over the frame's side: a bit of a marker that fills the frame has 0.12.
SATURATED_FRAME, MIN_CONTRAST, LONG_RUN = 0.3, 10.0, 0.1
#: A frame is called blurred from this on [px].
BLURRED_FRAME_PX = 1.5


@dataclass(frozen=True)
class Search:
    """What came of the search for a marker's pattern in an image."""

    fit: PatternFit | None
    other: int | None  # another identity that was seen, where the marker's own was not
    reason: str | None  # why there is no fit


@dataclass(frozen=True)
class _Miss:
    """A candidate that resembled the marker, and why it was not accepted."""

    correlation: float
    why: str


def find_pattern(frame: np.ndarray, marker: MarkerDesign, guess_px: float, noise: NoiseModel) -> Search:
    """Find the marker's pattern in an image.

    Args:
        frame: (height, width) [DN].
        marker: the design that is looked for.
        guess_px: first guess of the blur: standard deviation of point spread and pixel box together [px].
        noise: of the image.

    Returns:
        The fit of the first candidate that bears the marker's pattern; else the reason why there is none.
    """
    decoder = decoder_of(marker)
    other: int | None = None
    miss = _Miss(0.0, "")
    ringless: list[FloatArray] = []
    for quad, blur_px in search(frame, noise):
        if not has_ring(frame, quad, decoder.pattern, noise.read_noise_dn):
            ringless.append(quad)
            continue
        for sigma_px in _blurs(quad, decoder, guess_px):
            decoded = decoder.decode(frame, quad, sigma_px, noise)
            if decoded is None:
                continue
            first, own = decoded
            if own.correlation >= max(MIN_CORRELATION, first.correlation - SLACK):
                fit = fit_pattern(frame, decoder.pattern, np.roll(quad, -own.turn, axis=0), sigma_px, noise, blur_px)
                why = _objection(frame, decoder, fit, noise)
                if fit is not None and why is None:
                    return Search(fit, None, None)
                if own.correlation > miss.correlation and why is not None:
                    miss = _Miss(own.correlation, why)
            elif other is None and first.identity != marker.identity and first.correlation > MIN_OTHER:
                stranger = decoder_of(marker.model_copy(update={"identity": first.identity}))
                corners_px = np.roll(quad, -first.turn, axis=0)
                fit = fit_pattern(frame, stranger.pattern, corners_px, sigma_px, noise, blur_px)
                if _objection(frame, stranger, fit, noise) is None:
                    other = first.identity
    if other is not None:
        return Search(None, other, f"only identity {other} seen")
    found = _through_blur(frame, decoder, ringless, noise)
    if found.fit is not None or (found.reason and not miss.why):
        return found
    return Search(None, None, miss.why or _about_the_frame(frame, noise))


def _blurs(quad: FloatArray, decoder: Decoder, guess_px: float) -> Iterator[float]:
    """Blurs that a quadrilateral is looked at through [px]: the guess, then some parts of a bit."""
    yield guess_px
    bit_px = _side_px(quad) / len(decoder.pattern.marker.bits)
    for part in BLURS_PER_BIT:
        sigma_px = max(part * bit_px, LEAST_SIGMA_PX)
        if abs(math.log(sigma_px / guess_px)) > OTHER_BLUR:
            yield sigma_px


def _through_blur(frame: np.ndarray, decoder: Decoder, quads: list[FloatArray], noise: NoiseModel) -> Search:
    """A marker so blurred that its ring no longer outshines its border, among the largest of some quadrilaterals."""
    why = None
    for quad in sorted(quads, key=_side_px, reverse=True)[:MOST_BLURRED]:
        bit_px = _side_px(quad) / len(decoder.pattern.marker.bits)
        for part in BLURS_WITHOUT_RING:
            decoded = decoder.decode(frame, quad, part * bit_px, noise)
            if decoded is None or decoded[1].correlation < max(MIN_BLURRED, decoded[0].correlation - SLACK):
                continue
            corners_px = np.roll(quad, -decoded[1].turn, axis=0)
            fit = fit_pattern(frame, decoder.pattern, corners_px, part * bit_px, noise)
            objection = _objection(frame, decoder, fit, noise)
            if objection is None:
                return Search(fit, None, None)
            if fit is None:
                objection = f"blurred: σ about {part * bit_px:.1f} px, a bit spans {bit_px:.1f} px"
            why = why or objection
    return Search(None, None, why)


def _side_px(corners_px: FloatArray) -> float:
    """Side of the square of the same area [px]."""
    return math.sqrt(abs(cv2.contourArea(corners_px.astype(np.float32))))


def _objection(frame: np.ndarray, decoder: Decoder, fit: PatternFit | None, noise: NoiseModel) -> str | None:
    """Why a fit is not accepted; None where the pattern explains the light and no other pattern nearly does."""
    if fit is None:
        return "a square that resembles the marker, but the pattern does not fit it"
    bit_px = _side_px(fit.corners_px) / len(decoder.pattern.marker.bits)
    if fit.significance < MIN_SIGNIFICANCE:
        return f"contrast {fit.significance:.0f} of {MIN_SIGNIFICANCE:.0f}"
    checked = None
    if fit.unexplained <= MAX_UNEXPLAINED:
        checked = decoder.decode(frame, fit.corners_px, fit.sigma_px, noise)
        if checked is not None and checked[1].turn == 0 and checked[1].correlation > checked[1].rival + MIN_LEAD:
            return None
    saturated = _saturated_bits(frame, decoder, fit, noise)
    if saturated > SATURATED_BITS:
        return f"saturated: {100 * saturated:.0f} % of the bits"
    if fit.sigma_px > BLURRED_BITS * bit_px:
        point_spread_px = math.sqrt(max(fit.sigma_px**2 - 1 / 12, 0.0))
        return f"blurred: σ {point_spread_px:.1f} px, a bit spans {bit_px:.1f} px"
    if checked is None:
        return f"a square that resembles the marker, but {100 * fit.unexplained:.0f} % of its light is unexplained"
    return "a square that resembles the marker, but another pattern fits nearly as well"


def _saturated_bits(frame: np.ndarray, decoder: Decoder, fit: PatternFit, noise: NoiseModel) -> float:
    """Part of the pattern's pixels that is saturated, ring included."""
    origin = np.zeros(2)
    columns, rows = pixels_of(homography(fit.corners_px), decoder.pattern.ring, frame.shape, 0.0, 2000)
    seen = sample(frame, columns, rows, origin, noise)
    return float(seen.saturated.mean()) if len(seen.data) else 0.0


def _about_the_frame(frame: np.ndarray, noise: NoiseModel) -> str:
    """What keeps a frame without any candidate from showing a marker."""
    step = max(min(frame.shape) // 128, 1)
    some = frame[::step, ::step].astype(np.float32)
    saturated = float((some >= noise.saturated_above_dn).mean())
    if saturated > SATURATED_FRAME:
        return f"saturated: {100 * saturated:.0f} % of the frame"
    low, high = np.percentile(some, (1.0, 99.8))
    contrast = float(high - low) / max(math.sqrt(float(noise.of(np.array(low), 0.0))), 1e-12)
    if contrast < MIN_CONTRAST:
        return f"no marker found: contrast {contrast:.0f} of {MIN_CONTRAST:.0f}"
    bright = some > (low + high) / 2
    at_edges = [0.15 < side.mean() < 0.95 for side in (bright[0], bright[-1], bright[:, 0], bright[:, -1])]
    if all(at_edges) and min(_median_run(bright) / bright.shape[1], _median_run(bright.T) / bright.shape[0]) > LONG_RUN:
        return "marker larger than the frame"
    # The steepest slope that a blur leaves of a step is the step over √(2π) σ.
    steepest = np.percentile(np.abs(frame[:, 2:].astype(np.float32) - frame[:, :-2]) / 2, 99.9)
    sharpest_px = float(high - low) / (math.sqrt(2 * math.pi) * max(float(steepest), 1e-12))
    if sharpest_px > BLURRED_FRAME_PX:
        return f"no marker found; blurred: σ {sharpest_px:.1f} px or more, nothing in the frame is sharper"
    return "no marker found"


def _median_run(bright: np.ndarray) -> float:
    """Median length of the runs of equal pixels along the rows of a mask, weighted by their length."""
    lengths = []
    for row in bright:
        ends = np.flatnonzero(np.diff(row))
        lengths.append(np.diff(np.concatenate([[-1], ends, [len(row) - 1]])))
    runs = np.sort(np.concatenate(lengths))
    return float(runs[np.searchsorted(np.cumsum(runs), runs.sum() / 2)])
