"""What the camera sees around the marker, enlarged pixel by pixel, with what the detector found drawn on it, as SVG."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.features import Features
from experiments.reporting.figures import GREEN, ORANGE, SKY, VERMILION, YELLOW
from radiometry.geometry import FloatArray

#: Pictures are enlarged by the largest whole factor that keeps them within this many pixels.
PICTURE_PX = 330
#: Percentiles of the crop that become black and white.
BLACK_PERCENTILE, WHITE_PERCENTILE = 1.0, 99.7


@dataclass(frozen=True)
class MarkerPicture:
    """An `<svg>` element and the whole factor by which it enlarges the frame."""

    svg: str
    enlarged: int


def marker_picture(
    frame: NDArray[np.integer], features: Features, centre_px: FloatArray, side_px: float, outline_px: FloatArray
) -> MarkerPicture:
    """Square crop of a frame about the marker, with detections or, where there are none, the true outline.

    Grey is the square root of the digital number, stretched between two percentiles of the crop.

    Args:
        frame: (H, W) digital numbers.
        features: what the detector found in it.
        centre_px: middle of the crop, (2,).
        side_px: side of the crop.
        outline_px: true corners of the ArUco square (4, 2), drawn dashed where the marker was not found.
    """
    half = max(int(np.ceil(side_px / 2)), 4)
    column, row = np.rint(centre_px).astype(int)
    x0, y0 = max(column - half, 0), max(row - half, 0)
    crop = frame[y0 : row + half + 1, x0 : column + half + 1]
    scale = max(1, PICTURE_PX // max(crop.shape))
    height, width = (scale * n for n in crop.shape)
    origin = np.array([x0, y0]) - 0.5  # pixel centres lie at integers, so the crop's edge is half a pixel further out

    def place(points_px: FloatArray) -> FloatArray:
        return (np.asarray(points_px, float) - origin) * scale

    png = base64.b64encode(_png(crop, scale)).decode("ascii")
    drawn = _detections(features, place) if features.detected else _polygon(place(outline_px), ORANGE, "6 4")
    return MarkerPicture(
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img">'
        f'<image width="{width}" height="{height}" style="image-rendering:pixelated" href="data:image/png;base64,{png}"/>'
        f"{drawn}</svg>",
        scale,
    )


def legend() -> str:
    """An `<svg>` that explains the signs."""
    signs = (
        (_polygon(np.array([[4, 4], [16, 4], [16, 16], [4, 16]]), SKY), "ArUco outline"),
        (_ring(np.array([10, 10]), VERMILION), "corner (filled: the marker’s top left)"),
        (_diamond(np.array([10, 10]), GREEN), "blob of an encoding element"),
        (_cross(np.array([10, 10]), YELLOW), "virtual point"),
        (_polygon(np.array([[4, 4], [16, 4], [16, 16], [4, 16]]), ORANGE, "4 3"), "true outline of a marker not found"),
    )
    return "".join(
        f'<span class="sign"><svg width="20" height="20" viewBox="0 0 20 20" aria-hidden="true">'
        f'<rect width="20" height="20" fill="#444"/>{sign}</svg> {text}</span> '
        for sign, text in signs
    )


def _png(crop: NDArray[np.integer], scale: int) -> bytes:
    low, high = np.percentile(crop, [BLACK_PERCENTILE, WHITE_PERCENTILE])
    grey = np.sqrt(np.clip((crop - low) / max(high - low, 1.0), 0, 1))
    image = np.kron(np.rint(255 * grey).astype(np.uint8), np.ones((scale, scale), np.uint8))
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])


def _detections(features: Features, place: Callable[[FloatArray], FloatArray]) -> str:
    assert features.corners_px is not None
    corners = place(features.corners_px)
    parts = [_polygon(corners, SKY)]
    parts += [_ring(corner, VERMILION, filled=i == 0) for i, corner in enumerate(corners)]
    parts += [_diamond(place(p), GREEN) for p in features.blobs_px.values() if p is not None]
    parts += [_cross(place(p), YELLOW) for p in features.virtual_points_px.values()]
    return "".join(parts)


def _polygon(points: FloatArray, colour: str, dash: str = "") -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    return f'<polygon points="{text}" fill="none" stroke="{colour}" stroke-width="1.5"{dashes}/>'


def _ring(p: FloatArray, colour: str, *, filled: bool = False) -> str:
    fill = colour if filled else "none"
    return f'<circle cx="{p[0]:.1f}" cy="{p[1]:.1f}" r="4" fill="{fill}" stroke="{colour}" stroke-width="1.5"/>'


def _diamond(p: FloatArray, colour: str) -> str:
    x, y = p
    path = f"M{x:.1f} {y - 6:.1f}l6 6-6 6-6-6z"
    return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'


def _cross(p: FloatArray, colour: str) -> str:
    x, y = p
    return f'<path d="M{x - 5:.1f} {y:.1f}h10M{x:.1f} {y - 5:.1f}v10" stroke="#000" stroke-width="3.5"/>' + (
        f'<path d="M{x - 5:.1f} {y:.1f}h10M{x:.1f} {y - 5:.1f}v10" stroke="{colour}" stroke-width="1.8"/>'
    )
